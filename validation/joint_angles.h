#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "assets/model/rig.h"

namespace limber {

/// The angles of a joint's rotation R, read from its matrix and the definition in rig.h alone;
/// the solver's quaternion decomposition is not used, so that the two can check each other.
///  - hinge:     angle[0] of the turn about axes[0] that is nearest to R
///  - universal: angle[0], angle[1] with R0 R1 nearest to R
///  - ball:      swing0, swing1, twist; twist is 0 where it is undefined (swing of pi)
/// rad; twist, hinge and universal angles within (-pi, pi].
Eigen::Vector3d joint_angles(const RigJoint&, const Eigen::Matrix3d& rotation);

/// R as the local transform of a pose has it: rest^-1 times the local rotation.
Eigen::Matrix3d joint_rotation(const RigJoint&, const Eigen::Quaterniond& parent_from_joint);

/// Rotation about a unit axis, and of a rotation vector (Rodrigues).
Eigen::Matrix3d rotation_about(const Eigen::Vector3d& unit_axis, double angle);
Eigen::Matrix3d rotation_matrix(const Eigen::Vector3d& rotation_vector);

/// Angle in radians, within [0, pi], of a rotation matrix; exact near zero.
double rotation_angle(const Eigen::Matrix3d&);

/// The bound of one swing axis on the side where `swing` lies.
double swing_bound(const Range&, double swing);

/// The nearest point of an asymmetric swing ellipse to (swing0, swing1); inside points stay.
Eigen::Vector2d nearest_swing(const RigJoint&, const Eigen::Vector2d& swing);

/// The angle equal to `angle` up to whole turns that lies in the range, or its nearer end.
double nearest_in_range(const Range&, double angle);

}  // namespace limber
