#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <span>

#include "assets/model/rig.h"

namespace limber {

/// R = swing twist; twist in (-pi, pi] about axes[2], swing = exp(s0 axes[0] + s1 axes[1]).
struct SwingTwist {
  double swing0 = 0.0, swing1 = 0.0, twist = 0.0;  ///< rad
};

/// Decomposition about the triad `axes` (DESIGN: the one limit convention). Where the twist is
/// undefined (swing of pi) it is taken as zero.
SwingTwist decompose(const Eigen::Quaterniond& rotation,
                     const std::array<Eigen::Vector3d, 3>& axes);
Eigen::Quaterniond compose(const SwingTwist&, const std::array<Eigen::Vector3d, 3>& axes);

/// The swings a limited ball allows, (s0/S0)^2 + (s1/S1)^2 <= 1 with S the bound on that side's
/// sign: four quarter ellipses that meet with a common tangent, so the set is convex.
struct SwingEllipse {
  double min0, max0, min1, max1;  ///< rad; min <= 0 <= max

  /// A bound beyond pi has no meaning: the swing there is another, shorter one. Bounds stop a hair
  /// short of pi, where the twist would become undefined.
  static SwingEllipse of(const RigJoint& ball);

  /// The Euclidean nearest point (s0, s1) of the set; a point inside comes back as it is.
  Eigen::Vector2d project(const Eigen::Vector2d& swing) const;
  /// (s0/S0)^2 + (s1/S1)^2; infinite beside a side whose bound is zero.
  double level(const Eigen::Vector2d& swing) const;
  /// Curvature (1/rad) of the border in the quadrant of `swing`, which lies on the border.
  double curvature(const Eigen::Vector2d& swing) const;
};

/// An angle as the representative nearest to the middle of `range`; ranges of a full turn or more
/// are no limit.
bool is_limited(const Range&);
double wrap_into(const Range&, double angle);

/// The nearest rotation within the joint's limits: twist clamped, swing moved to the nearest point
/// of its ellipse. Rotations already inside come back unchanged, bit for bit.
Eigen::Quaterniond project_into_limits(const RigJoint&, const Eigen::Quaterniond& rotation);

/// Projects every limited joint of a pose. Hinge and universal joints also lose what they cannot
/// express. Fixed joints go to their rest.
void project_into_limits(const Rig&, std::span<DualQuaternion> parent_from_joint);
/// The same for one joint of it.
void project_joint(const Rig&, std::int32_t joint, std::span<DualQuaternion> parent_from_joint);

}  // namespace limber
