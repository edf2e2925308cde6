#pragma once

#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "assets/model/rig.h"
#include "importers/rig_json.h"
#include "solver/ik_solver.h"
#include "solver/swing_twist.h"
#include "tests/model/random_motion.h"

namespace limber::test {

inline Eigen::Quaterniond about(const Eigen::Vector3d& axis, double angle) {
  return Eigen::Quaterniond(Eigen::AngleAxisd(angle, axis));
}

/// A rig as it is shipped.
inline Rig shipped_rig(const std::string& name) {
  std::ifstream file(std::string(LIMBER_SOURCE_DIR) + "/assets/data/rigs/" + name + ".json");
  std::stringstream text;
  text << file.rdbuf();
  Result<Rig> rig = read_rig_json(text.str());
  if (!rig) throw std::runtime_error(name + ": " + rig.error().message);
  return std::move(rig.value());
}

inline IkSolver make_solver(const Rig& rig, const IkOptions& options = {}) {
  Result<IkSolver> solver = IkSolver::create(rig, options);
  if (!solver) throw std::runtime_error(solver.error().message);
  return std::move(solver.value());
}

inline Pose rest_pose(const Rig& rig) {
  Pose pose(rig.joints.size());
  pose_from_coordinates(rig, std::vector<double>(dof_count(rig), 0.0), pose);
  project_into_limits(rig, pose);
  return pose;
}

/// The rig with a posture: a weak pull on every joint's orientation, joint by joint.
inline Rig with_posture(Rig rig, double weight_rot = 1.0) {
  for (std::int32_t j = 0; j < rig.size(); ++j) {
    RigEffector posture;
    posture.name = "posture " + rig.joints[j].name;
    posture.joint = j;
    posture.kind = EffectorKind::orientation;
    posture.strong = false;
    posture.weight_rot = weight_rot;
    rig.effectors.push_back(posture);
  }
  return rig;
}

inline RigJoint random_joint(Random& random, JointType type, std::int32_t parent, int index) {
  RigJoint joint;
  joint.name = "joint" + std::to_string(index);
  joint.parent = parent;
  joint.type = type;
  joint.offset = random.vector(0.3);
  joint.rest = random.rotation();
  const Eigen::Matrix3d triad = random.rotation().toRotationMatrix();
  for (int k = 0; k < 3; ++k) joint.axes[k] = triad.col(k);
  if (type == JointType::fixed || type == JointType::free) return joint;
  for (int k = 0; k < 3; ++k) {
    joint.limits[k] = {-random.uniform(0.05, 1.5), random.uniform(0.05, 1.5)};
  }
  return joint;
}

/// A tree of every joint type, some limits off, some of no width, and effectors of every kind.
inline Rig random_rig(Random& random, int joints, int effectors) {
  const JointType types[] = {JointType::hinge, JointType::universal, JointType::ball,
                             JointType::ball,  JointType::free,      JointType::fixed};
  Rig rig;
  rig.name = "random";
  for (int i = 0; i < joints; ++i) {
    const JointType type = types[random.integer(0, 5)];
    const std::int32_t parent = i == 0 ? -1 : random.integer(std::max(0, i - 3), i - 1);
    RigJoint joint = random_joint(random, type, parent, i);
    if (type != JointType::free && type != JointType::fixed && random.integer(0, 5) == 0) {
      joint.limits = {};
    } else if (random.integer(0, 7) == 0) {
      joint.limits[random.integer(0, 2)] = {0.0, 0.0};
    }
    rig.joints.push_back(joint);
  }
  const EffectorKind kinds[] = {EffectorKind::pose,        EffectorKind::position,
                                EffectorKind::orientation, EffectorKind::direction,
                                EffectorKind::line,        EffectorKind::gaze};
  for (int e = 0; e < effectors; ++e) {
    RigEffector effector;
    effector.name = "effector" + std::to_string(e);
    effector.joint = random.integer(0, joints - 1);
    effector.offset = random.vector(0.2);
    effector.kind = kinds[e % 6];
    effector.axis = random.unit();
    effector.weight_pos = random.uniform(0.3, 2.0);
    effector.weight_rot = random.uniform(0.3, 2.0);
    rig.effectors.push_back(effector);
  }
  return rig;
}

/// A rotation inside a joint's limits, made from the definition, edges included.
inline Eigen::Quaterniond allowed_rotation(Random& random, const RigJoint& joint,
                                           double fill = 1.0) {
  const auto within = [&](const Range& range) {
    if (!joint.limited()) return random.uniform(-2.0, 2.0);
    const double middle = 0.5 * (range.min + range.max), half = 0.5 * (range.max - range.min);
    return middle + fill * half * random.uniform(-1.0, 1.0);
  };
  switch (joint.type) {
    case JointType::hinge:
      return about(joint.axes[0], within(joint.limits[0]));
    case JointType::universal:
      return about(joint.axes[0], within(joint.limits[0])) *
             about(joint.axes[1], within(joint.limits[1]));
    case JointType::ball: {
      const double a = random.uniform(-M_PI, M_PI), r = fill * std::sqrt(random.uniform(0, 1));
      const double x = r * std::cos(a), y = r * std::sin(a);
      double s0 = x, s1 = y;
      if (joint.limited()) {
        s0 = x * (x < 0 ? -joint.limits[0].min : joint.limits[0].max);
        s1 = y * (y < 0 ? -joint.limits[1].min : joint.limits[1].max);
      }
      const Eigen::Vector3d s = s0 * joint.axes[0] + s1 * joint.axes[1];
      const Eigen::Quaterniond swing =
          s.norm() > 0.0 ? about(s.normalized(), s.norm()) : Eigen::Quaterniond::Identity();
      return swing * about(joint.axes[2], within(joint.limits[2]));
    }
    default:
      return Eigen::Quaterniond::Identity();
  }
}

inline Pose allowed_pose(Random& random, const Rig& rig, double fill = 1.0) {
  Pose pose;
  for (const RigJoint& joint : rig.joints) {
    const bool free = joint.type == JointType::free;
    const Eigen::Quaterniond r = free ? random.rotation() : allowed_rotation(random, joint, fill);
    const Eigen::Vector3d slide =
        free ? random.vector(0.5) : Eigen::Vector3d(Eigen::Vector3d::Zero());
    pose.push_back(DualQuaternion::from_rotation_translation(joint.rest * r, joint.offset + slide));
  }
  return pose;
}

inline Pose world_of(const Rig& rig, const Pose& pose) {
  Pose world(pose.size());
  model_from_local(skeleton_of(rig), pose, world);
  return world;
}

/// Targets that the pose meets exactly.
inline std::vector<EffectorTarget> targets_at(const Rig& rig, const Pose& pose) {
  const Pose world = world_of(rig, pose);
  std::vector<EffectorTarget> targets;
  for (const RigEffector& effector : rig.effectors) {
    const DualQuaternion& joint = world[effector.joint];
    // What is looked at lies ahead of the eye.
    const double ahead = effector.kind == EffectorKind::gaze ? 0.8 : 0.0;
    targets.push_back(
        {.pose = DualQuaternion::from_rotation_translation(
             joint.rotation(), joint.transform_point(effector.offset + ahead * effector.axis))});
  }
  return targets;
}

/// By how much (rad) a rotation is beyond its joint's limits. Straight from the definition and from
/// how vectors turn: the swing is the shortest turn that takes the twist axis where it went.
inline double excess(const RigJoint& joint, const Eigen::Quaterniond& rotation) {
  const auto beyond = [](const Range& range, double angle) {
    double least = std::numeric_limits<double>::infinity();
    for (const double turns : {-1.0, 0.0, 1.0}) {
      const double a = angle + 2.0 * M_PI * turns;
      least = std::min(least, std::max({0.0, range.min - a, a - range.max}));
    }
    return least;
  };
  const auto turn_about = [](const Eigen::Vector3d& axis, const Eigen::Quaterniond& r) {
    const Eigen::Vector3d side = axis.unitOrthogonal(), turned = r * side;
    return std::atan2(axis.dot(side.cross(turned)), side.dot(turned));
  };
  const bool limited = joint.limited();
  if (joint.type == JointType::fixed)
    return rotation.angularDistance(Eigen::Quaterniond::Identity());
  if (joint.type == JointType::hinge) {
    const double off = (rotation * joint.axes[0] - joint.axes[0]).norm();
    const double angle = turn_about(joint.axes[0], rotation);
    return std::max(off, limited ? beyond(joint.limits[0], angle) : 0.0);
  }
  if (joint.type == JointType::universal) {
    // R a1 = R0 a1 turns about a0; R* a0 = R1* a0 turns about a1.
    const Eigen::Vector3d a0 = joint.axes[0], a1 = joint.axes[1];
    const Eigen::Vector3d b1 = rotation * a1, b0 = rotation.conjugate() * a0;
    const double q0 = std::atan2(a0.dot(a1.cross(b1)), a1.dot(b1));
    const double q1 = std::atan2(a1.dot(b0.cross(a0)), b0.dot(a0));
    const double off = (about(a0, q0) * about(a1, q1)).angularDistance(rotation);
    if (!limited) return off;
    return std::max({off, beyond(joint.limits[0], q0), beyond(joint.limits[1], q1)});
  }
  if (joint.type != JointType::ball || !limited) return 0.0;
  const Eigen::Vector3d z = joint.axes[2], went = rotation * z;
  const Eigen::Vector3d across = z.cross(went);
  const double angle = std::atan2(across.norm(), z.dot(went));
  const Eigen::Vector3d s =
      across.norm() > 1e-300 ? Eigen::Vector3d(angle * across.normalized()) : across;
  const Eigen::Quaterniond swing =
      angle > 0.0 ? about(s.normalized(), angle) : Eigen::Quaterniond::Identity();
  const double twist = turn_about(z, swing.conjugate() * rotation);
  const double s0 = s.dot(joint.axes[0]), s1 = s.dot(joint.axes[1]);
  // The nearest of three points of the ellipse: towards its middle and towards either axis (a thin
  // ellipse's border is no place to tell distances radially); a side of no width counts by itself.
  const double a = s0 < 0 ? -joint.limits[0].min : joint.limits[0].max;
  const double b = s1 < 0 ? -joint.limits[1].min : joint.limits[1].max;
  double out = 0.0;
  if (a == 0.0 || b == 0.0) {
    out = std::max({0.0, std::abs(s0) - a, std::abs(s1) - b});
  } else {
    const double level = std::hypot(s0 / a, s1 / b);
    const auto along_axis = [](double s, double t, double half_s, double half_t) {
      const double at = std::min(std::abs(s), half_s);
      const double width = half_t * std::sqrt(1.0 - (at / half_s) * (at / half_s));
      return std::hypot(std::abs(s) - at, std::max(0.0, std::abs(t) - width));
    };
    if (level > 1.0) {
      out = std::min({std::hypot(s0, s1) * (1.0 - 1.0 / level), along_axis(s0, s1, a, b),
                      along_axis(s1, s0, b, a)});
    }
  }
  return std::max(out, beyond(joint.limits[2], twist));
}

inline double worst_excess(const Rig& rig, const Pose& pose) {
  double worst = 0.0;
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    const Eigen::Quaterniond r = rig.joints[i].rest.conjugate() * pose[i].rotation();
    worst = std::max(worst, excess(rig.joints[i], r));
    if (rig.joints[i].type != JointType::free) {
      worst = std::max(worst, (pose[i].translation() - rig.joints[i].offset).norm());
    }
  }
  return worst;
}

/// The objective from its definition alone (assets/model/rig.h, solver/ik_solver.h).
inline double objective(const Rig& rig, const std::vector<EffectorTarget>& targets,
                        const Pose& pose) {
  std::vector<Eigen::Matrix4d> world(pose.size());
  double cost = 0.0;
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    const std::int32_t parent = rig.joints[i].parent;
    world[i] = parent < 0 ? pose[i].matrix() : Eigen::Matrix4d(world[parent] * pose[i].matrix());
  }
  for (std::size_t e = 0; e < targets.size(); ++e) {
    const RigEffector& f = rig.effectors[e];
    const Eigen::Matrix3d have = world[f.joint].topLeftCorner<3, 3>();
    const Eigen::Matrix3d want = targets[e].pose.matrix().topLeftCorner<3, 3>();
    Eigen::Vector3d miss = targets[e].pose.matrix().topRightCorner<3, 1>() -
                           (world[f.joint] * f.offset.homogeneous()).head<3>();
    const bool gaze = f.kind == EffectorKind::gaze;
    const Eigen::Vector3d wanted_axis = gaze ? miss.normalized() : Eigen::Vector3d(want * f.axis);
    double angle = Eigen::AngleAxisd(Eigen::Matrix3d(want * have.transpose())).angle();
    if (f.kind == EffectorKind::direction || f.kind == EffectorKind::line || gaze) {
      const Eigen::Vector3d axis = have * f.axis;
      angle = std::atan2(axis.cross(wanted_axis).norm(), axis.dot(wanted_axis));
    }
    if (f.kind == EffectorKind::line) miss -= wanted_axis * wanted_axis.dot(miss);
    const bool placed = f.kind == EffectorKind::pose || f.kind == EffectorKind::position ||
                        f.kind == EffectorKind::line;
    const double w2 = targets[e].weight * targets[e].weight;
    if (placed) cost += w2 * std::pow(f.weight_pos, 2) * miss.squaredNorm();
    if (f.kind != EffectorKind::position) cost += w2 * std::pow(0.1 * f.weight_rot * angle, 2);
  }
  return cost;
}

}  // namespace limber::test
