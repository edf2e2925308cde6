#include "assets/model/fick.h"

#include <cmath>

namespace limber {

using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

Quaterniond rotation_from_fick(const Fick& fick) {
  return AngleAxisd(fick.left, Vector3d::UnitY()) * AngleAxisd(fick.down, Vector3d::UnitX()) *
         AngleAxisd(fick.clockwise, Vector3d::UnitZ());
}

Fick fick_from_rotation(const Quaterniond& rotation) {
  const Vector3d ahead = rotation * Vector3d::UnitZ();
  Fick fick;
  fick.left = std::atan2(ahead.x(), ahead.z());
  fick.down = std::atan2(-ahead.y(), std::hypot(ahead.x(), ahead.z()));
  // The left side after undoing `left`: whatever was chosen near the poles, this makes up for it.
  const AngleAxisd back(-fick.left, Vector3d::UnitY());
  const Vector3d side = back * (rotation * Vector3d::UnitX());
  const Vector3d up = back * (rotation * Vector3d::UnitY());
  fick.clockwise = std::atan2(-up.x(), side.x());
  return fick;
}

}  // namespace limber
