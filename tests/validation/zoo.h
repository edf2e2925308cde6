#pragma once

#include <algorithm>
#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "assets/model/rig.h"
#include "solver/ik_solver.h"
#include "validation/limit_check.h"

namespace limber::test {

inline Eigen::Quaterniond random_rotation(std::mt19937& random, double size) {
  std::normal_distribution<double> normal;
  return rotation_exp(
      Eigen::Vector3d(size * Eigen::Vector3d(normal(random), normal(random), normal(random))));
}

inline RigJoint joint(std::string name, std::int32_t parent, JointType type,
                      const Eigen::Vector3d& offset) {
  RigJoint j;
  j.name = std::move(name);
  j.parent = parent;
  j.type = type;
  j.offset = offset;
  return j;
}

/// Every joint type on one tree, and every effector kind on its tips.
inline Rig zoo() {
  std::mt19937 random(5);
  Rig rig;
  rig.joints = {joint("root", kNoJoint, JointType::free, {0, 1, 0}),
                joint("spine", 0, JointType::ball, {0, 0.2, 0}),
                joint("plate", 1, JointType::fixed, {0, 0.1, 0.05}),
                joint("shoulder", 2, JointType::ball, {0.2, 0.1, 0}),
                joint("elbow", 3, JointType::hinge, {0.3, 0, 0}),
                joint("wrist", 4, JointType::universal, {0.25, 0, 0}),
                joint("neck", 2, JointType::ball, {0, 0.25, 0})};
  for (RigJoint& j : rig.joints) j.rest = random_rotation(random, 0.5);
  rig.joints[1].limits = {Range{-0.7, 0.5}, Range{-0.4, 0.6}, Range{-0.5, 0.5}};
  rig.joints[3].limits = {Range{-1.4, 1.0}, Range{-0.9, 1.5}, Range{-1.0, 1.2}};
  rig.joints[4].limits[0] = {-0.1, 2.4};
  rig.joints[5].limits = {Range{-0.6, 0.6}, Range{-1.0, 1.0}, Range{}};
  const auto effector = [](std::string name, std::int32_t on, EffectorKind kind) {
    RigEffector e;
    e.name = std::move(name);
    e.joint = on;
    e.kind = kind;
    e.offset = {0.05, -0.02, 0.03};
    e.axis = Eigen::Vector3d(1, 2, -2) / 3.0;
    e.weight_pos = 1.3;
    e.weight_rot = 0.7;
    return e;
  };
  rig.effectors = {
      effector("pelvis", 0, EffectorKind::pose),      effector("hand", 5, EffectorKind::position),
      effector("palm", 5, EffectorKind::orientation), effector("gaze", 6, EffectorKind::direction),
      effector("tool", 5, EffectorKind::line),        effector("head", 6, EffectorKind::pose),
      effector("look", 6, EffectorKind::gaze)};
  return rig;
}

/// The same with what joins branches: effectors relative to other joints, above, below and beside
/// them, and coupled coordinates.
inline Rig joined_zoo() {
  Rig rig = zoo();
  const std::int32_t bases[] = {5, 6, 1, 4, 0, 3};
  for (std::size_t e = 0; e < rig.effectors.size(); ++e) rig.effectors[e].relative_to = bases[e];
  rig.couplings = {{4, 0, 5, 1, 0.4, -0.1}, {1, 2, 5, 0, -0.5, 0.05}};
  return rig;
}

/// A pose within the limits; `reach` 1 fills them, swings included.
inline std::vector<DualQuaternion> random_pose(const Rig& rig, std::mt19937& random, double reach) {
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  std::vector<DualQuaternion> pose;
  for (const RigJoint& j : rig.joints) {
    const auto within = [&](const Range& range) {
      const double u = reach * unit(random);
      return u < 0 ? -u * range.min : u * range.max;
    };
    Eigen::Quaterniond r = Eigen::Quaterniond::Identity();
    Eigen::Vector3d t = j.offset;
    if (j.type == JointType::hinge)
      r = rotation_exp(Eigen::Vector3d(within(j.limits[0]) * j.axes[0]));
    if (j.type == JointType::universal) {
      r = rotation_exp(Eigen::Vector3d(within(j.limits[0]) * j.axes[0])) *
          rotation_exp(Eigen::Vector3d(within(j.limits[1]) * j.axes[1]));
    }
    if (j.type == JointType::ball && j.limited()) {
      const Eigen::Vector3d swing =
          M_SQRT1_2 * (within(j.limits[0]) * j.axes[0] + within(j.limits[1]) * j.axes[1]);
      r = rotation_exp(swing) * rotation_exp(Eigen::Vector3d(within(j.limits[2]) * j.axes[2]));
    }
    if (j.type == JointType::free || (j.type == JointType::ball && !j.limited())) {
      r = random_rotation(random, 0.6 * reach);
    }
    if (j.type == JointType::free)
      t += reach * Eigen::Vector3d(unit(random), unit(random), unit(random));
    pose.push_back(DualQuaternion::from_rotation_translation(j.rest * r, t));
  }
  return pose;
}

inline std::vector<EffectorTarget> targets_at(const Rig& rig,
                                              const std::vector<DualQuaternion>& pose) {
  std::vector<DualQuaternion> world(pose.size());
  model_from_local(skeleton_of(rig), pose, world);
  std::vector<EffectorTarget> targets;
  for (const RigEffector& e : rig.effectors) {
    const double ahead = e.kind == EffectorKind::gaze ? 0.9 : 0.0;  // what is looked at
    const Eigen::Vector3d place = e.offset + ahead * e.axis;
    targets.push_back({world[e.joint] * DualQuaternion::from_translation(place), 1.0});
    if (e.relative_to == kNoJoint) continue;
    targets.back().pose = world[e.relative_to].conjugate() * targets.back().pose;
  }
  return targets;
}

inline double worst_excess(const Rig& rig, const std::vector<DualQuaternion>& pose) {
  double worst = 0.0;
  for (std::size_t i = 0; i < pose.size(); ++i) {
    worst = std::max(worst, limit_excess(rig.joints[i], pose[i].rotation()));
  }
  return worst;
}

}  // namespace limber::test
