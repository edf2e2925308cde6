#include "pipeline/foot_reference.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kStanceShare = 0.15;  // of the frames: those in which the ankle is lowest

}  // namespace

Quaterniond yaw_to_front(const Vector3d& direction) {
  return Quaterniond(
      Eigen::AngleAxisd(-std::atan2(direction.x(), direction.z()), Vector3d::UnitY()));
}

double stance_tilt_deg(const Skeleton& skeleton, const Clip& clip, std::int32_t foot,
                       const Quaterniond& level_rotation) {
  const Vector3d up_in_joint = level_rotation.conjugate() * Vector3d::UnitY();
  std::vector<DualQuaternion> model(skeleton.parents.size());
  std::vector<std::pair<double, double>> height_and_tilt;
  for (std::int64_t f = 0; f < clip.frames(); ++f) {
    model_from_local(skeleton, clip.frame(f), model);
    const double cosine = (model[foot].rotation() * up_in_joint).y();
    height_and_tilt.emplace_back(model[foot].translation().y(),
                                 std::acos(std::clamp(cosine, -1.0, 1.0)) * 180.0 / M_PI);
  }
  if (height_and_tilt.empty()) return 0.0;
  std::sort(height_and_tilt.begin(), height_and_tilt.end());
  const auto standing = std::max<std::size_t>(
      1, static_cast<std::size_t>(kStanceShare * double(height_and_tilt.size())));
  std::vector<double> tilt;
  for (std::size_t i = 0; i < standing; ++i) tilt.push_back(height_and_tilt[i].second);
  std::nth_element(tilt.begin(), tilt.begin() + std::ptrdiff_t(standing / 2), tilt.end());
  return tilt[standing / 2];
}

}  // namespace limber
