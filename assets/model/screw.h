#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <optional>

#include "assets/model/dual_quaternion.h"

namespace limber {

// Screws, and how points and lines move under them. Source: Leclercq, Lefevre & Blohm 2013, "3D
// kinematics using dual quaternions", sections 2.2 to 2.5 and appendices B and C. Vectors move as
// v' = q v q*, products compose right to left (the paper writes its passive rotations the other
// way round). Metres, radians, seconds.

/// Products of dual vectors: the dual numbers and dual vectors of line geometry.
struct DualNumber {
  double real = 0.0;
  double dual = 0.0;
};
/// Of two unit lines: cos(angle) - eps distance sin(angle).
DualNumber dot(const DualVector&, const DualVector&);
/// Of two unit lines: the common perpendicular times sin(angle) + eps distance cos(angle). Of a
/// twist and a line: the line's velocity.
DualVector cross(const DualVector&, const DualVector&);

// ---- velocities

struct MovingPoint {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();
};

struct MovingLine {
  DualVector line;      ///< unit
  DualVector velocity;  ///< (n', m'); 1/s and m/s
  /// The line through a point along a unit direction (eq. 6: m' = p' x n + p x n'). Which of its
  /// points that is, and how it slides along the line, makes no difference (appendix B).
  static MovingLine through(const MovingPoint&, const Eigen::Vector3d& unit_direction,
                            const Eigen::Vector3d& direction_rate);
};

/// A rigid transform M that moves: M' = 1/2 twist M.
struct MovingTransform {
  DualQuaternion a_from_b;
  DualVector twist;  ///< in space a: rad/s, and m/s of the point now at a's origin

  /// From M and M' (eqs. 4 and 13): twist = 2 M' M*.
  static MovingTransform from_derivative(const DualQuaternion& a_from_b,
                                         const DualQuaternion& derivative);
  DualQuaternion derivative() const;
  MovingTransform inverse() const;
};
/// (a_from_b * b_from_c) maps c to a; the twists add up in space a.
MovingTransform operator*(const MovingTransform& a_from_b, const MovingTransform& b_from_c);

/// What moves in b, seen from a, by the twist: p' = v + w x p + R p_b', L' = twist x L + M L_b' M*.
MovingPoint transform(const MovingTransform& a_from_b, const MovingPoint& in_b);
MovingLine transform(const MovingTransform& a_from_b, const MovingLine& in_b);
/// The same by the product rule on M P M~* and M L M* (eqs. 11 and 14), given M and M'. Slower; for
/// where M' is what is known.
MovingPoint transform_by_derivative(const DualQuaternion& a_from_b,
                                    const DualQuaternion& derivative, const MovingPoint& in_b);
MovingLine transform_by_derivative(const DualQuaternion& a_from_b, const DualQuaternion& derivative,
                                   const MovingLine& in_b);

// ---- screws

/// A turn about a line and a slide along it.
struct Screw {
  DualVector axis{Eigen::Vector3d::UnitX(), Eigen::Vector3d::Zero()};  ///< unit line
  double angle = 0.0;                                                  ///< rad
  double slide = 0.0;                                                  ///< m
};
struct ScrewRate {
  DualVector axis;     ///< velocity of the line; 1/s and m/s
  double angle = 0.0;  ///< rad/s
  double slide = 0.0;  ///< m/s
};

/// Eq. 12: cos(h) + axis sin(h), h half the dual angle (angle + eps slide) / 2.
DualQuaternion motion_of(const Screw&);
/// Its inverse, angle within [0, pi]. A pure translation (below 1e-14 rad) gets the line through
/// the origin along it; the identity gets +X.
Screw screw_of(const DualQuaternion& motion);
/// Twist of a screw motion whose angle, slide and axis all change (eq. 13).
MovingTransform motion_of(const Screw&, const ScrewRate&);

// ---- shortest motions

/// Turns unit `from` to unit `to` by the smallest angle (appendix C.1, whose product of the two is
/// a rotor of twice that angle). Opposite: half a turn about some perpendicular.
Eigen::Quaterniond shortest_rotation(const Eigen::Vector3d& from, const Eigen::Vector3d& to);

/// The screw about the common perpendicular that takes one unit line to another (appendix C.2):
/// angle within [0, pi], |slide| the distance between the lines. Lines within 1e-8 rad of parallel,
/// where the common perpendicular is lost, get a slide across (and half a turn where they point
/// opposite ways); lines that coincide, none.
Screw shortest_screw(const DualVector& from, const DualVector& to);

/// How that screw changes as the lines move (appendix C.3); nothing for lines within 1e-8 rad of
/// parallel, whose common perpendicular has no velocity.
std::optional<ScrewRate> shortest_screw_rate(const MovingLine& from, const MovingLine& to);

}  // namespace limber
