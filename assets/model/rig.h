#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "assets/model/clip.h"
#include "assets/model/skeleton.h"

namespace limber {

/// How a joint moves; local = T(offset) rest R, with R by type:
///  - fixed:     R = 1
///  - hinge:     R = rot(axes[0], q0)                        one range
///  - universal: R = rot(axes[0], q0) rot(axes[1], q1)       a box
///  - ball:      R = swing twist, twist about axes[2],
///               swing = exp(s0 axes[0] + s1 axes[1])        a twist range and a swing ellipse
///  - free:      a translation (added to offset) and a rotation, both unlimited
enum class JointType : std::uint8_t { fixed, hinge, universal, ball, free };

/// Canonical coordinates per type: hinge 1 and universal 2 angles (rad); ball 3, a rotation
/// vector with R = exp(q); free 6, translation (m) then rotation vector.
std::int32_t dof_count(JointType);
const char* to_string(JointType);

struct Range {
  double min = -std::numeric_limits<double>::infinity();
  double max = std::numeric_limits<double>::infinity();
};

/// A volume around a joint's bone, in the joint's space, metres.
struct Capsule {
  Eigen::Vector3d from = Eigen::Vector3d::Zero();
  Eigen::Vector3d to = Eigen::Vector3d::Zero();
  double radius = 0.0;
};

struct RigJoint {
  std::string name;  ///< the node's name in exported files
  std::string role;  ///< VRM 1.0 humanoid name, or ""
  std::int32_t parent = kNoJoint;
  JointType type = JointType::fixed;
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();  ///< m, in the parent's space
  Eigen::Quaterniond rest{1, 0, 0, 0};               ///< local rotation at q = 0 (T-pose)
  /// Unit, in the joint's space. Balls: right-handed orthonormal triad, axes[2] the twist axis.
  std::array<Eigen::Vector3d, 3> axes{Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitY(),
                                      Eigen::Vector3d::UnitZ()};
  /// rad. hinge: [0]; universal: [0], [1] about axes[0], axes[1]; ball: [0] swing0, [1] swing1,
  /// [2] twist. A ball's swing is allowed when (s0/S0)^2 + (s1/S1)^2 <= 1, S the bound on that
  /// side's sign. Infinite: unlimited; a ball has either all three ranges or none.
  std::array<Range, 3> limits;
  std::vector<Capsule> capsules;
  double weight = 1.0;     ///< stiffness, > 0: scales the solver's damping; stiff joints move last
  double max_speed = 0.0;  ///< rad/s (translations: m/s) per solver coordinate; 0: no limit
  std::string citation;    ///< where the limits come from

  bool limited() const {
    return (type == JointType::hinge || type == JointType::universal || type == JointType::ball) &&
           limits[0].max < std::numeric_limits<double>::infinity();
  }
};

enum class EffectorKind : std::uint8_t { pose, position, orientation, direction, line, gaze };
const char* to_string(EffectorKind);
/// direction, line and gaze are about an axis; turning about it changes nothing.
constexpr bool has_axis(EffectorKind kind) {
  return kind == EffectorKind::direction || kind == EffectorKind::line ||
         kind == EffectorKind::gaze;
}

/// A point (and orientation) on a joint that a target pulls.
/// Cost of one effector: (weight_pos |dp|)^2 + (0.1 m/rad weight_rot |dtheta|)^2.
/// direction: the joint's unit `axis` is to point along the target's rotation times `axis`.
/// line: the line through offset along `axis` is to lie on the target's.
/// gaze: the ray from offset along `axis` is to pass through the target's position; dtheta is the
/// angle at the eye between the two. A target at the eye itself (kNearestGaze) pulls nothing.
struct RigEffector {
  std::string name;
  std::int32_t joint = 0;
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();  ///< m, in the joint's space
  EffectorKind kind = EffectorKind::pose;
  Eigen::Vector3d axis = Eigen::Vector3d::UnitX();  ///< direction, line and gaze only
  bool strong = true;                               ///< counts for stopping and for success
  double weight_pos = 1.0;
  double weight_rot = 1.0;
  /// The target is given in this joint's space, so that it moves along: hand to hand, hand to
  /// prop. kNoJoint: in world space.
  std::int32_t relative_to = kNoJoint;
  std::int32_t priority = 0;  ///< 0 is the strongest; a lower one never disturbs a higher one
};

/// Coupled coordinates: q[to] = ratio * q[from] + offset (rad); fingers that move together. A dof
/// counts the joint's solver coordinates: hinge 0 and universal 0, 1 the angles; ball with limits
/// 0 swing0, 1 swing1, 2 twist; free 0, 1, 2 the translation (m). Rotations without limits have no
/// such coordinates and cannot be coupled.
struct Coupling {
  std::int32_t from_joint = 0, from_dof = 0, to_joint = 0, to_dof = 0;
  double ratio = 1.0, offset = 0.0;
};

/// Two joints whose capsules are to stay apart.
struct CollisionPair {
  std::int32_t joint_a = 0, joint_b = 0;
};

/// A skeleton whose joints have limits. Row i of `joints` is joint i of `skeleton_of(rig)`.
struct Rig {
  std::string name;
  std::string description;
  std::vector<RigJoint> joints;  ///< parents first
  std::vector<RigEffector> effectors;
  std::vector<Coupling> couplings;
  /// Empty: all pairs of joints with capsules, but parent and child (see collision_pairs).
  std::vector<CollisionPair> collisions;

  std::int32_t size() const { return static_cast<std::int32_t>(joints.size()); }
  std::int32_t find(const std::string& joint_name) const;
  std::int32_t find_role(const std::string& role) const;
};

/// Checks parents, axes, ranges, effectors, couplings and collision pairs. Error: `rig-invalid`,
/// with the joint.
Result<void> validate(const Rig&);

std::int32_t dof_count(const Rig&);
/// dof_begin[i] is joint i's first canonical coordinate; one more entry holds the total.
std::vector<std::int32_t> dof_begin(const Rig&);

/// How many leading coordinates of a joint a coupling may name, see Coupling.
std::int32_t coupled_dof_count(const RigJoint&);

/// `collisions`, or where that is empty every pair of joints with capsules that are not parent and
/// child, in ascending order.
std::vector<CollisionPair> collision_pairs(const Rig&);

/// The rig as a skeleton whose rest pose is q = 0.
Skeleton skeleton_of(const Rig&);

/// The joint's own rotation R as angles: hinge 1, universal 2, ball and free 3 (rotation vector).
void angles_from_rotation(const RigJoint&, const Eigen::Quaterniond& rotation, double* q);

/// Canonical coordinates (dof_count doubles) to a pose and back. Going back, a hinge or universal
/// joint takes the nearest angles within (-pi, pi]; exact when the pose came from coordinates.
void pose_from_coordinates(const Rig&, std::span<const double> q,
                           std::span<DualQuaternion> parent_from_joint);
void coordinates_from_pose(const Rig&, std::span<const DualQuaternion> parent_from_joint,
                           std::span<double> q);

}  // namespace limber
