#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "assets/model/result.h"
#include "assets/model/screw.h"

namespace limber {

/// m; a target nearer to an eye than this is at it: no direction leads there.
constexpr double kNearestGaze = 1e-4;

/// An eye in a head on a shoulder that stands still (Leclercq, Lefevre & Blohm 2013, section 3.1).
/// The spaces are centred where each turns; both offsets are rigid. Metres, radians, seconds.
struct EyeHeadShoulder {
  Eigen::Vector3d head_in_shoulder = Eigen::Vector3d::Zero();
  Eigen::Vector3d eye_in_head = Eigen::Vector3d::Zero();
  Eigen::Quaterniond shoulder_from_head{1, 0, 0, 0};
  Eigen::Quaterniond head_from_eye{1, 0, 0, 0};
  Eigen::Vector3d head_turn = Eigen::Vector3d::Zero();  ///< head on shoulder, rad/s, shoulder axes
  Eigen::Vector3d eye_turn = Eigen::Vector3d::Zero();   ///< eye in head, rad/s, head axes
};

/// The chain of eqs. 16 and 17: translation and rotation of the head, then of the eye.
MovingTransform shoulder_from_eye(const EyeHeadShoulder&);

/// What an eye knows of a target, in the eye's space. `direction` is the target's (the paper's
/// projection on a retina of radius 1, turned to the front); only depth and its rate, which one eye
/// has to guess, tell where on that ray the target is.
struct RetinalImage {
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  ///< unit
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();    ///< of `direction`, across it, 1/s
  double depth = 0.0;                                    ///< eye to target, m
  double depth_rate = 0.0;                               ///< m/s
};

/// The image of a target given in the shoulder's space. Error: `target-at-eye`, which has none.
Result<RetinalImage> retinal_image(const EyeHeadShoulder&, const MovingPoint& target_in_shoulder);

/// And back: where in the shoulder's space, and how fast there.
MovingPoint target_from_image(const EyeHeadShoulder&, const RetinalImage&);

}  // namespace limber
