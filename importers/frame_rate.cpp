#include "importers/frame_rate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <initializer_list>
#include <limits>
#include <string>

namespace limber {

namespace {

constexpr std::array kUsualRates = {24.0,  25.0,  30.0,  48.0,  50.0,  60.0,  72.0,  75.0,
                                    80.0,  90.0,  100.0, 120.0, 144.0, 150.0, 180.0, 200.0,
                                    240.0, 250.0, 300.0, 360.0, 480.0, 500.0, 1000.0};
constexpr std::array kNtscRates = {24000.0 / 1001.0, 30000.0 / 1001.0, 60000.0 / 1001.0,
                                   120000.0 / 1001.0};

/// Value of the last digit written, in seconds.
double last_digit(std::string_view text) {
  int decimals = 0;
  bool after_point = false;
  std::size_t i = 0;
  for (; i < text.size() && text[i] != 'e' && text[i] != 'E'; ++i) {
    if (text[i] == '.') {
      after_point = true;
    } else if (after_point) {
      ++decimals;
    }
  }
  const int exponent = i < text.size() ? std::atoi(std::string(text.substr(i + 1)).c_str()) : 0;
  return std::pow(10.0, exponent - decimals);
}

}  // namespace

double snap_rate_hz(double frame_time_s, std::string_view text) {
  const double rate = 1.0 / frame_time_s;
  const double whole = std::round(rate);
  if (whole >= 1.0 && std::abs(rate - whole) <= 2e-5 * whole) return whole;
  // Rounded or cut after its last digit; a single digit (0.03) says too little.
  const double slack = std::max(last_digit(text), 5e-7 * frame_time_s);
  if (slack > 0.1 * frame_time_s) return rate;
  const auto nearest = [&](const auto& rates) {
    double best = std::numeric_limits<double>::infinity();
    for (const double candidate : rates) {
      if (std::abs(1.0 / candidate - frame_time_s) > slack) continue;
      if (std::abs(candidate - rate) < std::abs(best - rate)) best = candidate;
    }
    return best;
  };
  for (const double found : {nearest(kUsualRates), nearest(kNtscRates)}) {
    if (std::isfinite(found)) return found;
  }
  if (whole >= 1.0 && std::abs(1.0 / whole - frame_time_s) <= slack) return whole;
  return rate;
}

}  // namespace limber
