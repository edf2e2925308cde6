#include "importers/file_resolver.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/openat2.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <utility>

#include "importers/memory_pages.h"

namespace limber {

namespace {

/// A file descriptor that closes itself.
class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  Descriptor(Descriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Descriptor& operator=(Descriptor&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }
  ~Descriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  int get() const { return fd_; }
  bool ok() const { return fd_ >= 0; }

 private:
  int fd_;
};

using Bytes = std::vector<std::byte>;

Error unreadable(std::string message) {
  return {.code = "file-unreadable",
          .message = std::move(message),
          .hint = "check the path and its permissions"};
}

/// Everything in the regular file `fd`, which was opened with O_NONBLOCK.
Result<Bytes> read_descriptor(int fd, const std::string& name) {
  struct stat info {};
  if (::fstat(fd, &info) != 0) return unreadable(fmt::format("'{}': {}", name, strerror(errno)));
  if (!S_ISREG(info.st_mode)) return unreadable(fmt::format("'{}' is no regular file", name));
  if (static_cast<std::uint64_t>(info.st_size) > kMaxFileBytes) {
    return Error{
        .code = "file-too-large",
        .message = fmt::format("'{}' has {} bytes; the limit is 2 GiB", name, info.st_size),
        .hint = "split the file"};
  }
  Bytes bytes;
  bytes.reserve(static_cast<std::size_t>(info.st_size));
  prefer_large_pages(bytes.data(), bytes.capacity());
  bytes.resize(static_cast<std::size_t>(info.st_size));
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t n = ::read(fd, bytes.data() + done, bytes.size() - done);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return unreadable(fmt::format("'{}': {}", name, strerror(errno)));
    if (n == 0) break;
    done += static_cast<std::size_t>(n);
  }
  bytes.resize(done);
  return bytes;
}

Error refused(std::string_view uri, const char* why) {
  return {.code = "uri-refused",
          .message = fmt::format("the file refers to '{}', {}", uri.substr(0, 80), why),
          .hint = "put the file beside the one that refers to it, or embed it"};
}

/// Opens `path` below the folder; the kernel refuses every way out of it. Where openat2 is not
/// available, no component may be a link.
Descriptor open_beneath(int folder, const std::string& path) {
  struct open_how how {};
  how.flags = O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY;
  how.resolve = RESOLVE_BENEATH | RESOLVE_NO_MAGICLINKS;
  const long fd = ::syscall(SYS_openat2, folder, path.c_str(), &how, sizeof how);
  if (fd >= 0 || (errno != ENOSYS && errno != EPERM)) return Descriptor(static_cast<int>(fd));
  Descriptor at(::dup(folder));
  std::size_t begin = 0;
  while (at.ok()) {
    const std::size_t slash = path.find('/', begin);
    const bool last = slash == std::string::npos;
    const std::string part = path.substr(begin, last ? slash : slash - begin);
    const int flags = O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY | O_NOFOLLOW;
    Descriptor inner(
        ::openat(at.get(), part.empty() ? "." : part.c_str(), last ? flags : flags | O_DIRECTORY));
    if (last || !inner.ok()) return inner;
    at = std::move(inner);
    begin = slash + 1;
  }
  return at;
}

bool climbs(const std::string& path) {
  for (std::size_t begin = 0; begin <= path.size();) {
    const std::size_t end = std::min(path.find('/', begin), path.size());
    if (path.compare(begin, end - begin, "..") == 0) return true;
    begin = end + 1;
  }
  return false;
}

bool has_scheme(std::string_view uri) {
  const std::size_t colon = uri.find(':');
  return colon != std::string_view::npos && colon < uri.find('/');
}

Result<Bytes> resolve(const std::filesystem::path& folder, std::string_view uri) {
  if (uri.starts_with("data:")) return decode_data_uri(uri);
  if (has_scheme(uri)) return refused(uri, "and only files beside it and data: are read");
  const std::optional<std::string> path = percent_decoded(uri);
  if (!path || path->empty()) return refused(uri, "which is no file name");
  if (path->front() == '/' || path->find('\\') != std::string::npos) {
    return refused(uri, "an absolute path");
  }
  if (climbs(*path)) return refused(uri, "which leads out of its folder");
  const Descriptor base(::open(folder.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC));
  if (!base.ok()) return unreadable(fmt::format("'{}': {}", folder.string(), strerror(errno)));
  const Descriptor file = open_beneath(base.get(), *path);
  if (!file.ok() && (errno == EXDEV || errno == ELOOP)) {
    return refused(uri, "a link that leads out of its folder");
  }
  if (!file.ok()) {
    return Error{.code = "uri-missing",
                 .message = fmt::format("the file refers to '{}', which cannot be read: {}",
                                        uri.substr(0, 80), strerror(errno)),
                 .hint = "keep a file and what it refers to in one folder"};
  }
  return read_descriptor(file.get(), *path);
}

int hex_digit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

/// Standard and URL-safe alphabets; white space is skipped; padding may be missing.
std::optional<Bytes> decode_base64(std::string_view text) {
  const auto digit = [](char c) -> int {
    if (c >= 'A' && c <= 'Z') return c - 'A';
    if (c >= 'a' && c <= 'z') return c - 'a' + 26;
    if (c >= '0' && c <= '9') return c - '0' + 52;
    if (c == '+' || c == '-') return 62;
    if (c == '/' || c == '_') return 63;
    return -1;
  };
  Bytes bytes;
  bytes.reserve(text.size() / 4 * 3);
  std::uint32_t bits = 0;
  int count = 0;
  bool padded = false;
  for (const char c : text) {
    if (c == ' ' || c == '\n' || c == '\r' || c == '\t') continue;
    if (c == '=') {
      padded = true;
      continue;
    }
    const int value = digit(c);
    if (value < 0 || padded) return std::nullopt;
    bits = bits << 6 | static_cast<std::uint32_t>(value);
    count += 6;
    if (count >= 8) {
      count -= 8;
      bytes.push_back(static_cast<std::byte>(bits >> count & 0xFFu));
    }
  }
  if (count == 6) return std::nullopt;
  return bytes;
}

}  // namespace

std::optional<std::string> percent_decoded(std::string_view text) {
  std::string out;
  for (std::size_t i = 0; i < text.size(); ++i) {
    char c = text[i];
    if (c == '%') {
      const int high = i + 1 < text.size() ? hex_digit(text[i + 1]) : -1;
      const int low = i + 2 < text.size() ? hex_digit(text[i + 2]) : -1;
      if (high < 0 || low < 0) return std::nullopt;
      c = static_cast<char>(high * 16 + low);
      i += 2;
    }
    if (c == '\0') return std::nullopt;
    out += c;
  }
  return out;
}

Result<Bytes> decode_data_uri(std::string_view uri) {
  const std::size_t comma = uri.find(',');
  if (!uri.starts_with("data:") || comma == std::string_view::npos) {
    return refused(uri, "which is no data URI");
  }
  const std::string_view body = uri.substr(comma + 1);
  if (uri.substr(0, comma).ends_with(";base64")) {
    if (std::optional<Bytes> bytes = decode_base64(body)) return std::move(*bytes);
    return refused(uri, "whose base64 is damaged");
  }
  Bytes bytes;
  for (std::size_t i = 0; i < body.size(); ++i) {
    int value = static_cast<unsigned char>(body[i]);
    if (body[i] == '%') {
      const int high = i + 1 < body.size() ? hex_digit(body[i + 1]) : -1;
      const int low = i + 2 < body.size() ? hex_digit(body[i + 2]) : -1;
      if (high < 0 || low < 0) return refused(uri, "whose percent-encoding is damaged");
      value = high * 16 + low;
      i += 2;
    }
    bytes.push_back(static_cast<std::byte>(value));
  }
  return bytes;
}

Result<Bytes> read_whole_file(const std::filesystem::path& path) {
  const Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY));
  if (!file.ok()) {
    if (errno == ENOENT || errno == ENOTDIR) {
      return Error{.code = "file-missing",
                   .message = fmt::format("there is no file '{}'", path.string()),
                   .hint = "check the path"};
    }
    return unreadable(fmt::format("'{}': {}", path.string(), strerror(errno)));
  }
  return read_descriptor(file.get(), path.string());
}

UriResolver folder_resolver(const std::filesystem::path& folder) {
  const std::filesystem::path base = folder.empty() ? std::filesystem::path(".") : folder;
  return [base](std::string_view uri) { return resolve(base, uri); };
}

}  // namespace limber
