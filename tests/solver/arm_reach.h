#pragma once

#include <cmath>
#include <initializer_list>

#include "tests/solver/test_rigs.h"

namespace limber::test {

/// The reach of Leclercq, Lefevre & Blohm 2013, figure 4: a straight path to the arm's own side, up
/// and away, in 0.8 s and steps of 1 ms, with a bell-shaped speed of 1 m/s at its peak. A Gaussian
/// with a standard deviation of 0.1 s makes that 25.07 cm. The paper's arm is a right one; ours is
/// its mirror image.
struct ArmReach {
  static constexpr int kSteps = 800;
  static constexpr double kStep = 1e-3, kPeak = 1.0, kWidth = 0.1;  // s, m/s, s

  Eigen::Vector3d start{-0.1, -0.2, 0.3};
  Eigen::Vector3d direction = Eigen::Vector3d(1.0, 0.6, 0.6).normalized();
  Eigen::Quaterniond orientation{1, 0, 0, 0};      ///< at the start
  Eigen::Vector3d turn = Eigen::Vector3d::Zero();  ///< rad/s, constant

  static double speed(double t) {
    const double u = (t - 0.5 * kSteps * kStep) / kWidth;
    return kPeak * std::exp(-0.5 * u * u);
  }
  static double distance(double t) {
    const double scale = 1.0 / (kWidth * std::sqrt(2.0)), middle = 0.5 * kSteps * kStep;
    return kPeak * kWidth * std::sqrt(0.5 * M_PI) *
           (std::erf((t - middle) * scale) + std::erf(middle * scale));
  }

  /// Where the hand should be at a step, and how it should move there.
  MovingTransform at(int step) const {
    const double t = step * kStep;
    const Eigen::Vector3d p = start + distance(t) * direction;
    const Eigen::Quaterniond r = rotation_exp(Eigen::Vector3d(t * turn)) * orientation;
    return {DualQuaternion::from_rotation_translation(r, p),
            {turn, speed(t) * direction - turn.cross(p)}};
  }
};

inline Eigen::Vector3d effector_point(const Rig& rig, const Pose& pose, std::size_t effector = 0) {
  const RigEffector& e = rig.effectors[effector];
  return world_of(rig, pose)[e.joint].transform_point(e.offset);
}

/// The arm bent comfortably in front, as a start to solve from.
inline Pose bent_arm(const Rig& rig) {
  std::vector<double> q(dof_count(rig), 0.0);
  const Eigen::Vector3d upper = 0.4 * rig.joints[0].axes[1] - 0.8 * rig.joints[0].axes[0];
  std::copy(upper.data(), upper.data() + 3, q.begin());
  q[3] = 1.9;
  Pose pose(rig.joints.size());
  pose_from_coordinates(rig, q, pose);
  return pose;
}

/// arm3 with its tool as the effectors named: a point at its tip, a line along its shaft.
inline Rig tool_rig(std::initializer_list<EffectorKind> kinds) {
  Rig rig = shipped_rig("arm3");
  RigEffector tool = rig.effectors[0];
  tool.axis = Eigen::Vector3d::UnitY();  // the paper's screwdriver is held across the hand
  rig.effectors.clear();
  for (const EffectorKind kind : kinds) {
    tool.kind = kind;
    tool.name = to_string(kind);
    rig.effectors.push_back(tool);
  }
  return rig;
}

/// The three-link arm's reach: from there, its tool turning by 25 degrees on the way.
inline ArmReach tool_reach(const Rig& rig) {
  const Pose pose = bent_arm(rig);
  return {.start = effector_point(rig, pose),
          .orientation = world_of(rig, pose)[rig.effectors[0].joint].rotation(),
          .turn = {0.3, -0.4, 0.2}};
}

/// A pose whose effectors are where the reach begins.
inline Pose reach_start(const Rig& rig, const ArmReach& reach) {
  Result<IkSolver> solver = IkSolver::create(
      rig, {.stop_position_m = 1e-8, .stop_orientation_rad = 1e-8, .stop_cost = 0.0});
  Pose pose = bent_arm(rig);
  const std::vector<EffectorTarget> targets(rig.effectors.size(), {.pose = reach.at(0).a_from_b});
  const IkReport report = solver->solve(targets, pose);
  if (!report.reached) throw std::runtime_error("the reach begins out of reach");
  return pose;
}

}  // namespace limber::test
