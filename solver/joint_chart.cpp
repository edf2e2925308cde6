// One joint in exponential maps (Kenwright 2013, sections IV.B and VII.C; Grassia 1998).
//
// A rotation vector w = n theta is the logarithm of a unit quaternion, exp(w) the quaternion (the
// paper's eq. 6 has the two names exchanged). With theta = |w|, moving w by dw turns exp(w) from
// the left by J dw,
//   J = A 1 + B [w] + C w w',  A = sin theta / theta, B = (1 - cos theta) / theta^2,
//   C = (1 - A) / theta^2,     det J = 2 (1 - cos theta) / theta^2,
// which is singular at theta = 2 n pi only. This is what the paper's figure 8 (a picture that its
// text lacks) is for.
//
// Limits speak of swing and twist, q = q_swing q_twist (eqs. 32-34, about the triad's third axis,
// be it x, y or z). A ball with limits is therefore held in these two factors' own exponential
// maps, s = (s0, s1) and t: exp(s0 a0 + s1 a1) exp(t a2). Clamping is then exact and touches only
// what it clamps. (Holding it as one vector w and clamping after each w_i through the decomposition
// would move w_j behind the sweep's back: such sweeps come to rest at points that are no minimum.)
// Its twists, in the triad: the columns 0 and 1 of J at (s0, s1, 0), and exp(s) z.
#include "solver/joint_chart.h"

#include <algorithm>
#include <cmath>

namespace limber {

namespace {

constexpr double kNoWidth = 1e-9;  // rad; an ellipse that thin is a segment

Eigen::Quaterniond about(const Eigen::Vector3d& axis, double angle) {
  return Eigen::Quaterniond(Eigen::AngleAxisd(angle, axis));
}

Eigen::Vector3d vector_at(std::span<const double> w, std::size_t first) {
  return {w[first], w[first + 1], w[first + 2]};
}

void put(const Eigen::Vector3d& v, std::span<double> w, std::size_t first) {
  for (int i = 0; i < 3; ++i) w[first + i] = v[i];
}

Range width_or_nothing(double min, double max) {
  return max - min > kNoWidth ? Range{min, max} : Range{0.0, 0.0};
}

}  // namespace

Eigen::Vector3d shift_exponential_map(const Eigen::Vector3d& w) {
  const double angle = w.norm();
  if (!(angle > M_PI)) return w;
  // Nearest whole number of turns, should a step have made more than one.
  return (1.0 - 2.0 * M_PI * std::round(angle / (2.0 * M_PI)) / angle) * w;
}

Eigen::Matrix3d exponential_map_jacobian(const Eigen::Vector3d& w) {
  const double angle2 = w.squaredNorm();
  double a, b, c;
  if (angle2 < 1e-4) {
    a = 1.0 - angle2 / 6.0 + angle2 * angle2 / 120.0;
    b = 0.5 - angle2 / 24.0 + angle2 * angle2 / 720.0;
    c = 1.0 / 6.0 - angle2 / 120.0 + angle2 * angle2 / 5040.0;
  } else {
    const double angle = std::sqrt(angle2), half = std::sin(0.5 * angle);
    a = std::sin(angle) / angle;
    b = 2.0 * half * half / angle2;
    c = (1.0 - a) / angle2;
  }
  Eigen::Matrix3d j = c * w * w.transpose();
  j.diagonal().array() += a;
  j(0, 1) -= b * w.z(), j(0, 2) += b * w.y();
  j(1, 0) += b * w.z(), j(1, 2) -= b * w.x();
  j(2, 0) -= b * w.y(), j(2, 1) += b * w.x();
  return j;
}

JointChart::JointChart(const RigJoint& joint) : joint_(joint) {
  Eigen::Matrix3d triad;
  triad << joint.axes[0], joint.axes[1], joint.axes[2];
  parent_from_triad_ = joint.rest * triad;
  if (!joint.limited()) return;
  swing_twist_ = joint.type == JointType::ball;
  for (int k = 0; k < size(); ++k) {
    const bool angle = !swing_twist_ || k == 2;
    if (angle && is_limited(joint.limits[k])) ranges_[k] = joint.limits[k];
  }
  if (!swing_twist_) return;
  swing_ = SwingEllipse::of(joint);
  ellipse_ = swing_.max0 - swing_.min0 > kNoWidth && swing_.max1 - swing_.min1 > kNoWidth;
  if (ellipse_) return;
  ranges_[0] = width_or_nothing(swing_.min0, swing_.max0);
  ranges_[1] = width_or_nothing(swing_.min1, swing_.max1);
}

void JointChart::coordinates(const DualQuaternion& local, std::span<double> w) const {
  const Eigen::Quaterniond rotation = joint_.rest.conjugate() * local.rotation();
  switch (joint_.type) {
    case JointType::fixed:
      return;
    case JointType::hinge:
    case JointType::universal:
      angles_from_rotation(joint_, rotation, w.data());
      for (int k = 0; k < size(); ++k) w[k] = wrap_into(joint_.limits[k], w[k]);
      return;
    case JointType::ball:
      if (swing_twist_) {
        const SwingTwist st = decompose(rotation, joint_.axes);
        put({st.swing0, st.swing1, wrap_into(joint_.limits[2], st.twist)}, w, 0);
      } else {
        put(rotation_log(rotation), w, 0);
      }
      return;
    case JointType::free:
      put(local.translation() - joint_.offset, w, 0);
      put(rotation_log(rotation), w, 3);
      return;
  }
}

DualQuaternion JointChart::parent_from_joint(std::span<const double> w) const {
  Eigen::Vector3d offset = joint_.offset;
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  switch (joint_.type) {
    case JointType::fixed:
      break;
    case JointType::hinge:
      rotation = about(joint_.axes[0], w[0]);
      break;
    case JointType::universal:
      rotation = about(joint_.axes[0], w[0]) * about(joint_.axes[1], w[1]);
      break;
    case JointType::ball:
      rotation =
          swing_twist_ ? compose({w[0], w[1], w[2]}, joint_.axes) : rotation_exp(vector_at(w, 0));
      break;
    case JointType::free:
      offset += vector_at(w, 0);
      rotation = rotation_exp(vector_at(w, 3));
      break;
  }
  return DualQuaternion::from_rotation_translation((joint_.rest * rotation).normalized(), offset);
}

void JointChart::twists(std::span<const double> w, std::span<DualVector> twist) const {
  const auto turn = [&](int k, const Eigen::Vector3d& axis, const Eigen::Vector3d& through) {
    twist[k] = DualVector::line(through, axis);
  };
  const auto turn_by = [&](int first, const Eigen::Matrix3d& axes, const Eigen::Vector3d& through) {
    for (int i = 0; i < 3; ++i) turn(first + i, axes.col(i), through);
  };
  const Eigen::Vector3d& p = joint_.offset;
  switch (joint_.type) {
    case JointType::fixed:
      return;
    case JointType::hinge:
      turn(0, joint_.rest * joint_.axes[0], p);
      return;
    case JointType::universal:
      turn(0, joint_.rest * joint_.axes[0], p);
      turn(1, joint_.rest * (about(joint_.axes[0], w[0]) * joint_.axes[1]), p);
      return;
    case JointType::ball:
      if (swing_twist_) {
        const Eigen::Vector3d swing(w[0], w[1], 0.0);
        Eigen::Matrix3d axes = exponential_map_jacobian(swing);
        axes.col(2) = rotation_exp(swing) * Eigen::Vector3d::UnitZ();
        turn_by(0, parent_from_triad_ * axes, p);
      } else {
        turn_by(0, joint_.rest * exponential_map_jacobian(vector_at(w, 0)), p);
      }
      return;
    case JointType::free:
      for (int i = 0; i < 3; ++i) {
        twist[i] = {Eigen::Vector3d::Zero(), Eigen::Vector3d::Unit(i)};
      }
      turn_by(3, joint_.rest * exponential_map_jacobian(vector_at(w, 3)), p + vector_at(w, 0));
      return;
  }
}

void JointChart::shift(std::span<double> w) const {
  if (joint_.type == JointType::free || (joint_.type == JointType::ball && !swing_twist_)) {
    const std::size_t first = joint_.type == JointType::free ? 3 : 0;
    put(shift_exponential_map(vector_at(w, first)), w, first);
    return;
  }
  for (int k = swing_twist_ ? 2 : 0; k < size(); ++k) {
    if (!is_limited(ranges_[k])) w[k] = shift_exponential_map({w[k], 0.0, 0.0}).x();
  }
}

}  // namespace limber
