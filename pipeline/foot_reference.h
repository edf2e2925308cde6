#pragma once

#include <Eigen/Geometry>
#include <map>
#include <span>

#include "assets/model/character.h"
#include "assets/model/clip.h"
#include "pipeline/figure.h"

namespace limber {

/// Turn about +Y that brings the horizontal part of `direction` onto +Z.
Eigen::Quaterniond yaw_to_front(const Eigen::Vector3d& direction);

/// Median angle in degrees between a foot's sole and the ground over the frames in which its ankle
/// is lowest, where the sole is level when the joint has `level_rotation` in the world.
double stance_tilt_deg(const Skeleton&, const Clip&, std::int32_t foot,
                       const Eigen::Quaterniond& level_rotation);

}  // namespace limber
