#include "pipeline/file_io.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sha256.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

namespace limber {
namespace {

/// One process writes one file at a time, so its number tells temporaries apart.
constexpr const char* kTemporaryPrefix = ".limber-";

Error cannot_read(const std::filesystem::path& path, int error) {
  const bool missing = error == ENOENT || error == ENOTDIR;
  return Error{.code = missing ? "file-missing" : "file-unreadable",
               .message = std::strerror(error),
               .file = path.string(),
               .hint = missing ? "check the path" : "check the file's permissions"};
}

Error cannot_write(const std::filesystem::path& path, int error) {
  return Error{.code = "output-unwritable",
               .message = std::strerror(error),
               .file = path.string(),
               .hint = "check space and permissions of the output folder"};
}

/// Closes on every way out.
class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  ~Descriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  int get() const { return fd_; }
  int close() {
    const int r = ::close(fd_);
    fd_ = -1;
    return r;
  }

 private:
  int fd_;
};

/// False, with errno set, where not all could be written.
bool write_all(int fd, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t n = ::write(fd, bytes.data(), bytes.size());
    if (n < 0 && errno == EINTR) continue;
    if (n == 0) errno = EIO;
    if (n <= 0) return false;
    bytes.remove_prefix(static_cast<std::size_t>(n));
  }
  return true;
}

}  // namespace

Result<std::vector<std::byte>> read_file(const std::filesystem::path& path) {
  const Descriptor fd(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (fd.get() < 0) return cannot_read(path, errno);
  struct stat info {};
  if (::fstat(fd.get(), &info) != 0) return cannot_read(path, errno);
  if (!S_ISREG(info.st_mode)) return cannot_read(path, S_ISDIR(info.st_mode) ? EISDIR : EINVAL);
  std::vector<std::byte> bytes(static_cast<std::size_t>(info.st_size));
  std::size_t got = 0;
  while (got < bytes.size()) {
    const ssize_t n = ::read(fd.get(), bytes.data() + got, bytes.size() - got);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return cannot_read(path, errno);
    if (n == 0) break;
    got += static_cast<std::size_t>(n);
  }
  bytes.resize(got);
  return bytes;
}

Result<std::string> read_text(const std::filesystem::path& path) {
  auto bytes = read_file(path);
  if (!bytes) return bytes.error();
  return std::string(reinterpret_cast<const char*>(bytes->data()), bytes->size());
}

std::string sha256_hex(std::span<const std::byte> bytes) {
  SHA2_CTX context;
  SHA256Init(&context);
  SHA256Update(&context, reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size());
  std::uint8_t digest[SHA256_DIGEST_LENGTH];
  SHA256Final(digest, &context);
  std::string hex;
  for (const std::uint8_t byte : digest) hex += fmt::format("{:02x}", byte);
  return hex;
}

Result<void> write_whole(const std::filesystem::path& path,
                         const std::function<void(const Sink&)>& produce) {
  const std::filesystem::path temporary =
      path.parent_path() / fmt::format("{}{}.tmp", kTemporaryPrefix, ::getpid());
  {
    Descriptor fd(::open(temporary.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666));
    if (fd.get() < 0) return cannot_write(path, errno);
    int error = 0;
    produce([&](std::string_view piece) {
      if (error == 0 && !write_all(fd.get(), piece)) error = errno;
    });
    if (error == 0 && (::fsync(fd.get()) != 0 || fd.close() != 0)) error = errno;
    if (error != 0) {
      ::unlink(temporary.c_str());
      return cannot_write(path, error);
    }
  }
  if (::rename(temporary.c_str(), path.c_str()) != 0) {
    const int error = errno;
    ::unlink(temporary.c_str());
    return cannot_write(path, error);
  }
  return {};
}

Result<void> write_whole(const std::filesystem::path& path, std::string_view text) {
  return write_whole(path, [&](const Sink& put) { put(text); });
}

Result<void> write_whole(const std::filesystem::path& path, std::span<const std::byte> bytes) {
  return write_whole(path,
                     std::string_view(reinterpret_cast<const char*>(bytes.data()), bytes.size()));
}

std::string safe_name(std::string_view name) {
  constexpr std::size_t kLongest = 72;
  std::string out;
  for (const char c : name) {
    const auto u = static_cast<unsigned char>(c);
    const bool bad = u < 0x20 || u == 0x7f || std::strchr("/\\:*?\"<>|#", c) != nullptr;
    out += bad ? '_' : c;
  }
  if (out.size() > kLongest) {
    std::size_t end = kLongest;  // back to the first byte of a character
    while (end > 0 && (static_cast<unsigned char>(out[end]) & 0xC0) == 0x80) --end;
    out.resize(end);
  }
  while (!out.empty() && (out.back() == '.' || out.back() == ' ')) out.pop_back();
  return out.empty() ? "unnamed" : out;
}

std::string case_folded(std::string_view name) {
  std::string out(name);
  for (char& c : out) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  return out;
}

void remove_temporaries(const std::filesystem::path& folder) {
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator(folder, ignored)) {
    const std::string name = entry.path().filename().string();
    if (name.starts_with(kTemporaryPrefix) && name.ends_with(".tmp")) {
      std::filesystem::remove(entry.path(), ignored);
    }
  }
}

}  // namespace limber
