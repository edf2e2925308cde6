#pragma once

namespace limber {

inline constexpr const char* kVersion = "0.1.0";

}  // namespace limber
