#include "pipeline/codes.h"

#include <algorithm>
#include <array>

namespace limber {
namespace {

constexpr auto kCodes = std::to_array<CodeInfo>({
    {"calibration-failed", "No pose of the file stands upright, so its T-pose cannot be computed.",
     "Name a frame that does with --reference frame:N."},
});

}  // namespace

std::span<const CodeInfo> all_codes() { return kCodes; }

const CodeInfo* find_code(std::string_view code) {
  const auto found = std::find_if(kCodes.begin(), kCodes.end(),
                                  [&](const CodeInfo& info) { return info.code == code; });
  return found == kCodes.end() ? nullptr : &*found;
}

}  // namespace limber
