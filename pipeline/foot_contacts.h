#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <vector>

#include "pipeline/humanoid.h"
#include "pipeline/target.h"

namespace limber {

/// One foot over a clip: what the source's did, and where the target's is to be.
struct FootPath {
  double rate_hz = 0.0;
  double speed_scale = 1.0;  ///< source stature / 1.75 m: bigger figures move faster at rest, too
  std::vector<Eigen::Vector3d> source_ankle, source_toe;  ///< [frame], source world
  /// [frame], world, since the T-pose; in and out.
  std::vector<Eigen::Quaterniond> foot_turn, toes_turn;
  std::vector<Eigen::Vector3d> ankle;  ///< [frame], target world; in and out
  std::vector<double> hold;            ///< [frame], out: how much the ankle's place matters, 0 to 1
  std::vector<std::uint8_t> contact;   ///< [frame], out
  double floor_y = 0.0;                ///< of the target's world

  /// From the ankle, in the T-pose's axes (m): sole points and the toe joint.
  Eigen::Vector3d heel, ball, toe_joint, tip;
};

/// A path with the target foot's own geometry and no frames yet.
FootPath make_foot(const Target&, Side);

/// Pins the foot while the source's stands: the ankle, or the toes once the heel has left the
/// floor, keeps its place; what that moves the foot by is taken back while it swings. A foot whose
/// heel and ball both stand is made flat. Keeps every sole point on or above the floor, and the
/// lowest on it while the foot stands. The floor levels are
/// the heights of the source's ankles and toes when they stand.
void plant(FootPath&, double source_ankle_floor, double source_toe_floor);

}  // namespace limber
