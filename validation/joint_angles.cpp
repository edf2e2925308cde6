#include "validation/joint_angles.h"

#include <cmath>

namespace limber {
namespace {

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

/// 2 sin(angle) times the unit axis: the antisymmetric part of R.
Eigen::Vector3d axial(const Eigen::Matrix3d& r) {
  return {r(2, 1) - r(1, 2), r(0, 2) - r(2, 0), r(1, 0) - r(0, 1)};
}

/// argmax over angle of trace(R' rot(axis, angle)) = cos (tr R - a'Ra) + sin (a . axial R) + a'Ra.
double nearest_angle(const Eigen::Matrix3d& r, const Eigen::Vector3d& axis) {
  return std::atan2(axis.dot(axial(r)), r.trace() - axis.dot(r * axis));
}

Eigen::Vector2d universal_angles(const RigJoint& joint, const Eigen::Matrix3d& r) {
  // R0 R1 keeps R1's axis: R a1 = R0 a1; and R' a0 = R1' a0. Exact for a true universal joint.
  const Eigen::Vector3d &a0 = joint.axes[0], &a1 = joint.axes[1];
  const Eigen::Vector3d a2 = a0.cross(a1);
  const Eigen::Vector3d a1_turned = r * a1, a0_back = r.transpose() * a0;
  Eigen::Vector2d q(std::atan2(a1_turned.dot(a2), a1_turned.dot(a1)),
                    std::atan2(a0_back.dot(a2), a0_back.dot(a0)));
  // Any other rotation: each angle in turn to its best; the trace grows with every step.
  for (int i = 0; i < 100; ++i) {
    const Eigen::Vector2d before = q;
    q[0] = nearest_angle(r * rotation_about(a1, -q[1]), a0);
    q[1] = nearest_angle(rotation_about(a0, -q[0]) * r, a1);
    if ((q - before).cwiseAbs().maxCoeff() < 1e-15) break;
  }
  return q;
}

Eigen::Vector3d ball_angles(const RigJoint& joint, const Eigen::Matrix3d& r) {
  const Eigen::Vector3d &a0 = joint.axes[0], &a1 = joint.axes[1], &twist_axis = joint.axes[2];
  const Eigen::Vector3d turned = r * twist_axis;
  const Eigen::Vector3d normal = twist_axis.cross(turned);
  const double sine = normal.norm(), cosine = twist_axis.dot(turned);
  if (sine < 1e-9 && cosine < 0.0) {
    // Half a turn: R + 1 = 2 u u', and the swing alone makes it.
    Eigen::Vector3d u = ((r + Eigen::Matrix3d::Identity()) * (a0 + 0.5 * a1)).eval();
    u -= twist_axis * twist_axis.dot(u);
    if (u.norm() < 1e-9) u = a1 - 0.5 * a0;
    u.normalize();
    return {M_PI * u.dot(a0), M_PI * u.dot(a1), 0.0};
  }
  const double angle = std::atan2(sine, cosine);
  const Eigen::Vector3d swing = sine < 1e-300 ? normal : Eigen::Vector3d(angle / sine * normal);
  const Eigen::Matrix3d swing_matrix = rotation_matrix(swing);
  const Eigen::Vector3d side = r * a0;
  return {swing.dot(a0), swing.dot(a1),
          std::atan2(side.dot(swing_matrix * a1), side.dot(swing_matrix * a0))};
}

/// The nearest point of the quarter ellipse (a cos t, b sin t) to (x, y), all >= 0, (x, y) outside.
Eigen::Vector2d nearest_on_quarter(double a, double b, double x, double y) {
  // Half the derivative of the squared distance; negative at 0, positive at pi/2, one root.
  double low = 0.0, high = M_PI_2;
  for (int i = 0; i < 60; ++i) {
    const double t = 0.5 * (low + high), c = std::cos(t), s = std::sin(t);
    const double slope = (b * b - a * a) * s * c + x * a * s - y * b * c;
    (slope < 0.0 ? low : high) = t;
  }
  const double t = 0.5 * (low + high);
  return {a * std::cos(t), b * std::sin(t)};
}

}  // namespace

Eigen::Matrix3d rotation_matrix(const Eigen::Vector3d& v) {
  const double angle2 = v.squaredNorm(), angle = std::sqrt(angle2);
  const double a = angle < 1e-4 ? 1.0 - angle2 / 6.0 : std::sin(angle) / angle;
  const double half = angle < 1e-4 ? 1.0 - angle2 / 24.0 : std::sin(0.5 * angle) / (0.5 * angle);
  const Eigen::Matrix3d k = cross_matrix(v);
  return Eigen::Matrix3d::Identity() + a * k + 0.5 * half * half * k * k;
}

Eigen::Matrix3d rotation_about(const Eigen::Vector3d& unit_axis, double angle) {
  return rotation_matrix(angle * unit_axis);
}

double rotation_angle(const Eigen::Matrix3d& r) {
  return std::atan2(axial(r).norm(), r.trace() - 1.0);
}

Eigen::Matrix3d joint_rotation(const RigJoint& joint, const Eigen::Quaterniond& parent_from_joint) {
  return joint.rest.normalized().toRotationMatrix().transpose() *
         parent_from_joint.normalized().toRotationMatrix();
}

Eigen::Vector3d joint_angles(const RigJoint& joint, const Eigen::Matrix3d& r) {
  switch (joint.type) {
    case JointType::hinge:
      return {nearest_angle(r, joint.axes[0]), 0.0, 0.0};
    case JointType::universal: {
      const Eigen::Vector2d q = universal_angles(joint, r);
      return {q[0], q[1], 0.0};
    }
    case JointType::ball:
      return ball_angles(joint, r);
    case JointType::fixed:
    case JointType::free:
      break;
  }
  return Eigen::Vector3d::Zero();
}

double swing_bound(const Range& range, double swing) { return swing < 0 ? -range.min : range.max; }

Eigen::Vector2d nearest_swing(const RigJoint& joint, const Eigen::Vector2d& swing) {
  const double a = swing_bound(joint.limits[0], swing[0]);
  const double b = swing_bound(joint.limits[1], swing[1]);
  if (std::isinf(a)) return swing;
  const double x = std::abs(swing[0]), y = std::abs(swing[1]);
  // Inside: (x/a)^2 + (y/b)^2 <= 1, written so that a bound of zero needs no division.
  const double xb = x * b, ya = y * a, ab = a * b;
  if (x <= a && y <= b && xb * xb + ya * ya <= ab * ab) return swing;
  const Eigen::Vector2d nearest = nearest_on_quarter(a, b, x, y);
  return {std::copysign(nearest[0], swing[0]), std::copysign(nearest[1], swing[1])};
}

double nearest_in_range(const Range& range, double angle) {
  const double turn = 2.0 * M_PI;
  for (const double turned : {angle, angle - turn, angle + turn}) {
    if (turned >= range.min && turned <= range.max) return turned;
  }
  const double below = std::abs(std::remainder(range.min - angle, turn));
  const double above = std::abs(std::remainder(angle - range.max, turn));
  return below < above ? range.min : range.max;
}

}  // namespace limber
