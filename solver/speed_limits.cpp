#include "solver/speed_limits.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace limber {

SpeedLimits::SpeedLimits(const Rig& rig, const IkTree& tree, double dt)
    : min_(tree.min), max_(tree.max) {
  reach_.setConstant(tree.coordinate_count(), std::numeric_limits<double>::infinity());
  for (const IkNode& node : tree.nodes) {
    const double reach = rig.joints[node.joint].max_speed * dt;
    if (reach == 0.0) continue;
    any_ = true;
    for (std::int32_t i = 0; i < node.coordinates; ++i) {
      const bool slide = node.type == JointType::free && i < 3;
      const bool boxed = node.type == JointType::hinge || node.type == JointType::universal ||
                         (node.chart && (i == 2 || !node.ellipse)) || slide;
      if (boxed) reach_[node.coordinate + i] = reach;
    }
  }
}

void SpeedLimits::narrow(const IkState& previous, IkTree& tree, IkState& start) const {
  if (!any_) return;
  for (Eigen::Index k = 0; k < reach_.size(); ++k) {
    if (!std::isfinite(reach_[k])) continue;
    const double from = std::clamp(previous.x[k], min_[k], max_[k]);
    tree.min[k] = std::max(min_[k], from - reach_[k]);
    tree.max[k] = std::min(max_[k], from + reach_[k]);
  }
  for (const IkNode& node : tree.nodes) {
    if (node.type != JointType::hinge && node.type != JointType::universal) continue;
    for (std::int32_t k = node.coordinate; k < node.coordinate + node.coordinates; ++k) {
      if (std::isfinite(min_[k]) || !std::isfinite(reach_[k])) continue;
      // Without limits an angle may have gone round: take the turn nearest to the frame before.
      start.x[k] = previous.x[k] + std::remainder(start.x[k] - previous.x[k], 2.0 * M_PI);
    }
  }
  tree.project(start.x);
}

void SpeedLimits::widen(IkTree& tree) const {
  if (!any_) return;
  tree.min = min_;
  tree.max = max_;
}

}  // namespace limber
