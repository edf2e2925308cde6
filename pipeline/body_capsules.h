#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "assets/model/rig.h"
#include "pipeline/calibration.h"
#include "pipeline/figure.h"

namespace limber {

/// Parts of a body that pass through each other when proportions change.
enum class BodyPart : std::uint8_t {
  torso,
  head,
  leftThigh,
  rightThigh,
  leftForearm,
  rightForearm,
  leftHand,
  rightHand,
};
inline constexpr std::size_t kBodyPartCount = 8;

/// The capsule of a part, on one joint. The trunk's reaches from the hips to the chest.
struct PartCapsule {
  BodyPart part = BodyPart::torso;
  std::int32_t joint = 0, end_joint = 0;  ///< of the skeleton: what carries its two ends
  Capsule capsule;                        ///< `from` in the joint's space, `to` in the end joint's
  /// The trunk's: the joints of both thighs and both upper arms, kNoJoint for other parts. Its axis
  /// lies on the line between the middles of either two, wherever a pose has them.
  std::array<std::int32_t, 4> trunk{kNoJoint, kNoJoint, kNoJoint, kNoJoint};

  /// In model space.
  Capsule placed(std::span<const DualQuaternion> model_from_joint) const;
};

/// Two parts that are to stay apart: an arm's and one that is no neighbour of it.
struct PartPair {
  BodyPart a = BodyPart::torso, b = BodyPart::torso;
};
std::span<const PartPair> part_pairs();

/// The parts of a body as its stature makes them, placed in the calibrated T-pose (see
/// body_capsules.cpp). Parts that the figure lacks are left out; a hand alone has none.
std::vector<PartCapsule> body_capsules(const Figure&, const Calibration&);

/// Where two parts are nearest to each other, m.
struct PartGap {
  double gap = std::numeric_limits<double>::infinity();  ///< below 0 they overlap
  std::int32_t joint_a = kNoJoint, joint_b = kNoJoint;   ///< of the nearer ends
  Eigen::Vector3d on_a = Eigen::Vector3d::Zero();        ///< on the axes, model space
  Eigen::Vector3d on_b = Eigen::Vector3d::Zero();
};

/// Gaps in a pose, one per part_pairs(); infinite where a part is missing.
void part_gaps(std::span<const PartCapsule>, std::span<const DualQuaternion> model_from_joint,
               std::span<PartGap> gaps);

/// The size that girths go with (m): about the stature.
double girth_scale(const Figure&, const Calibration&);

}  // namespace limber
