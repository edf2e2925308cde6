#include "pipeline/limit_approach.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "solver/swing_twist.h"

namespace limber {
namespace {

using Eigen::AngleAxisd;
using Eigen::Matrix;
using Eigen::Quaterniond;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kRoomOfRange = 0.25;  // how much of a range may be spent on meeting one border
constexpr double kRoomOfSwing = 0.5;   // the same of a swing's way from the rest to the border

/// Bends one coordinate of all frames into a range.
template <class Coordinate>
void bend(const Range& range, std::span<Coordinate> frames, double Coordinate::*x) {
  if (!is_limited(range) || frames.empty()) return;
  double least = frames[0].*x, largest = frames[0].*x;
  for (const Coordinate& frame : frames) {
    least = std::min(least, frame.*x);
    largest = std::max(largest, frame.*x);
  }
  const double room = kRoomOfRange * (range.max - range.min);
  const LimitApproach above(range.max, largest, room), below(-range.min, -least, room);
  for (Coordinate& frame : frames) frame.*x = -below(-above(frame.*x));
}

struct Angles {
  double first = 0.0, second = 0.0;
};

/// The angles of a hinge or universal joint under which the bone points as `turn` points it:
/// damped Gauss-Newton on the direction, from the nearest rotation. Damping keeps an axis along
/// which the bone lies (a knuckle's spread when it is bent square) where the rotation has it.
Angles aim(const RigJoint& joint, const Vector3d& bone, const Quaterniond& turn) {
  constexpr double kDamping = 0.01;
  constexpr int kSteps = 6;
  double q[3] = {0.0, 0.0, 0.0};
  angles_from_rotation(joint, turn, q);
  const bool two = joint.type == JointType::universal;
  const Vector3d wish = turn * bone;
  for (int step = 0; step < kSteps; ++step) {
    const Quaterniond first(AngleAxisd(q[0], joint.axes[0]));
    const Quaterniond second(two ? AngleAxisd(q[1], joint.axes[1])
                                 : AngleAxisd(0.0, Vector3d::UnitX()));
    const Vector3d now = first * (second * bone);
    Matrix<double, 3, 2> jacobian = Matrix<double, 3, 2>::Zero();
    jacobian.col(0) = joint.axes[0].cross(now);
    if (two) jacobian.col(1) = (first * joint.axes[1]).cross(now);
    const Eigen::Matrix2d normal =
        jacobian.transpose() * jacobian + kDamping * Eigen::Matrix2d::Identity();
    const Vector2d dq = normal.inverse() * (jacobian.transpose() * (wish - now));
    q[0] += dq.x();
    q[1] += dq.y();
  }
  return {wrap_into(joint.limits[0], q[0]), wrap_into(joint.limits[1], q[1])};
}

void bend_axes(const RigJoint& joint, const Vector3d& bone, std::span<Quaterniond> turns) {
  std::vector<Angles> angles;
  for (const Quaterniond& turn : turns) angles.push_back(aim(joint, bone, turn));
  const std::span<Angles> all(angles);
  bend(joint.limits[0], all, &Angles::first);
  if (joint.type == JointType::universal) bend(joint.limits[1], all, &Angles::second);
  for (std::size_t f = 0; f < turns.size(); ++f) {
    turns[f] = Quaterniond(AngleAxisd(angles[f].first, joint.axes[0]));
    if (joint.type == JointType::hinge) continue;
    turns[f] = turns[f] * AngleAxisd(angles[f].second, joint.axes[1]);
  }
}

void bend_ball(const RigJoint& joint, std::span<Quaterniond> turns) {
  const SwingEllipse ellipse = SwingEllipse::of(joint);
  const auto level = [&](const SwingTwist& s) {
    return std::sqrt(ellipse.level({s.swing0, s.swing1}));
  };
  std::vector<SwingTwist> parts;
  double largest = 0.0;
  bool inside = true;
  for (const Quaterniond& turn : turns) {
    SwingTwist s = decompose(turn, joint.axes);
    s.twist = wrap_into(joint.limits[2], s.twist);
    if (const double l = level(s); std::isfinite(l)) largest = std::max(largest, l);
    const bool twisted = is_limited(joint.limits[2]) &&
                         (s.twist < joint.limits[2].min || s.twist > joint.limits[2].max);
    inside = inside && level(s) <= 1.0 && !twisted;
    parts.push_back(s);
  }
  if (inside) return;
  bend(joint.limits[2], std::span<SwingTwist>(parts), &SwingTwist::twist);
  const LimitApproach swing(1.0, largest, kRoomOfSwing);
  for (std::size_t f = 0; f < turns.size(); ++f) {
    const double from = level(parts[f]), to = std::isfinite(from) ? swing(from) : 1.0;
    if (std::isfinite(from) && from > 0.0) {
      parts[f].swing0 *= to / from;
      parts[f].swing1 *= to / from;
    }
    turns[f] = compose(parts[f], joint.axes);
  }
}

}  // namespace

LimitApproach::LimitApproach(double border, double largest, double room) {
  const double excess = largest - border, margin = std::min(excess, room);
  knee_ = excess > 0.0 ? border - margin : largest;
  curve_ = excess > 0.0 ? excess / ((margin + excess) * margin) : 0.0;
}

double LimitApproach::operator()(double coordinate) const {
  const double x = coordinate - knee_;
  return x <= 0.0 ? coordinate : knee_ + x / (1.0 + curve_ * x);
}

void bend_into_limits(const RigJoint& joint, const Vector3d& bone, std::span<Quaterniond> turns) {
  const bool axes = joint.type == JointType::hinge || joint.type == JointType::universal;
  if (axes) {
    bend_axes(joint, bone, turns);
  } else if (joint.type == JointType::ball && joint.limited()) {
    bend_ball(joint, turns);
  }
  // Rounding, and swings beside a border of width zero.
  for (Quaterniond& turn : turns) turn = project_into_limits(joint, turn);
}

}  // namespace limber
