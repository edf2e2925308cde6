#pragma once

#include <span>
#include <string>
#include <vector>

#include "assets/model/character.h"
#include "assets/model/result.h"
#include "pipeline/figure.h"

namespace limber {

/// A figure's calibrated T-pose: upright, facing +Z, its left along +X, limbs straight, arms out
/// sideways, palms down, thumbs forward, soles flat. Rotations compare between figures only
/// relative to it. Offsets are computed from geometry, never typed, and never from joint axes.
struct Calibration {
  std::vector<DualQuaternion> model_from_joint;  ///< the T-pose, [joint]; metres
  std::vector<Eigen::Vector3d> tip;              ///< where each joint's bone ends, in its space
  std::string reference;                         ///< rest, bind, reference-frame, frame:N, motion
  double residual_deg = 0.0;  ///< mean turn that limbs needed to get there from the reference
  double leg_length = 0.0;    ///< hip to ankle (m), mean of the legs that have both; else 0
  double hand_length = 0.0;   ///< wrist to the middle finger's first joint
  double ankle_height = 0.0;  ///< ankle above the sole
  double sole = 0.0;          ///< y of the sole in the T-pose
  double height = 0.0;        ///< from the sole to the highest joint

  Eigen::Vector3d position(std::int32_t joint) const {
    return model_from_joint[joint].translation();
  }
};

/// Target size over source size, from the leg segments that both figures have; from their heights
/// where they share none.
double size_ratio(const Figure& source_figure, const Calibration& source,
                  const Figure& target_figure, const Calibration& target);

/// Where the T-pose is computed from.
struct ReferenceChoice {
  enum Kind { automatic, rest, bind, frame, motion } kind = automatic;
  std::int64_t frame_index = 0;
};

/// Calibrates a figure. Tries the rest pose, the bind pose, a reference frame that import dropped
/// and, where none of them stands upright, the clip's frame that does so best.
/// Error: `calibration-failed`.
Result<Calibration> calibrate(const Character&, const Figure&, const ReferenceChoice&,
                              std::span<const DualQuaternion> reference_pose, const Clip* clip);

/// World rotation of joint j since the T-pose: model rotation times the T-pose's inverse.
inline Eigen::Quaterniond since_t_pose(const Calibration& calibration, std::int32_t joint,
                                       const DualQuaternion& model_from_joint) {
  return model_from_joint.rotation() * calibration.model_from_joint[joint].rotation().conjugate();
}

}  // namespace limber
