// Twist of a screw motion. With the dual angle t = angle + eps slide and the unit line L, M = c + s
// L where c = cos(t/2), s = sin(t/2) and L L = -1. From L L' + L' L = 0, L' L = L' x L, so
//   2 M' M* = (-s t' + c t' L + 2 s L') (c - s L) = t' L + sin(t) L' + (1 - cos(t)) L x L',
// in which every product is dual: the turning axis, its own motion and the offset of the axis at
// once (the three terms of eq. 13).
//
// Common perpendicular of unit lines K and L: K . L = cos t and K x L = sin(t) N, t the dual angle
// between them. Differentiated,
//   -sin(t) t' = K' . L + K . L'   and   sin(t) N' = K' x L + K x L' - cos(t) t' N.
#include "assets/model/screw.h"

#include <cmath>

namespace limber {

namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kNoTurn = 1e-14;   // rad; rounding of a unit quaternion
constexpr double kParallel = 1e-8;  // rad; the root of rounding, where either form errs alike

DualQuaternion pure(const DualVector& v) {
  return {Quaterniond(0.0, v.real.x(), v.real.y(), v.real.z()),
          Quaterniond(0.0, v.dual.x(), v.dual.y(), v.dual.z())};
}
DualVector vector_part(const DualQuaternion& q) { return {q.real.vec(), q.dual.vec()}; }

/// 1 + eps p of a point, eps v of a velocity (section 2.3.1).
DualQuaternion point(double scalar, const Vector3d& p) {
  return {Quaterniond(scalar, 0.0, 0.0, 0.0), Quaterniond(0.0, p.x(), p.y(), p.z())};
}

DualVector operator*(const DualNumber& s, const DualVector& v) {
  return {s.real * v.real, s.real * v.dual + s.dual * v.real};
}
DualVector operator/(const DualVector& v, const DualNumber& s) {
  return {v.real / s.real, (v.dual - (s.dual / s.real) * v.real) / s.real};
}
DualNumber sine_of(double angle, double slide) {
  return {std::sin(angle), slide * std::cos(angle)};
}
DualNumber cosine_of(double angle, double slide) {
  return {std::cos(angle), -slide * std::sin(angle)};
}

/// The point of a line nearest to the origin.
Vector3d foot_of(const DualVector& line) { return line.real.cross(line.dual); }

}  // namespace

DualNumber dot(const DualVector& a, const DualVector& b) {
  return {a.real.dot(b.real), a.real.dot(b.dual) + a.dual.dot(b.real)};
}

DualVector cross(const DualVector& a, const DualVector& b) {
  return {a.real.cross(b.real), a.real.cross(b.dual) + a.dual.cross(b.real)};
}

MovingLine MovingLine::through(const MovingPoint& p, const Vector3d& n, const Vector3d& rate) {
  return {DualVector::line(p.position, n), {rate, p.velocity.cross(n) + p.position.cross(rate)}};
}

MovingTransform MovingTransform::from_derivative(const DualQuaternion& a_from_b,
                                                 const DualQuaternion& derivative) {
  return {a_from_b, vector_part(2.0 * (derivative * a_from_b.conjugate()))};
}

DualQuaternion MovingTransform::derivative() const { return 0.5 * (pure(twist) * a_from_b); }

MovingTransform MovingTransform::inverse() const {
  const DualQuaternion b_from_a = a_from_b.conjugate();
  return {b_from_a, -1.0 * b_from_a.transform_line(twist)};
}

MovingTransform operator*(const MovingTransform& a_from_b, const MovingTransform& b_from_c) {
  return {a_from_b.a_from_b * b_from_c.a_from_b,
          a_from_b.twist + a_from_b.a_from_b.transform_line(b_from_c.twist)};
}

MovingPoint transform(const MovingTransform& m, const MovingPoint& in_b) {
  const Vector3d p = m.a_from_b.transform_point(in_b.position);
  return {p, m.twist.velocity_at(p) + m.a_from_b.transform_direction(in_b.velocity)};
}

MovingLine transform(const MovingTransform& m, const MovingLine& in_b) {
  const DualVector line = m.a_from_b.transform_line(in_b.line);
  return {line, cross(m.twist, line) + m.a_from_b.transform_line(in_b.velocity)};
}

MovingPoint transform_by_derivative(const DualQuaternion& m, const DualQuaternion& derivative,
                                    const MovingPoint& in_b) {
  const DualQuaternion p = point(1.0, in_b.position), v = point(0.0, in_b.velocity);
  const DualQuaternion velocity = derivative * p * m.full_conjugate() + m * v * m.full_conjugate() +
                                  m * p * derivative.full_conjugate();
  return {(m * p * m.full_conjugate()).dual.vec(), velocity.dual.vec()};
}

MovingLine transform_by_derivative(const DualQuaternion& m, const DualQuaternion& derivative,
                                   const MovingLine& in_b) {
  const DualQuaternion l = pure(in_b.line), v = pure(in_b.velocity);
  const DualQuaternion velocity =
      derivative * l * m.conjugate() + m * v * m.conjugate() + m * l * derivative.conjugate();
  return {vector_part(m * l * m.conjugate()), vector_part(velocity)};
}

DualQuaternion motion_of(const Screw& screw) {
  const double h = 0.5 * screw.angle, shift = 0.5 * screw.slide;
  const DualVector v = sine_of(h, shift) * screw.axis;
  const DualNumber c = cosine_of(h, shift);
  return {Quaterniond(c.real, v.real.x(), v.real.y(), v.real.z()),
          Quaterniond(c.dual, v.dual.x(), v.dual.y(), v.dual.z())};
}

Screw screw_of(const DualQuaternion& motion) {
  const DualVector twist = motion.log();
  const double angle = twist.real.norm();
  if (angle > kNoTurn) {
    const Vector3d n = twist.real / angle;
    const double slide = n.dot(twist.dual);
    return {{n, (twist.dual - slide * n) / angle}, angle, slide};
  }
  const double slide = twist.dual.norm();
  if (slide > 0.0) return {{twist.dual / slide, Vector3d::Zero()}, 0.0, slide};
  return {};
}

MovingTransform motion_of(const Screw& screw, const ScrewRate& rate) {
  const DualNumber speed{rate.angle, rate.slide};
  const DualNumber sine = sine_of(screw.angle, screw.slide);
  const DualNumber cosine = cosine_of(screw.angle, screw.slide);
  const DualNumber rest{1.0 - cosine.real, -cosine.dual};
  return {motion_of(screw),
          speed * screw.axis + sine * rate.axis + rest * cross(screw.axis, rate.axis)};
}

Quaterniond shortest_rotation(const Vector3d& from, const Vector3d& to) {
  Vector3d axis = from.cross(to);
  const double sine = axis.norm(), cosine = from.dot(to);
  if (sine < kNoTurn) {
    if (cosine > 0.0) return Quaterniond::Identity();
    axis = from.unitOrthogonal();
  } else {
    // Near half a turn the cross product is mostly rounding; only its part along `from` would show.
    axis = (axis - from.dot(axis) * from).normalized();
  }
  const double half = 0.5 * std::atan2(sine, cosine), s = std::sin(half);
  return {std::cos(half), s * axis.x(), s * axis.y(), s * axis.z()};
}

Screw shortest_screw(const DualVector& from, const DualVector& to) {
  const Vector3d across = from.real.cross(to.real);
  const double sine = across.norm(), cosine = from.real.dot(to.real);
  const Vector3d foot = foot_of(from), apart = foot_of(to) - foot;
  if (sine >= kParallel) {
    const Vector3d n = across / sine;
    const double along = apart.cross(to.real).dot(across) / (sine * sine);
    return {DualVector::line(foot + along * from.real, n), std::atan2(sine, cosine), apart.dot(n)};
  }
  const Vector3d offset = apart - from.real.dot(apart) * from.real;
  const double distance = offset.norm();
  const bool coincide = distance < kNoTurn;
  const Vector3d n = coincide ? from.real.unitOrthogonal() : Vector3d(offset / distance);
  return {DualVector::line(foot, n), cosine > 0.0 ? 0.0 : M_PI, coincide ? 0.0 : distance};
}

std::optional<ScrewRate> shortest_screw_rate(const MovingLine& from, const MovingLine& to) {
  if (from.line.real.cross(to.line.real).norm() < kParallel) return std::nullopt;
  const Screw screw = shortest_screw(from.line, to.line);
  const DualNumber sine = sine_of(screw.angle, screw.slide);
  const DualNumber cosine = cosine_of(screw.angle, screw.slide);
  const DualNumber a = dot(from.velocity, to.line), b = dot(from.line, to.velocity);
  const double angle = -(a.real + b.real) / sine.real;
  const double slide = -(a.dual + b.dual + sine.dual * angle) / sine.real;
  const DualVector turned = cross(from.velocity, to.line) + cross(from.line, to.velocity) -
                            cosine * (DualNumber{angle, slide} * screw.axis);
  return ScrewRate{turned / sine, angle, slide};
}

}  // namespace limber
