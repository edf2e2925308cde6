#include "tests/bench/peers/coordinates.h"

#include <algorithm>
#include <cmath>

namespace limber::peers {

namespace {

constexpr double kUnlimited = std::numeric_limits<double>::infinity();

Error cannot_do(std::string message, const RigJoint& joint) {
  return {
      .code = "bench-peers",
      .message = std::move(message),
      .joint = joint.name,
      .hint =
          "the peers know hinges, universal joints, limited balls, a free root and effectors of "
          "kind pose and position"};
}

Eigen::Quaterniond about(const Eigen::Vector3d& axis, double angle) {
  return Eigen::Quaterniond(Eigen::AngleAxisd(angle, axis));
}

}  // namespace

Result<Coordinates> Coordinates::of(const Rig& rig) {
  for (const RigEffector& effector : rig.effectors) {
    if (effector.kind == EffectorKind::pose || effector.kind == EffectorKind::position) continue;
    return cannot_do(std::string("an effector is of kind ") + to_string(effector.kind),
                     rig.joints[effector.joint]);
  }
  if (!rig.couplings.empty()) {
    return cannot_do("it is coupled", rig.joints[rig.couplings.front().to_joint]);
  }
  Coordinates c;
  c.rig_ = &rig;
  for (const std::int32_t b : dof_begin(rig)) c.begin_.push_back(b);
  c.lower_ = Eigen::VectorXd::Constant(c.dofs(), -kUnlimited);
  c.upper_ = Eigen::VectorXd::Constant(c.dofs(), kUnlimited);
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    const RigJoint& joint = rig.joints[i];
    const Eigen::Index at = c.begin(i);
    const bool ball = joint.type == JointType::ball;
    if (joint.type == JointType::free && i > 0)
      return cannot_do("it is free below the root", joint);
    if (ball && !joint.limited()) return cannot_do("it is a ball without limits", joint);
    if (ball) c.swings_.push_back({at, SwingEllipse::of(joint)});
    for (int k = ball ? 2 : 0; k < dof_count(joint.type) && joint.type != JointType::free; ++k) {
      if (!is_limited(joint.limits[k])) continue;
      c.lower_[at + k] = joint.limits[k].min;
      c.upper_[at + k] = joint.limits[k].max;
    }
  }
  return c;
}

Eigen::Quaterniond Coordinates::rotation(std::int32_t i, const State& state) const {
  const RigJoint& joint = rig_->joints[i];
  const double* q = state.q.data() + begin(i);
  switch (joint.type) {
    case JointType::fixed:
      break;
    case JointType::hinge:
      return about(joint.axes[0], q[0]);
    case JointType::universal:
      return about(joint.axes[0], q[0]) * about(joint.axes[1], q[1]);
    case JointType::ball:
      return compose({q[0], q[1], q[2]}, joint.axes);
    case JointType::free:
      return state.turn;
  }
  return Eigen::Quaterniond::Identity();
}

// R = exp(s) exp(t a2): a twist turns about a2; a swing's velocity ds turns about J_r(s) ds ahead
// of the twist, J_r the right Jacobian of exp (Chirikjian 2011, eq. 10.86), so about T' J_r(s) ds
// after.
Eigen::Matrix3d Coordinates::ball_columns(std::int32_t i, const State& state) const {
  const RigJoint& joint = rig_->joints[i];
  const double* q = state.q.data() + begin(i);
  const Eigen::Vector3d s = q[0] * joint.axes[0] + q[1] * joint.axes[1];
  const double angle2 = s.squaredNorm(), angle = std::sqrt(angle2);
  const bool small = angle < 1e-4;
  const double a = small ? 0.5 - angle2 / 24.0 : (1.0 - std::cos(angle)) / angle2;
  const double b =
      small ? 1.0 / 6.0 - angle2 / 120.0 : (angle - std::sin(angle)) / (angle2 * angle);
  const Eigen::Matrix3d untwist = about(joint.axes[2], -q[2]).toRotationMatrix();
  Eigen::Matrix3d columns;
  for (int k = 0; k < 2; ++k) {
    const Eigen::Vector3d& axis = joint.axes[k];
    const Eigen::Vector3d once = s.cross(axis);
    columns.col(k) = untwist * (axis - a * once + b * s.cross(once));
  }
  columns.col(2) = joint.axes[2];
  return columns;
}

void Coordinates::set_rotation(std::int32_t i, const Eigen::Quaterniond& r, State& state) const {
  const RigJoint& joint = rig_->joints[i];
  double* q = state.q.data() + begin(i);
  if (joint.type == JointType::free) {
    state.turn = r.normalized();
  } else if (joint.type == JointType::ball) {
    const SwingTwist st = decompose(r, joint.axes);
    const Eigen::Vector2d swing =
        SwingEllipse::of(joint).project(Eigen::Vector2d(st.swing0, st.swing1));
    q[0] = swing.x();
    q[1] = swing.y();
    q[2] = wrap_into(joint.limits[2], st.twist);
    q[2] = std::clamp(q[2], lower_[begin(i) + 2], upper_[begin(i) + 2]);
  } else if (joint.type != JointType::fixed) {
    angles_from_rotation(joint, r, q);
    for (int k = 0; k < dof_count(joint.type); ++k) {
      const Eigen::Index dof = begin(i) + k;
      if (is_limited(joint.limits[k])) q[k] = wrap_into(joint.limits[k], q[k]);
      q[k] = std::clamp(q[k], lower_[dof], upper_[dof]);
    }
  }
}

State Coordinates::from_pose(std::span<const DualQuaternion> parent_from_joint) const {
  State state;
  state.q.setZero(dofs());
  for (std::int32_t i = 0; i < rig_->size(); ++i) {
    const RigJoint& joint = rig_->joints[i];
    set_rotation(i, joint.rest.conjugate() * parent_from_joint[i].rotation(), state);
    if (joint.type == JointType::free) {
      state.q.segment<3>(begin(i)) = parent_from_joint[i].translation() - joint.offset;
    }
  }
  return state;
}

void Coordinates::to_pose(const State& state, std::span<DualQuaternion> parent_from_joint) const {
  for (std::int32_t i = 0; i < rig_->size(); ++i) {
    const RigJoint& joint = rig_->joints[i];
    Eigen::Vector3d offset = joint.offset;
    if (joint.type == JointType::free) offset += state.q.segment<3>(begin(i));
    parent_from_joint[i] =
        DualQuaternion::from_rotation_translation(joint.rest * rotation(i, state), offset);
  }
}

void Coordinates::add(const Eigen::VectorXd& step, State& state) const {
  state.q += step;
  if (rig_->joints.front().type != JointType::free) return;
  const Eigen::Vector3d turn = state.q.segment<3>(3);
  state.turn = (state.turn * rotation_exp(turn)).normalized();
  state.q.segment<3>(3).setZero();
}

void Coordinates::clamp(State& state) const {
  state.q = state.q.cwiseMax(lower_).cwiseMin(upper_);
  for (const Swing& swing : swings_) {
    auto s = state.q.segment<2>(swing.dof);
    s = swing.ellipse.project(s).eval();
  }
}

void Coordinates::extrapolate(const State& before, const State& after, State& next) const {
  next.q = 2.0 * after.q - before.q;
  next.turn = (after.turn * (before.turn.conjugate() * after.turn)).normalized();
  clamp(next);
}

void Coordinates::towards_middle(double share, State& state) const {
  for (Eigen::Index k = 0; k < dofs(); ++k) {
    if (upper_[k] == kUnlimited) continue;
    state.q[k] += share * (0.5 * (lower_[k] + upper_[k]) - state.q[k]);
  }
  for (const Swing& swing : swings_) {
    const SwingEllipse& e = swing.ellipse;
    auto s = state.q.segment<2>(swing.dof);
    s += share * (0.5 * Eigen::Vector2d(e.min0 + e.max0, e.min1 + e.max1) - s);
  }
  clamp(state);
}

void Coordinates::randomise(std::mt19937_64& random, State& state) const {
  // Not std::uniform_real_distribution: its numbers differ between libraries.
  const auto unit = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
  for (Eigen::Index k = 0; k < dofs(); ++k) {
    if (upper_[k] < kUnlimited) state.q[k] = lower_[k] + unit() * (upper_[k] - lower_[k]);
  }
  for (const Swing& swing : swings_) {
    const SwingEllipse& e = swing.ellipse;
    auto s = state.q.segment<2>(swing.dof);
    const double s0 = e.min0 + unit() * (e.max0 - e.min0);
    const double s1 = e.min1 + unit() * (e.max1 - e.min1);
    s = e.project(Eigen::Vector2d(s0, s1));
  }
}

}  // namespace limber::peers
