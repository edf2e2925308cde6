#pragma once

#include <span>
#include <string_view>

namespace limber {

/// A stable code of an error or warning: what it means and the way out.
struct CodeInfo {
  std::string_view code, meaning, way_out;
};

/// Every code, sorted.
std::span<const CodeInfo> all_codes();
const CodeInfo* find_code(std::string_view);

}  // namespace limber
