#pragma once

#include <array>
#include <optional>
#include <string>

#include "assets/model/rig.h"
#include "pipeline/humanoid.h"

namespace limber {

/// How far a joint of the human body turns (assets/data/limits), in the axes of the calibrated
/// T-pose (+Y up, facing +Z, left +X, palms down). Ranges in radians.
struct AnatomicalLimit {
  JointType type = JointType::ball;
  std::array<Eigen::Vector3d, 3> axes;
  std::array<Range, 3> ranges;
  std::string citation;
};

/// The limit of one role; the right side is the left one mirrored. None: the role does not move.
std::optional<AnatomicalLimit> anatomical_limit(Role);

/// The range of the whole spine or neck, divided among its `joints`.
AnatomicalLimit shared_spine_limit(std::size_t joints);
AnatomicalLimit shared_neck_limit(std::size_t joints);

}  // namespace limber
