#pragma once

#include <initializer_list>
#include <utility>
#include <vector>

namespace limber::generate {

/// The minimum-jerk blend of Flash and Hogan (1985): from 0 to 1 with no speed and no acceleration
/// at either end.
inline double minimum_jerk(double t) {
  if (t <= 0.0) return 0.0;
  if (t >= 1.0) return 1.0;
  return t * t * t * (10.0 + t * (-15.0 + 6.0 * t));
}

/// One number over time: keys (seconds, value), minimum jerk between them, held outside.
class Track {
 public:
  Track(std::initializer_list<std::pair<double, double>> keys) : keys_(keys) {}

  double at(double seconds) const {
    if (keys_.empty()) return 0.0;
    for (std::size_t k = 0; k + 1 < keys_.size(); ++k) {
      const auto& [t0, v0] = keys_[k];
      const auto& [t1, v1] = keys_[k + 1];
      if (seconds < t1) return v0 + (v1 - v0) * minimum_jerk((seconds - t0) / (t1 - t0));
    }
    return keys_.back().second;
  }

 private:
  std::vector<std::pair<double, double>> keys_;
};

}  // namespace limber::generate
