#pragma once

#include <cstddef>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "assets/model/result.h"

namespace limber {

Result<std::vector<std::byte>> read_file(const std::filesystem::path&);
Result<std::string> read_text(const std::filesystem::path&);

std::string sha256_hex(std::span<const std::byte>);

/// Writes under a temporary name, syncs, renames: a reader sees the old file or the whole new one.
/// Error: `output-unwritable`.
Result<void> write_whole(const std::filesystem::path&, std::span<const std::byte>);
Result<void> write_whole(const std::filesystem::path&, std::string_view);

/// A file name that works anywhere: separators, control characters and reserved names replaced,
/// at most 120 bytes, never empty.
std::string safe_name(std::string_view);

}  // namespace limber
