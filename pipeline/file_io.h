#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
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

/// The same for contents that come piece by piece and are never in memory together. `produce` hands
/// each piece to its argument; once a piece could not be written, the rest is dropped.
using Sink = std::function<void(std::string_view)>;
Result<void> write_whole(const std::filesystem::path&,
                         const std::function<void(const Sink&)>& produce);

/// A part of a file name that works anywhere: separators and control characters replaced, at most
/// 72 bytes of whole UTF-8 characters (three parts and a suffix stay below 255), never empty.
std::string safe_name(std::string_view);

/// The key by which names are told apart: file systems may ignore the case of ASCII letters.
std::string case_folded(std::string_view);

/// Removes temporaries that killed writers left in a folder.
void remove_temporaries(const std::filesystem::path& folder);

}  // namespace limber
