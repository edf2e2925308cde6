#pragma once

#include <optional>
#include <span>
#include <string>
#include <string_view>

namespace limber {

bool is_utf8(std::string_view text);

/// `text` in UTF-8; nullopt where it is not valid in `encoding` (a name that iconv knows).
std::optional<std::string> to_utf8(std::string_view text, const char* encoding);

/// Rewrites names that are not UTF-8. One encoding is chosen for all of them: Shift-JIS where it
/// fits every name, else Windows-1252. Returns its name, or nullptr where nothing was to do.
const char* repair_names(std::span<std::string> names);

/// At most `max_bytes` of UTF-8 `text`, cut between characters.
std::string_view cut_utf8(std::string_view text, std::size_t max_bytes);

}  // namespace limber
