// A limited quadratic problem   min 1/2 d'Hd - d'g   over steps d that keep every limit.
//
// Limits found active are locked, the rest is solved by Cholesky; what the step then violates is
// locked at its limit, what its limit no longer holds (by the sign of the multiplier g - Hd) is
// released, and so on until nothing changes.
//
// A range locks its coordinate at the bound. A swing ellipse locks its normal: the swing's two
// coordinates are turned so that the first points out of the ellipse at the point where the step
// would leave it. What the border's curvature adds is of second order; clamping takes it away.
#include "tests/bench/peers/limited_step.h"

#include <Eigen/Cholesky>
#include <algorithm>

namespace limber::peers {

namespace {

constexpr int kMaxPasses = 12;     // lock and release
constexpr double kOnLimit = 1e-9;  // rad
constexpr double kHeld = 1e-12;    // a multiplier below it releases nothing

Eigen::Vector2d outward(const SwingEllipse& e, const Eigen::Vector2d& s) {
  const double a = s.x() < 0.0 ? e.min0 : e.max0, b = s.y() < 0.0 ? e.min1 : e.max1;
  const Eigen::Vector2d normal(a == 0.0 ? 0.0 : s.x() / (a * a), b == 0.0 ? 0.0 : s.y() / (b * b));
  return normal.stableNormalized();
}

}  // namespace

LimitedStep::LimitedStep(const Coordinates& coordinates) : coordinates_(coordinates) {
  const Eigen::Index n = coordinates_.dofs();
  factor_.resize(n, n);
  step_.resize(n);
  side_.resize(static_cast<std::size_t>(n));
  basis_.resize(coordinates_.swings().size());
  free_.reserve(static_cast<std::size_t>(n));
}

bool LimitedStep::solve(const State& state, Eigen::MatrixXd& h, Eigen::VectorXd& g) {
  h_ = &h;
  g_ = &g;
  lock_active(state);
  for (int pass = 0; pass < kMaxPasses; ++pass) {
    if (!solve_free()) return false;
    if (!lock_violated(state) && !release()) break;
  }
  const auto& swings = coordinates_.swings();
  for (std::size_t i = 0; i < swings.size(); ++i) {
    auto s = step_.segment<2>(swings[i].dof);
    const Eigen::Vector2d normal = basis_[i];
    s = (s.x() * normal + s.y() * Eigen::Vector2d(-normal.y(), normal.x())).eval();
  }
  return true;
}

/// Limits that the state is on and the descent direction pushes against.
void LimitedStep::lock_active(const State& state) {
  std::fill(side_.begin(), side_.end(), 0);
  step_.setZero();
  for (Eigen::Index k = 0; k < g_->size(); ++k) {
    if (state.q[k] >= coordinates_.upper()[k] - kOnLimit && (*g_)[k] > 0.0) lock(k, 0.0, 1);
    if (state.q[k] <= coordinates_.lower()[k] + kOnLimit && (*g_)[k] < 0.0) lock(k, 0.0, -1);
  }
  const auto& swings = coordinates_.swings();
  for (std::size_t i = 0; i < swings.size(); ++i) {
    basis_[i] = Eigen::Vector2d::UnitX();
    const Eigen::Vector2d s = state.q.segment<2>(swings[i].dof);
    if (swings[i].ellipse.level(s) < 1.0 - kOnLimit) continue;
    const Eigen::Vector2d normal = outward(swings[i].ellipse, s);
    if (normal.dot(g_->segment<2>(swings[i].dof)) <= 0.0) continue;
    turn_basis(i, normal);
    lock(swings[i].dof, 0.0, 1);
  }
}

void LimitedStep::lock(Eigen::Index dof, double displacement, int side) {
  side_[static_cast<std::size_t>(dof)] = side;
  step_[dof] = displacement;
}

bool LimitedStep::solve_free() {
  free_.clear();
  for (Eigen::Index k = 0; k < g_->size(); ++k) {
    if (side_[static_cast<std::size_t>(k)] == 0) {
      free_.push_back(k);
      step_[k] = 0.0;
    }
  }
  const auto m = static_cast<Eigen::Index>(free_.size());
  if (m == 0) return true;
  right_ = *g_;
  for (Eigen::Index k = 0; k < g_->size(); ++k) {
    if (step_[k] != 0.0) right_.noalias() -= step_[k] * h_->col(k);
  }
  for (Eigen::Index j = 0; j < m; ++j) {
    const double* from = h_->col(free_[static_cast<std::size_t>(j)]).data();
    double* to = factor_.col(j).data();
    for (Eigen::Index i = j; i < m; ++i) to[i] = from[free_[static_cast<std::size_t>(i)]];
  }
  for (Eigen::Index j = 0; j < m; ++j) right_[j] = right_[free_[static_cast<std::size_t>(j)]];
  Eigen::Ref<Eigen::MatrixXd> in_place = factor_.topLeftCorner(m, m);
  const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> cholesky(in_place);
  if (cholesky.info() != Eigen::Success) return false;
  auto x = right_.head(m);
  cholesky.solveInPlace(x);
  for (Eigen::Index j = 0; j < m; ++j) step_[free_[static_cast<std::size_t>(j)]] = x[j];
  return true;
}

/// Locks what the step would push through its limit, at the limit.
bool LimitedStep::lock_violated(const State& state) {
  bool any = false;
  for (Eigen::Index k = 0; k < g_->size(); ++k) {
    if (side_[static_cast<std::size_t>(k)] != 0) continue;
    const double to = state.q[k] + step_[k];
    if (to > coordinates_.upper()[k] + kOnLimit) {
      lock(k, coordinates_.upper()[k] - state.q[k], 1);
      any = true;
    } else if (to < coordinates_.lower()[k] - kOnLimit) {
      lock(k, coordinates_.lower()[k] - state.q[k], -1);
      any = true;
    }
  }
  const auto& swings = coordinates_.swings();
  for (std::size_t i = 0; i < swings.size(); ++i) {
    const Eigen::Index k = swings[i].dof;
    if (side_[static_cast<std::size_t>(k)] != 0) continue;
    const Eigen::Vector2d s = state.q.segment<2>(k);
    const Eigen::Vector2d tangent(-basis_[i].y(), basis_[i].x());
    const Eigen::Vector2d to = s + step_[k] * basis_[i] + step_[k + 1] * tangent;
    if (swings[i].ellipse.level(to) <= 1.0 + kOnLimit) continue;
    const Eigen::Vector2d border = swings[i].ellipse.project(to);
    const Eigen::Vector2d normal = outward(swings[i].ellipse, border);
    turn_basis(i, normal);
    lock(k, normal.dot(border - s), 1);
    any = true;
  }
  return any;
}

/// Frees what its limit no longer holds: the multiplier r = g - H d points inwards.
bool LimitedStep::release() {
  if (free_.size() == side_.size()) return false;
  multiplier_ = *g_;
  multiplier_.noalias() -= *h_ * step_;
  bool any = false;
  for (Eigen::Index k = 0; k < g_->size(); ++k) {
    int& side = side_[static_cast<std::size_t>(k)];
    if (side * multiplier_[k] < -kHeld) {
      side = 0;
      any = true;
    }
  }
  return any;
}

/// Turns the two coordinates of a swing so that the first runs along `normal`.
void LimitedStep::turn_basis(std::size_t swing, const Eigen::Vector2d& normal) {
  const Eigen::Index k = coordinates_.swings()[swing].dof;
  const Eigen::Vector2d old = basis_[swing];
  const double c = old.dot(normal), s = old.x() * normal.y() - old.y() * normal.x();
  Eigen::Matrix2d old_from_new;
  old_from_new << c, -s, s, c;
  h_->middleCols<2>(k) = (h_->middleCols<2>(k) * old_from_new).eval();
  h_->middleRows<2>(k) = (old_from_new.transpose() * h_->middleRows<2>(k)).eval();
  g_->segment<2>(k) = (old_from_new.transpose() * g_->segment<2>(k)).eval();
  basis_[swing] = normal;
}

}  // namespace limber::peers
