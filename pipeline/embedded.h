#pragma once

#include <string_view>
#include <vector>

namespace limber {

/// A file of assets/data that is built into the program; empty where there is none.
/// `name` is relative to assets/data, e.g. "rigs/hand.json".
std::string_view embedded_file(std::string_view name);

/// Names that start with `prefix`, sorted.
std::vector<std::string_view> embedded_files(std::string_view prefix);

}  // namespace limber
