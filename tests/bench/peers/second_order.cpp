// Damping follows the error, mu = mu0 + k |r|^2 (Sugihara 2011), so that least squares converge
// quadratically where the targets are reachable; a step that does not lower the error is taken back
// and tried with ten times more damping.
//
// The gradient of 1/2 |r|^2 is -J'r exactly, rotations included: their weights are the same about
// every axis, and log(R) is an eigenvector of exp's Jacobian there.
#include "tests/bench/peers/second_order.h"

#include <algorithm>

namespace limber::peers {

namespace {

constexpr int kMaxIterations = 100;
constexpr double kDamping = 1e-7;  // mu0
constexpr double kMaxDamping = 1e4;
constexpr double kStall = 1e-7;  // relative fall of |r|^2 that counts as none

}  // namespace

SecondOrder::SecondOrder(Task& task, double damping_gain)
    : task_(task), damping_gain_(damping_gain), limited_(task.coordinates()) {}

int SecondOrder::solve(State& state) {
  task_.evaluate(state);
  double cost = task_.cost(), extra = 0.0;
  int iterations = 0;
  while (!task_.reached() && iterations < kMaxIterations && extra < kMaxDamping) {
    ++iterations;
    model(state, h_, g_);
    h_.diagonal().array() += kDamping + damping_gain_ * cost + extra;
    double fall = -1.0;
    if (limited_.solve(state, h_, g_)) {
      trial_ = state;
      task_.coordinates().add(limited_.step(), trial_);
      task_.coordinates().clamp(trial_);
      task_.evaluate(trial_);
      fall = cost - task_.cost();
    }
    if (fall > 0.0) {
      moved(state, trial_);
      std::swap(state, trial_);
      cost -= fall;
      extra *= 0.1;
      if (fall < kStall * cost) break;
    } else {
      extra = std::max(10.0 * extra, 1e-3);
      task_.evaluate(state);
    }
  }
  return iterations;
}

void LeastSquares::model(const State& state, Eigen::MatrixXd& h, Eigen::VectorXd& g) {
  if (assembly_ == Assembly::chains) return task_.normal_equations(state, h, g);
  const Eigen::Index n = task_.coordinates().dofs();
  task_.dense_jacobian(state, jacobian_);
  h.setZero(n, n);
  h.selfadjointView<Eigen::Lower>().rankUpdate(jacobian_.transpose());
  h.triangularView<Eigen::StrictlyUpper>() = h.transpose();
  g.noalias() = jacobian_.transpose() * task_.residual();
}

// The Hessian of 1/2 |r|^2 is -d(J'r)/dq. Swings that a difference would push through the border
// are no harm: limits bind steps, not the model.
void Newton::model(const State& state, Eigen::MatrixXd& h, Eigen::VectorXd& g) {
  constexpr double kShift = 1e-6;  // rad, m
  const Eigen::Index n = task_.coordinates().dofs();
  task_.descent(state, g);
  h.resize(n, n);
  shift_.setZero(n);
  for (Eigen::Index k = 0; k < n; ++k) {
    shift_[k] = kShift;
    nearby_ = state;
    task_.coordinates().add(shift_, nearby_);
    shift_[k] = 0.0;
    task_.evaluate(nearby_);
    task_.descent(nearby_, there_);
    h.col(k) = (g - there_) / kShift;
  }
  h = (0.5 * (h + h.transpose())).eval();
  task_.evaluate(state);
}

int Bfgs::solve(State& state) {
  const int iterations = SecondOrder::solve(state);
  if (!task_.reached()) b_.resize(0, 0);
  return iterations;
}

void Bfgs::model(const State& state, Eigen::MatrixXd& h, Eigen::VectorXd& g) {
  if (b_.size() == 0) task_.normal_equations(state, b_, g_);  // a better start than the identity
  task_.descent(state, g_);
  g = g_;
  h = b_;
}

// Damped as Powell 1978 has it, so that B stays positive definite.
void Bfgs::moved(const State& from, const State& to) {
  task_.descent(to, after_);
  Eigen::VectorXd s = to.q - from.q;
  if (task_.coordinates().rig().joints.front().type == JointType::free) {
    s.segment<3>(3) = rotation_log(Eigen::Quaterniond(from.turn.conjugate() * to.turn));
  }
  const Eigen::VectorXd bs = b_ * s;
  const double sbs = s.dot(bs);
  if (!(sbs > 1e-20)) return;
  Eigen::VectorXd y = g_ - after_;
  const double sy = s.dot(y);
  const double theta = sy >= 0.2 * sbs ? 1.0 : 0.8 * sbs / (sbs - sy);
  y = theta * y + (1.0 - theta) * bs;
  b_ += y * y.transpose() / s.dot(y) - bs * bs.transpose() / sbs;
}

}  // namespace limber::peers
