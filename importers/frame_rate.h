#pragma once

#include <string_view>

namespace limber {

/// The rate that a rounded frame time means: ".0083333" is 120 Hz, "0.033367" 30000/1001 Hz.
/// `text` is the number as written: its last digit tells how far it was rounded.
double snap_rate_hz(double frame_time_s, std::string_view text);

}  // namespace limber
