// Swing and twist (Kenwright 2013, section VII.C, for any twist axis).
//
// In the triad (a0, a1, a2) a swing has the quaternion (c, x, y, 0), a twist (k, 0, 0, m), and
// their product is
//   w = c k,  x' = x k + y m,  y' = y k - x m,  z = c m.
// So (w, z) = c (k, m): with c = hypot(w, z) >= 0 the twist is (w, z) / c, and
//   x = (x' w - y' z) / c,  y = (y' w + x' z) / c          (eq. 34 with its sign put right).
// c = cos(|s| / 2): where it vanishes the swing is a half turn and any twist can be traded for
// another swing axis. There the twist is taken as zero, and limits keep clear of that point.
//
// Nearest point on a quarter ellipse with radii (a, b), from p outside it, p >= 0: the border point
// y with p - y normal to the border satisfies y = (a^2 p0 / (t + a^2), b^2 p1 / (t + b^2)) for the
// root t >= 0 of
//   F(t) = (a p0 / (t + a^2))^2 + (b p1 / (t + b^2))^2 - 1.
// F is convex and falls; each term alone is >= 1 below t = a p0 - a^2 (b p1 - b^2), so Newton from
// the larger of these (or 0) climbs to the root without overshoot, whatever the aspect.
#include "solver/swing_twist.h"

#include <algorithm>
#include <cmath>

namespace limber {

namespace {

constexpr double kMaxSwing = M_PI - 1e-3;  // rad; rounding of the twist grows as 1 / cos(swing / 2)
constexpr double kInside = 1e-11;          // rad; what rounding may add to a rotation on its limit

/// sin(angle) / (2 angle-halves): vec(exp(v)) = half_sinc(|v|) v.
double half_sinc(double angle) {
  if (angle < 1e-4) return 0.5 - angle * angle / 48.0;
  return std::sin(0.5 * angle) / angle;
}

double side(double s, double min, double max) { return s < 0.0 ? -min : max; }

/// Nearest point of the quarter ellipse with radii a, b to p >= 0 outside it.
Eigen::Vector2d project_onto_quarter(double a, double b, const Eigen::Vector2d& p) {
  constexpr double kFlat = 1e-13;  // rad; thinner is a segment
  if (b < kFlat) return {std::min(p.x(), a), 0.0};
  if (a < kFlat) return {0.0, std::min(p.y(), b)};
  const double a2 = a * a, b2 = b * b;
  const double ap = a * p.x(), bp = b * p.y();
  double t = std::max({0.0, ap - a2, bp - b2}), u = 0.0, v = 0.0;
  for (int i = 0; i < 50; ++i) {
    const double ra = 1.0 / (t + a2), rb = 1.0 / (t + b2);
    u = ap * ra;
    v = bp * rb;
    const double f = u * u + v * v - 1.0;
    if (f <= 4e-16) break;
    t += 0.5 * f / (u * u * ra + v * v * rb);
  }
  const double norm = 1.0 / std::sqrt(u * u + v * v);
  return {a * (u * norm), b * (v * norm)};
}

Eigen::Quaterniond nearest_ball(const RigJoint& joint, const Eigen::Quaterniond& rotation) {
  const SwingTwist in = decompose(rotation, joint.axes);
  const Eigen::Vector2d swing = SwingEllipse::of(joint).project({in.swing0, in.swing1});
  SwingTwist out{swing.x(), swing.y(), wrap_into(joint.limits[2], in.twist)};
  if (is_limited(joint.limits[2])) {
    out.twist = std::clamp(out.twist, joint.limits[2].min, joint.limits[2].max);
  }
  return compose(out, joint.axes);
}

Eigen::Quaterniond nearest_axis_angles(const RigJoint& joint, const Eigen::Quaterniond& rotation) {
  double q[3];
  angles_from_rotation(joint, rotation, q);
  Eigen::Quaterniond r(1, 0, 0, 0);
  for (int k = 0; k < dof_count(joint.type); ++k) {
    double angle = q[k];
    if (is_limited(joint.limits[k])) {
      angle =
          std::clamp(wrap_into(joint.limits[k], angle), joint.limits[k].min, joint.limits[k].max);
    }
    r = r * Eigen::Quaterniond(Eigen::AngleAxisd(angle, joint.axes[k]));
  }
  return r;
}

}  // namespace

SwingTwist decompose(const Eigen::Quaterniond& rotation,
                     const std::array<Eigen::Vector3d, 3>& axes) {
  const double w = rotation.w(), z = rotation.vec().dot(axes[2]);
  const double x = rotation.vec().dot(axes[0]), y = rotation.vec().dot(axes[1]);
  const double c = std::hypot(w, z);
  double k = 1.0, m = 0.0;
  SwingTwist out;
  if (c > 1e-15) {
    k = w / c;
    m = z / c;
    out.twist = 2.0 * std::atan2(m, k);
    if (out.twist > M_PI) out.twist -= 2.0 * M_PI;
    if (out.twist <= -M_PI) out.twist += 2.0 * M_PI;
  }
  const double sx = x * k - y * m, sy = y * k + x * m;
  const double n = std::hypot(sx, sy);
  const double scale = n < 1e-8 ? 2.0 : 2.0 * std::atan2(n, c) / n;
  out.swing0 = scale * sx;
  out.swing1 = scale * sy;
  return out;
}

Eigen::Quaterniond compose(const SwingTwist& s, const std::array<Eigen::Vector3d, 3>& axes) {
  const double angle = std::hypot(s.swing0, s.swing1);
  const double c = std::cos(0.5 * angle), f = half_sinc(angle);
  const double x = f * s.swing0, y = f * s.swing1;
  const double k = std::cos(0.5 * s.twist), m = std::sin(0.5 * s.twist);
  const Eigen::Vector3d v =
      (x * k + y * m) * axes[0] + (y * k - x * m) * axes[1] + (c * m) * axes[2];
  return Eigen::Quaterniond(c * k, v.x(), v.y(), v.z()).normalized();
}

SwingEllipse SwingEllipse::of(const RigJoint& ball) {
  return {std::max(ball.limits[0].min, -kMaxSwing), std::min(ball.limits[0].max, kMaxSwing),
          std::max(ball.limits[1].min, -kMaxSwing), std::min(ball.limits[1].max, kMaxSwing)};
}

double SwingEllipse::level(const Eigen::Vector2d& s) const {
  const double a = side(s.x(), min0, max0), b = side(s.y(), min1, max1);
  const double u = s.x() == 0.0 ? 0.0 : s.x() / a, v = s.y() == 0.0 ? 0.0 : s.y() / b;
  return u * u + v * v;
}

Eigen::Vector2d SwingEllipse::project(const Eigen::Vector2d& s) const {
  if (level(s) <= 1.0) return s;
  const Eigen::Vector2d nearest =
      project_onto_quarter(side(s.x(), min0, max0), side(s.y(), min1, max1), s.cwiseAbs());
  return {std::copysign(nearest.x(), s.x()), std::copysign(nearest.y(), s.y())};
}

double SwingEllipse::curvature(const Eigen::Vector2d& s) const {
  // (a cos, b sin): curvature a b / (a^2 sin^2 + b^2 cos^2)^(3/2).
  const double a = side(s.x(), min0, max0), b = side(s.y(), min1, max1);
  if (!(a > 0.0) || !(b > 0.0)) return 0.0;
  const double u = a * s.y() / b, v = b * s.x() / a;
  const double speed2 = u * u + v * v;
  return a * b / (speed2 * std::sqrt(speed2));
}

bool is_limited(const Range& range) { return range.max - range.min < 2.0 * M_PI - 1e-12; }

double wrap_into(const Range& range, double angle) {
  if (!std::isfinite(range.min) || !std::isfinite(range.max)) return angle;
  const double middle = 0.5 * (range.min + range.max);
  // Rounding must not touch an angle that is already the nearest one.
  if (std::abs(angle - middle) <= M_PI) return angle;
  return angle - 2.0 * M_PI * std::round((angle - middle) / (2.0 * M_PI));
}

Eigen::Quaterniond project_into_limits(const RigJoint& joint, const Eigen::Quaterniond& rotation) {
  if (joint.type == JointType::free) return rotation;
  if (joint.type == JointType::ball && !joint.limited()) return rotation;
  const Eigen::Quaterniond nearest = joint.type == JointType::ball
                                         ? nearest_ball(joint, rotation)
                                         : nearest_axis_angles(joint, rotation);
  return rotation_angle(rotation, nearest) <= kInside ? rotation : nearest;
}

void project_joint(const Rig& rig, std::int32_t i, std::span<DualQuaternion> parent_from_joint) {
  const RigJoint& joint = rig.joints[i];
  if (joint.type == JointType::free) return;
  DualQuaternion& local = parent_from_joint[i];
  const Eigen::Quaterniond rotation = joint.rest.conjugate() * local.rotation();
  const Eigen::Quaterniond allowed = project_into_limits(joint, rotation);
  const bool kept = allowed.coeffs() == rotation.coeffs();
  const double slip = (local.translation() - joint.offset).norm();
  if (kept && slip <= 1e-12 * (1.0 + joint.offset.norm())) return;
  local = DualQuaternion::from_rotation_translation(kept ? local.rotation() : joint.rest * allowed,
                                                    joint.offset);
}

void project_into_limits(const Rig& rig, std::span<DualQuaternion> parent_from_joint) {
  for (std::int32_t i = 0; i < rig.size(); ++i) project_joint(rig, i, parent_from_joint);
}

}  // namespace limber
