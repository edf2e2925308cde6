#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <span>

#include "assets/model/rig.h"

namespace limber {

/// One border that a motion would cross, met early instead of at full speed.
///
/// Up to a knee below the border a coordinate stays as it is; from there on
///   y = x / (1 + c x), c = excess / (length margin), length = margin + excess,
/// with x and y counted from the knee. The slope is 1 at the knee (no jump of speed), falls
/// steadily and is (margin / length)^2 at the farthest point that the motion reaches, which comes
/// to lie on the border itself: nothing sticks there, nothing passes it.
class LimitApproach {
 public:
  /// The motion's `largest` coordinate against its border; at most `room` below the border is
  /// touched. A motion that stays below the border is left alone.
  LimitApproach(double border, double largest, double room);
  double operator()(double coordinate) const;

 private:
  double knee_, curve_;
};

/// Bends a joint's motion over a whole clip into its limits. `turns` are rotations from the joint's
/// rest, one per frame; `bone` is the way the bone points, in the joint's space. Hinges and
/// universal joints take the angles that point the bone where the turn does. Joints that never
/// leave their limits come back unchanged.
void bend_into_limits(const RigJoint&, const Eigen::Vector3d& bone,
                      std::span<Eigen::Quaterniond> turns);

}  // namespace limber
