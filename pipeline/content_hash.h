#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>

#include "assets/model/result.h"

namespace limber {

/// XXH3 with 128 bits, as 32 hex digits. It tells contents apart; it is no proof against forgers.
std::string content_hash(std::span<const std::byte>);
std::string content_hash(std::string_view);
/// Of a regular file, read piece by piece. Errors: `file-missing`, `file-unreadable`.
Result<std::string> hash_file(const std::filesystem::path&);

/// A file as it was when it was looked at.
struct FileStamp {
  std::string path;
  std::int64_t bytes = -1;  ///< -1: there was no such file
  std::int64_t mtime_ns = 0;
  std::string hash;  ///< content_hash; empty where the file could not be read
};

/// Size, time and content of a file, looked up in this order: a file that changes meanwhile differs
/// from its stamp later on.
FileStamp stamp_file(const std::string& path);

/// Whether a file is what its stamp says. Equal size and time are believed unless `rehash`; where
/// the time alone differs, the content decides. What could not be read counts as changed.
bool unchanged(const FileStamp&, bool rehash);

}  // namespace limber
