#pragma once

#include <algorithm>
#include <cstdint>
#include <span>

#include "assets/model/dual_quaternion.h"

namespace limber {

// Ways from one solution of a clip to another, joint by joint.

inline constexpr double kMostBend = 3e-3;        ///< rad per frame^2, of such a way
inline constexpr std::int64_t kShortestWay = 8;  ///< frames

/// From 0 to 1 as u does, at rest at both ends.
inline double ease(double u) { return u * u * (3.0 - 2.0 * u); }

/// from moved by the part w of the motion that leads from a to b.
inline DualQuaternion moved(const DualQuaternion& from, const DualQuaternion& a,
                            const DualQuaternion& b, double w) {
  const Eigen::Quaterniond turn =
      Eigen::Quaterniond::Identity().slerp(w, a.rotation().conjugate() * b.rotation());
  return DualQuaternion::from_rotation_translation(
      (from.rotation() * turn).normalized(),
      from.translation() + w * (b.translation() - a.translation()));
}

/// The largest angle (rad) of any joint between two poses.
inline double largest_turn(std::span<const DualQuaternion> a, std::span<const DualQuaternion> b) {
  double most = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    most = std::max(most, rotation_angle(a[i].rotation(), b[i].rotation()));
  }
  return most;
}

}  // namespace limber
