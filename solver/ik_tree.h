#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <span>
#include <vector>

#include "assets/model/rig.h"
#include "solver/ik_solver.h"
#include "solver/spatial_inertia.h"
#include "solver/swing_twist.h"

namespace limber {

/// The part of a rig that effectors can feel: joints that move and carry an effector, or something
/// that rows act on (solver/rows.h), somewhere below them. Fixed joints are folded into the
/// offsets.
struct IkNode {
  JointType type = JointType::hinge;
  bool chart = false;            ///< ball with limits: coordinates (swing0, swing1, twist)
  bool ellipse = false;          ///< swing0, swing1 are bounded by `swing`
  std::int32_t joint = 0;        ///< row of the rig
  std::int32_t parent = -1;      ///< node, -1: the world
  std::int32_t coordinate = 0;   ///< first
  std::int32_t coordinates = 0;  ///< 1, 2, 3 or 6
  Eigen::Vector3d offset;        ///< in the parent node's space
  Eigen::Quaterniond slide;      ///< free: axes of its translation, in the parent node's space
  Eigen::Quaterniond before;     ///< parent_from_joint rotation = before * motion * after
  Eigen::Quaterniond after;  ///< chart: turns the triad to (x, y, z), so that motion is canonical
  Eigen::Quaterniond local;  ///< the joint's local rotation = local * (motion * after)
  Eigen::Vector3d axis0, axis1;  ///< hinge, universal: in the space after `before`
  SwingEllipse swing{};
};

struct IkEffector {
  std::int32_t node = -1;  ///< -1: on a joint that cannot move
  EffectorKind kind = EffectorKind::pose;
  bool strong = true;
  Eigen::Vector3d offset;       ///< in the node's space
  Eigen::Quaterniond rotation;  ///< node_from_effector
  Eigen::Vector3d axis;         ///< direction, line, gaze: in the effector's space
  double weight_pos = 0.0;      ///< 0 where the kind has no position
  double weight_rot = 0.0;      ///< m/rad, the 0.1 included
};

/// One effector target, resolved.
struct IkGoal {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  Eigen::Vector3d axis = Eigen::Vector3d::UnitX();  ///< direction and line: unit, world
  double mass = 0.0;                                ///< (weight * weight_pos)^2
  double inertia = 0.0;                             ///< (weight * 0.1 m/rad * weight_rot)^2
};

/// How far one effector is from its goal. Moving by the position error and turning by the rotation
/// error (a rotation vector) ends on the goal.
struct IkError {
  Eigen::Vector3d point;     ///< the effector's, world
  Eigen::Vector3d axis;      ///< direction, line, gaze: current, world
  Eigen::Vector3d position;  ///< m
  Eigen::Vector3d rotation;  ///< rad
  /// gaze: from the eye towards the target, over their distance (1/m); 0 where the two meet.
  Eigen::Vector3d ray;
};

/// Where a rig stands. Limited and angular coordinates live in `x`; rotations without limits are
/// unit quaternions that steps multiply from the left.
struct IkState {
  Eigen::VectorXd x;
  std::vector<Eigen::Quaterniond> rotation;  ///< [node] used where !chart and ball or free
};

/// Everything that depends on an IkState.
struct IkKinematics {
  std::vector<Eigen::Quaterniond> rotation;  ///< [node] world_from_node
  std::vector<Eigen::Vector3d> position;     ///< [node] world
  std::vector<Eigen::Quaterniond> motion;    ///< [node] motion * after, of its coordinates
  std::vector<Vector6> axis;                 ///< [coordinate] twist of a unit step
  std::vector<IkError> error;                ///< [effector]
  Eigen::Vector3d origin;                    ///< twists are about this point
  double cost = 0.0;
};

IkEffector make_effector(const RigEffector&, std::int32_t node,
                         const DualQuaternion& node_from_joint);
IkGoal make_goal(const IkEffector&, const EffectorTarget&);
void measure_error(const IkEffector&, const IkGoal&, const Eigen::Quaterniond& world_from_effector,
                   const Eigen::Vector3d& point, IkError&);

class IkTree {
 public:
  /// `collision`: joints with capsules count as felt too.
  explicit IkTree(const Rig&, bool collision = false);

  std::int32_t coordinate_count() const { return static_cast<std::int32_t>(min.size()); }
  IkState make_state() const;
  IkKinematics make_kinematics() const;

  /// Pose to coordinates, moved into limits; and back (joints outside the tree stay).
  void load(std::span<const DualQuaternion> parent_from_joint, IkState&) const;
  void store(const IkState&, std::span<DualQuaternion> parent_from_joint) const;
  /// The same of a state that `kinematics` were evaluated at.
  void store(const IkState&, const IkKinematics&,
             std::span<DualQuaternion> parent_from_joint) const;

  void resolve(std::span<const EffectorTarget>, std::span<IkGoal>) const;

  /// Forward kinematics, effector errors, cost. Quaternion + vector, not dual quaternions: inside
  /// this loop the product of the latter was measured 1.5-1.75 times slower.
  void evaluate(const IkState&, std::span<const IkGoal>, IkKinematics&) const;
  /// The coordinates' twists at that place.
  void linearise(const IkState&, IkKinematics&) const;

  /// out = from moved by `step`, coordinates clamped into limits.
  void move(const IkState& from, const Eigen::VectorXd& step, IkState& out) const;
  /// The nearest coordinates within limits, in place.
  void project(Eigen::VectorXd& x) const;

  std::vector<IkNode> nodes;  ///< parents first
  std::vector<IkEffector> effectors;
  std::vector<std::int32_t> children_begin, children;  ///< [node], nodes
  std::vector<std::int32_t> outside;                   ///< joints of the rig that are no node
  std::vector<std::int32_t> node_of;                   ///< [joint] that it is rigid with, or -1
  std::vector<DualQuaternion> node_from_joint;         ///< [joint] of felt joints
  Eigen::VectorXd min, max;  ///< [coordinate] box; infinite where free or under an ellipse
  Eigen::VectorXd limited;   ///< [coordinate] 1 where it has a range, else 0
  Eigen::VectorXd middle;    ///< [coordinate] of that range
  Eigen::VectorXd damping;   ///< [coordinate] 1 for rad; 1 / l^2, l = 1 m, for metres

 private:
  void store_node(std::size_t node, const IkState&, const Eigen::Quaterniond& motion,
                  std::span<DualQuaternion> parent_from_joint) const;
  void add_node(const RigJoint&, std::int32_t joint, std::int32_t parent_node,
                const DualQuaternion& node_from_parent_joint);

  Rig rig_;
};

}  // namespace limber
