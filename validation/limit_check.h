#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "assets/model/clip.h"
#include "assets/model/rig.h"

namespace limber {

/// A joint-frame beyond its limit.
struct LimitFinding {
  std::int32_t joint = 0;
  std::int64_t frame = 0;
  double excess_rad = 0.0;
};

struct LimitReport {
  std::int32_t joints = 0;          ///< joints that were checked
  std::int64_t violations = 0;      ///< joint-frames beyond the tolerance
  double max_violation_deg = 0.0;   ///< largest excess, below the tolerance or not
  std::vector<LimitFinding> worst;  ///< violations, the largest first, at most 20
};

/// Checks every frame of `clip` (parent_from_joint, same joints as the rig) against the rig's
/// limits, from the definition in rig.h alone; shares no code with the solver. Hinges and
/// universal joints are checked for off-axis rotation even where their range is unlimited; fixed
/// and free joints and unlimited balls are not checked.
LimitReport check_joint_limits(const Rig&, const Clip&, double tolerance_rad = 1e-4);

/// Radians by which one joint is beyond its limit; 0 inside.
///  - hinge, universal: angle to the nearest allowed rotation, off-axis rotation included;
///  - ball: root of the sum of squares of the twist's distance from its range and the swing's
///    distance from its ellipse, in the plane of (swing0, swing1).
double limit_excess(const RigJoint&, const Eigen::Quaterniond& parent_from_joint);

/// Bounds between the classes by which frames beyond a limit are counted, degrees: up to 2, up to
/// 5, ..., more than 45.
inline constexpr std::array<double, 5> kExcessEdgesDeg = {2.0, 5.0, 10.0, 20.0, 45.0};

/// How one joint goes beyond its limit over a clip.
struct JointExcess {
  std::int32_t joint = 0;
  std::int64_t frames = 0;  ///< frames beyond the tolerance
  double max_deg = 0.0;
  /// The same frames by how far beyond they are; the classes of kExcessEdgesDeg.
  std::array<std::int64_t, kExcessEdgesDeg.size() + 1> frames_by_excess{};
};

/// Who goes beyond limits in a clip, and when.
struct ClipExcess {
  std::vector<JointExcess> joints;  ///< with a frame beyond the tolerance, in joint order
  std::vector<double> max_deg;      ///< [frame] largest excess of any joint
};

/// The same check, told by joint and by frame. On a source's motion carried to the rig without
/// limits it says which joints a solver must bend.
ClipExcess limit_excess(const Rig&, const Clip&, double tolerance_rad = 1e-4);

/// Joints that come within `margin_rad` of a limit in some frame (or beyond it), in joint order.
std::vector<std::int32_t> joints_at_limit(const Rig&, const Clip&, double margin_rad = 0.01);

/// A limit that a joint sits on.
struct LimitContact {
  std::int32_t joint = 0;
  const char* coordinate = "";  ///< angle (hinge), angle0, angle1 (universal), swing, twist (ball)
  const char* side = "";        ///< min, max; border for a ball's swing
};

/// The limits within `margin_rad` of which the joints of one pose stand, in joint order. Ranges
/// narrower than two margins are locked, and left out.
std::vector<LimitContact> limit_contacts(const Rig&,
                                         std::span<const DualQuaternion> parent_from_joint,
                                         double margin_rad = 2e-3);

/// How long the joints of a clip stand on their limits.
struct LimitOccupancy {
  std::vector<std::int64_t> frames;  ///< [joint] frames in which it stands on a limit
  std::vector<std::int32_t> joints;  ///< [frame] joints that do
};
LimitOccupancy limit_occupancy(const Rig&, const Clip&, double margin_rad = 2e-3);

}  // namespace limber
