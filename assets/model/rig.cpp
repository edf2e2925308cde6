#include "assets/model/rig.h"

#include <cmath>
#include <unordered_set>

namespace limber {

std::int32_t dof_count(JointType type) {
  switch (type) {
    case JointType::fixed:
      return 0;
    case JointType::hinge:
      return 1;
    case JointType::universal:
      return 2;
    case JointType::ball:
      return 3;
    case JointType::free:
      return 6;
  }
  return 0;
}

const char* to_string(JointType type) {
  switch (type) {
    case JointType::fixed:
      return "fixed";
    case JointType::hinge:
      return "hinge";
    case JointType::universal:
      return "universal";
    case JointType::ball:
      return "ball";
    case JointType::free:
      return "free";
  }
  return "";
}

const char* to_string(EffectorKind kind) {
  switch (kind) {
    case EffectorKind::pose:
      return "pose";
    case EffectorKind::position:
      return "position";
    case EffectorKind::orientation:
      return "orientation";
    case EffectorKind::direction:
      return "direction";
    case EffectorKind::line:
      return "line";
    case EffectorKind::gaze:
      return "gaze";
  }
  return "";
}

std::int32_t Rig::find(const std::string& joint_name) const {
  for (std::int32_t i = 0; i < size(); ++i) {
    if (joints[i].name == joint_name) return i;
  }
  return kNoJoint;
}

std::int32_t Rig::find_role(const std::string& role) const {
  for (std::int32_t i = 0; i < size(); ++i) {
    if (joints[i].role == role) return i;
  }
  return kNoJoint;
}

namespace {

const char* find_fault(const Rig& rig, std::int32_t i) {
  const RigJoint& joint = rig.joints[i];
  const double inf = std::numeric_limits<double>::infinity();
  if (joint.name.empty()) return "the joint has no name";
  if (joint.parent < kNoJoint || joint.parent >= i) return "the joint comes before its parent";
  if (!joint.offset.allFinite()) return "the offset is not finite";
  if (!(std::abs(joint.rest.norm() - 1.0) < 1e-6)) return "the rest rotation is not unit";
  if (!(joint.weight > 0.0 && joint.weight < inf)) return "the weight is not above zero";
  if (!(joint.max_speed >= 0.0)) return "the largest speed is below zero";
  const int axes = joint.type == JointType::ball        ? 3
                   : joint.type == JointType::universal ? 2
                   : joint.type == JointType::hinge     ? 1
                                                        : 0;
  for (int k = 0; k < axes; ++k) {
    if (!(std::abs(joint.axes[k].norm() - 1.0) < 1e-6)) return "an axis is not unit";
    const Range& range = joint.limits[k];
    if (!(range.min <= range.max)) return "a limit range is empty";
    if ((range.max == inf) != (joint.limits[0].max == inf)) return "only some ranges are limited";
    if ((range.max == inf) != (range.min == -inf)) return "a limit range has one end only";
  }
  if (joint.type == JointType::universal && std::abs(joint.axes[0].dot(joint.axes[1])) > 1e-6) {
    return "the axes of a universal joint are not perpendicular";
  }
  if (joint.type == JointType::ball) {
    if (joint.axes[0].cross(joint.axes[1]).dot(joint.axes[2]) < 1.0 - 1e-6) {
      return "the axes of a ball joint are no right-handed triad";
    }
    for (int k = 0; k < 2; ++k) {
      if (joint.limits[k].min > 0.0 || joint.limits[k].max < 0.0) return "the swing excludes zero";
    }
  }
  return nullptr;
}

bool has_joint(const Rig& rig, std::int32_t joint) { return joint >= 0 && joint < rig.size(); }

const char* find_fault(const Rig& rig, const RigEffector& effector) {
  if (!has_joint(rig, effector.joint)) return "is on no joint";
  if (!effector.offset.allFinite()) return "has an offset that is not finite";
  if (!(effector.weight_pos >= 0) || !(effector.weight_rot >= 0)) return "has a bad weight";
  if (effector.relative_to != kNoJoint && !has_joint(rig, effector.relative_to)) {
    return "is relative to no joint";
  }
  if (effector.relative_to == effector.joint) return "is relative to its own joint";
  if (effector.priority < 0) return "has a priority below zero";
  return nullptr;
}

const char* find_fault(const Rig& rig, const Coupling& c) {
  if (!has_joint(rig, c.from_joint) || !has_joint(rig, c.to_joint)) return "names no joint";
  const auto exists = [&](std::int32_t joint, std::int32_t dof) {
    return dof >= 0 && dof < coupled_dof_count(rig.joints[joint]);
  };
  if (!exists(c.from_joint, c.from_dof) || !exists(c.to_joint, c.to_dof)) {
    return "names a coordinate that cannot be coupled";
  }
  if (c.from_joint == c.to_joint && c.from_dof == c.to_dof) return "couples one to itself";
  if (!std::isfinite(c.ratio) || !std::isfinite(c.offset)) return "is not finite";
  return nullptr;
}

}  // namespace

Result<void> validate(const Rig& rig) {
  const auto invalid = [&](std::string message, std::string joint) {
    return Error{.code = "rig-invalid",
                 .message = std::move(message),
                 .joint = std::move(joint),
                 .hint = "see assets/data/rigs/ikrig.schema.json"};
  };
  if (rig.joints.empty()) return invalid("the rig has no joints", "");
  std::unordered_set<std::string> names;
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    if (const char* fault = find_fault(rig, i)) return invalid(fault, rig.joints[i].name);
    if (!names.insert(rig.joints[i].name).second) {
      return invalid("two joints share a name", rig.joints[i].name);
    }
  }
  for (const RigEffector& effector : rig.effectors) {
    if (const char* fault = find_fault(rig, effector)) {
      return invalid("effector '" + effector.name + "' " + fault, "");
    }
  }
  for (std::size_t i = 0; i < rig.couplings.size(); ++i) {
    if (const char* fault = find_fault(rig, rig.couplings[i])) {
      return invalid("coupling " + std::to_string(i) + " " + fault, "");
    }
  }
  for (const CollisionPair& pair : rig.collisions) {
    if (!has_joint(rig, pair.joint_a) || !has_joint(rig, pair.joint_b) ||
        pair.joint_a == pair.joint_b) {
      return invalid("a collision pair does not name two joints", "");
    }
  }
  return {};
}

std::int32_t coupled_dof_count(const RigJoint& joint) {
  if (joint.type == JointType::free) return 3;
  if (joint.type == JointType::ball && !joint.limited()) return 0;
  return dof_count(joint.type);
}

std::vector<CollisionPair> collision_pairs(const Rig& rig) {
  if (!rig.collisions.empty()) return rig.collisions;
  std::vector<CollisionPair> pairs;
  for (std::int32_t b = 0; b < rig.size(); ++b) {
    for (std::int32_t a = 0; a < b; ++a) {
      if (rig.joints[a].capsules.empty() || rig.joints[b].capsules.empty()) continue;
      if (rig.joints[b].parent != a) pairs.push_back({a, b});
    }
  }
  return pairs;
}

std::int32_t dof_count(const Rig& rig) { return dof_begin(rig).back(); }

std::vector<std::int32_t> dof_begin(const Rig& rig) {
  std::vector<std::int32_t> begin(rig.joints.size() + 1, 0);
  for (std::size_t i = 0; i < rig.joints.size(); ++i) {
    begin[i + 1] = begin[i] + dof_count(rig.joints[i].type);
  }
  return begin;
}

Skeleton skeleton_of(const Rig& rig) {
  Skeleton skeleton;
  for (const RigJoint& joint : rig.joints) {
    skeleton.names.push_back(joint.name);
    skeleton.parents.push_back(joint.parent);
    skeleton.rest_parent_from_joint.push_back(
        DualQuaternion::from_rotation_translation(joint.rest, joint.offset));
  }
  return skeleton;
}

namespace {

Eigen::Quaterniond about(const Eigen::Vector3d& axis, double angle) {
  return Eigen::Quaterniond(Eigen::AngleAxisd(angle, axis));
}

Eigen::Map<Eigen::Vector3d> as_vector3(double* p) { return Eigen::Map<Eigen::Vector3d>(p); }

/// The angle whose turn about `axis` is nearest to `rotation` (the twist of its decomposition).
double angle_about(const Eigen::Quaterniond& rotation, const Eigen::Vector3d& axis) {
  const double along = rotation.vec().dot(axis);
  double angle = 2.0 * std::atan2(along, rotation.w());
  if (angle > M_PI) angle -= 2.0 * M_PI;
  if (angle <= -M_PI) angle += 2.0 * M_PI;
  return angle;
}

/// rot(a0, q0) rot(a1, q1) nearest to `rotation`: exact when it has that form.
void universal_angles(const RigJoint& joint, const Eigen::Quaterniond& rotation, double* q) {
  const Eigen::Vector3d a2 = joint.axes[0].cross(joint.axes[1]);
  // In the triad (a0, a1, a2), R0 R1 has the quaternion (c0 c1, s0 c1, c0 s1, s0 s1): the matrix
  // [w y; x z] is the rank-one product of (c0, s0) and (c1, s1). The nearest such product is its
  // leading singular pair.
  const double w = rotation.w(), x = rotation.vec().dot(joint.axes[0]);
  const double y = rotation.vec().dot(joint.axes[1]), z = rotation.vec().dot(a2);
  const double half0 = 0.5 * std::atan2(2.0 * (w * x + y * z), w * w + y * y - x * x - z * z);
  const double c0 = std::cos(half0), s0 = std::sin(half0);
  const double half1 = std::atan2(c0 * y + s0 * z, c0 * w + s0 * x);
  q[0] = 2.0 * half0;
  q[1] = 2.0 * half1;
  // (half0 + pi, half1 + pi) is the same quaternion; bring both angles into (-pi, pi].
  for (int k = 0; k < 2; ++k) {
    if (q[k] > M_PI) q[k] -= 2.0 * M_PI;
    if (q[k] <= -M_PI) q[k] += 2.0 * M_PI;
  }
}

}  // namespace

void pose_from_coordinates(const Rig& rig, std::span<const double> q,
                           std::span<DualQuaternion> parent_from_joint) {
  std::size_t k = 0;
  for (std::size_t i = 0; i < rig.joints.size(); ++i) {
    const RigJoint& joint = rig.joints[i];
    Eigen::Quaterniond r(1, 0, 0, 0);
    Eigen::Vector3d t = joint.offset;
    switch (joint.type) {
      case JointType::fixed:
        break;
      case JointType::hinge:
        r = about(joint.axes[0], q[k]);
        break;
      case JointType::universal:
        r = about(joint.axes[0], q[k]) * about(joint.axes[1], q[k + 1]);
        break;
      case JointType::ball:
        r = rotation_exp(Eigen::Vector3d(q[k], q[k + 1], q[k + 2]));
        break;
      case JointType::free:
        t += Eigen::Vector3d(q[k], q[k + 1], q[k + 2]);
        r = rotation_exp(Eigen::Vector3d(q[k + 3], q[k + 4], q[k + 5]));
        break;
    }
    parent_from_joint[i] = DualQuaternion::from_rotation_translation(joint.rest * r, t);
    k += dof_count(joint.type);
  }
}

void angles_from_rotation(const RigJoint& joint, const Eigen::Quaterniond& r, double* q) {
  switch (joint.type) {
    case JointType::fixed:
      break;
    case JointType::hinge:
      q[0] = angle_about(r, joint.axes[0]);
      break;
    case JointType::universal:
      universal_angles(joint, r, q);
      break;
    case JointType::ball:
    case JointType::free:
      as_vector3(q) = rotation_log(r);
      break;
  }
}

void coordinates_from_pose(const Rig& rig, std::span<const DualQuaternion> parent_from_joint,
                           std::span<double> q) {
  std::size_t k = 0;
  for (std::size_t i = 0; i < rig.joints.size(); ++i) {
    const RigJoint& joint = rig.joints[i];
    const Eigen::Quaterniond r = joint.rest.conjugate() * parent_from_joint[i].rotation();
    if (joint.type == JointType::free) {
      as_vector3(&q[k]) = parent_from_joint[i].translation() - joint.offset;
      angles_from_rotation(joint, r, &q[k + 3]);
    } else if (joint.type != JointType::fixed) {
      angles_from_rotation(joint, r, &q[k]);
    }
    k += dof_count(joint.type);
  }
}

}  // namespace limber
