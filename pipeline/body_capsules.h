#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "assets/model/character.h"
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

/// A capsule of a part; a torso has one on each of its joints.
struct PartCapsule {
  BodyPart part = BodyPart::torso;
  std::int32_t joint = 0;  ///< of the skeleton
  Capsule capsule;         ///< in the joint's space
};

/// Two parts that are to stay apart: an arm's and one that is no neighbour of it.
struct PartPair {
  BodyPart a = BodyPart::torso, b = BodyPart::torso;
};
std::span<const PartPair> part_pairs();

/// What stature and girth make of a body's parts in the calibrated T-pose, fitted to its mesh where
/// it has one (see body_capsules.cpp). Parts that the figure lacks are left out; a hand alone has
/// none.
std::vector<PartCapsule> body_capsules(const Character&, const Figure&, const Calibration&);

/// Gaps between the parts (m), one per part_pairs(), in a pose; infinite where a part is missing.
void part_gaps(std::span<const PartCapsule>, std::span<const DualQuaternion> model_from_joint,
               std::span<double> gaps);

/// The size that girths go with (m): about the stature.
double girth_scale(const Figure&, const Calibration&);

}  // namespace limber
