#pragma once

#include <cstddef>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "assets/model/result.h"
#include "importers/importer.h"

namespace limber {

inline constexpr std::size_t kMaxFileBytes = std::size_t{2} << 30;

/// A regular file's bytes. Errors: `file-missing`, `file-unreadable`, `file-too-large`.
Result<std::vector<std::byte>> read_whole_file(const std::filesystem::path&);

/// Reads what a file may refer to: data URIs, and regular files inside `folder`. No scheme but
/// data:, no absolute path, no "..", no link that leads out. Errors: `uri-refused`, `uri-missing`.
UriResolver folder_resolver(const std::filesystem::path& folder);

/// Bytes of a data URI (base64 or percent-encoded). Error: `uri-refused`.
Result<std::vector<std::byte>> decode_data_uri(std::string_view uri);

/// Resolves %XX; nullopt where one is broken or hides a zero byte.
std::optional<std::string> percent_decoded(std::string_view text);

}  // namespace limber
