#include "pipeline/content_hash.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <memory>
#include <optional>

namespace limber {
namespace {

std::string hex(XXH128_hash_t hash) {
  return fmt::format("{:016x}{:016x}", hash.high64, hash.low64);
}

/// Size and time of a regular file; nullopt where there is none.
std::optional<FileStamp> look_at(const std::string& path) {
  struct stat info {};
  if (::stat(path.c_str(), &info) != 0 || !S_ISREG(info.st_mode)) return std::nullopt;
  return FileStamp{
      .path = path,
      .bytes = info.st_size,
      .mtime_ns = std::int64_t(info.st_mtim.tv_sec) * 1'000'000'000 + info.st_mtim.tv_nsec,
      .hash = ""};
}

Error cannot_read(const std::filesystem::path& path, int error) {
  return {.code = error == ENOENT ? "file-missing" : "file-unreadable",
          .message = std::strerror(error),
          .file = path.string(),
          .hint = "check the path and its permissions"};
}

}  // namespace

std::string content_hash(std::span<const std::byte> bytes) {
  return hex(XXH3_128bits(bytes.data(), bytes.size()));
}

std::string content_hash(std::string_view text) {
  return content_hash(std::as_bytes(std::span(text.data(), text.size())));
}

Result<std::string> hash_file(const std::filesystem::path& path) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY);
  if (fd < 0) return cannot_read(path, errno);
  const std::unique_ptr<XXH3_state_t, decltype(&XXH3_freeState)> state(XXH3_createState(),
                                                                       &XXH3_freeState);
  XXH3_128bits_reset(state.get());
  static std::array<char, 1 << 16> buffer;
  int error = 0;
  for (;;) {
    const ssize_t n = ::read(fd, buffer.data(), buffer.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) error = errno;
    if (n <= 0) break;
    XXH3_128bits_update(state.get(), buffer.data(), static_cast<std::size_t>(n));
  }
  ::close(fd);
  if (error != 0) return cannot_read(path, error);
  return hex(XXH3_128bits_digest(state.get()));
}

FileStamp stamp_file(const std::string& path) {
  auto stamp = look_at(path);
  if (!stamp) return {.path = path, .bytes = -1, .mtime_ns = 0, .hash = ""};
  if (auto hash = hash_file(path)) stamp->hash = *hash;
  return *stamp;
}

bool unchanged(const FileStamp& stamp, bool rehash) {
  const auto now = look_at(stamp.path);
  if (!now || stamp.bytes < 0) return !now && stamp.bytes < 0;
  if (now->bytes != stamp.bytes || stamp.hash.empty()) return false;
  if (!rehash && now->mtime_ns == stamp.mtime_ns) return true;
  const auto hash = hash_file(stamp.path);
  return hash.ok() && *hash == stamp.hash;
}

}  // namespace limber
