// Rows on top of the tree: a dual method.
//
// min over d of 1/2 d'Hd - g'd + sum of soft (J d + c)^2 / (2 compliance), x + d within limits,
// J d + c = 0 or >= 0 for the hard rows. With multipliers l, what is left for the tree is
//   d(l) = argmin 1/2 d'Hd - (g + J'l)'d within limits:
// the effectors' pull and the rows' push, solved exactly, limits included (tree_elimination.cpp).
// The dual function is concave with gradient -(J d(l) + c + E l), E the compliances, one piece per
// set of active limits, on which its Hessian is -G, G = J H^-1 J' + E, H^-1 over the coordinates
// that no limit holds. So, as Newton's method for a function of such pieces does: at the current
// pieces
//   slack = J d(l) + c + E l,   min over w of 1/2 w'Gw + slack'w,  l + w within its bounds,
// by projected Gauss-Seidel (multipliers of one-sided rows >= 0); l <- l + w; the tree solves again
// and says which limits hold now. A step that overshoots, where the piece was left, is cut back by
// regula falsi on the slope along it. At the end the limits hold with multipliers of the right
// sign, the rows too, and d minimises: the fixed point of Gauss-Seidel over limits and rows
// together, in a few rounds.
//
// Only rows that press, or are violated, act in a round: what stays open costs one product. G comes
// from half responses, J_i H^-1 J_j' = half_i . half_j. A trace of G's diagonal keeps redundant
// rows (two contacts of a rigid pair) solvable: they share the push.
#include "solver/row_solver.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>

namespace limber {

namespace {

constexpr int kMaxRounds = 24;
constexpr int kMaxCuts = 24;
constexpr double kSettled = 1e-10;  // m, rad: slack that counts as none
constexpr double kFirm = 1e-11;     // of G's diagonal, added to hard rows
constexpr double kOvershoot = 0.9;  // of the slope at a step's start, at its end
constexpr double kStuck = 1e-3;     // of the largest of G's diagonal, for rows that limits hold
constexpr double kFirstCaution = 1e-3, kLeastCaution = 1e-6, kAlarm = 4.0, kCalm = 0.25;
constexpr int kSweeps = 3;  // between two subspace minimisations
constexpr int kMaxDualRounds = 40;

}  // namespace

DualPgs::DualPgs(std::size_t capacity)
    : factor_(capacity, capacity), part_(static_cast<Eigen::Index>(capacity)) {
  free_.reserve(capacity);
}

int DualPgs::solve(const Eigen::Ref<const Eigen::MatrixXd>& g,
                   const Eigen::Ref<const Eigen::VectorXd>& r,
                   const Eigen::Ref<const Eigen::VectorXd>& low,
                   const Eigen::Ref<const Eigen::VectorXd>& high, Eigen::Ref<Eigen::VectorXd> l,
                   double tolerance) {
  const Eigen::Index n = r.size();
  int sweeps = 0;
  for (int round = 0; round < kMaxDualRounds; ++round) {
    double change = 0.0, scale = 0.0;
    for (int sweep = 0; sweep < kSweeps; ++sweep, ++sweeps) {
      change = 0.0;
      for (Eigen::Index i = 0; i < n; ++i) {
        const double old = l[i];
        l[i] = std::clamp(old - (g.col(i).dot(l) + r[i]) / g(i, i), low[i], high[i]);
        change = std::max(change, std::abs(l[i] - old));
        scale = std::max({scale, std::abs(l[i]), std::abs(r[i] / g(i, i))});
      }
    }
    if (change <= tolerance * scale) break;
    free_.clear();
    for (Eigen::Index i = 0; i < n; ++i) {
      if (l[i] > low[i] && l[i] < high[i]) free_.push_back(static_cast<std::int32_t>(i));
    }
    const auto m = static_cast<Eigen::Index>(free_.size());
    if (m == 0) continue;
    for (Eigen::Index a = 0; a < m; ++a) {
      for (Eigen::Index b = 0; b <= a; ++b) factor_(a, b) = g(free_[a], free_[b]);
      part_[a] = -(g.col(free_[a]).dot(l) + r[free_[a]]);
    }
    Eigen::Ref<Eigen::MatrixXd> corner = factor_.topLeftCorner(m, m);
    const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> llt(corner);
    if (llt.info() != Eigen::Success) continue;
    llt.matrixL().solveInPlace(part_.head(m));
    llt.matrixU().solveInPlace(part_.head(m));
    // As far towards it as the first bound; the sweeps then say what that bound is worth.
    double way = 1.0;
    for (Eigen::Index a = 0; a < m; ++a) {
      const std::int32_t i = free_[a];
      const double bound = part_[a] > 0.0 ? high[i] : low[i];
      if (part_[a] != 0.0) way = std::min(way, (bound - l[i]) / part_[a]);
    }
    for (Eigen::Index a = 0; a < m; ++a) {
      const std::int32_t i = free_[a];
      l[i] = std::clamp(l[i] + way * part_[a], low[i], high[i]);
    }
  }
  return sweeps;
}

RowSolver::RowSolver(const IkTree& tree, std::size_t capacity)
    : push_(tree), pgs_(std::min(capacity, kMaxActive)) {
  const auto rows = static_cast<Eigen::Index>(capacity);
  const auto active = static_cast<Eigen::Index>(std::min(capacity, kMaxActive));
  chosen_.reserve(active);
  slack_.setZero(rows);
  way_.setZero(rows);
  half_.setZero(tree.coordinate_count(), active);
  g_.setZero(active, active);
  r_.setZero(active);
  low_ = high_ = lambda_ = r_;
}

void RowSolver::push_with(std::span<const Row> rows) {
  push_.clear();
  for (const Row& row : rows) {
    if (row.lambda != 0.0) push_.add(row, row.lambda);
  }
}

/// Slacks, and the largest that its row's multiplier does not excuse.
double RowSolver::measure(std::span<const Row> rows, std::span<const Vector6> twist,
                          const Eigen::VectorXd& step, double most) {
  double worst = 0.0;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const Row& row = rows[i];
    const double slack = row.rate(twist, step) + row.value + row.compliance * row.lambda;
    slack_[i] = slack;
    const double low = row.one_sided ? 0.0 : -most;
    const bool excused =
        row.hard() && ((slack > 0.0 && row.lambda <= low) || (slack < 0.0 && row.lambda >= most));
    if (!excused) worst = std::max(worst, std::abs(slack));
  }
  return worst;
}

void RowSolver::choose(std::span<const Row> rows) {
  chosen_.clear();
  for (std::size_t i = 0; i < rows.size() && chosen_.size() < chosen_.capacity(); ++i) {
    const Row& row = rows[i];
    if (!row.one_sided || row.lambda > 0.0 || slack_[i] < -kSettled) {
      chosen_.push_back(static_cast<std::int32_t>(i));
    }
  }
}

/// The quadratic problem of the chosen rows.
void RowSolver::couple(TreeElimination& elimination, std::span<const Row> rows, double most,
                       double caution) {
  const auto n = static_cast<Eigen::Index>(chosen_.size());
  double largest = 0.0;
  for (Eigen::Index a = 0; a < n; ++a) {
    elimination.respond(rows[chosen_[a]], half_.col(a));
    for (Eigen::Index b = 0; b <= a; ++b) g_(a, b) = g_(b, a) = half_.col(a).dot(half_.col(b));
    largest = std::max(largest, g_(a, a));
  }
  for (Eigen::Index a = 0; a < n; ++a) {
    const Row& row = rows[chosen_[a]];
    r_[a] = slack_[chosen_[a]];
    lambda_[a] = 0.0;
    low_[a] = high_[a] = std::numeric_limits<double>::infinity();
    low_[a] = -low_[a];
    if (!row.hard()) {
      g_(a, a) += row.compliance;
      continue;
    }
    high_[a] = std::max(most - row.lambda, 0.0);
    low_[a] = std::min((row.one_sided ? 0.0 : -most) - row.lambda, 0.0);
    g_(a, a) += kFirm * g_(a, a) + caution * (largest > 0.0 ? largest : 1.0);
    // Where limits hold all that could move, pushing still tells which of them give way.
    if (!(g_(a, a) > 1e-12 * largest)) g_(a, a) = largest > 0.0 ? kStuck * largest : 1.0;
  }
}

RowStats RowSolver::solve(TreeElimination& elimination, const Eigen::VectorXd& x, double damping,
                          const Eigen::VectorXd& wish, std::span<Row> rows, double most,
                          Eigen::VectorXd& step) {
  RowStats stats;
  const auto count = static_cast<Eigen::Index>(rows.size());
  double start_slope = 0.0;  // along way_, where the step began; < 0 descends
  double caution = 0.0;
  int cuts = 0;
  elimination.set_push(&push_);
  while (true) {
    push_with(rows);
    const EliminationStats tree = elimination.solve(x, damping, wish, step);
    stats.tree.passes += tree.passes;
    stats.tree.definite = tree.definite;
    if (!tree.definite) break;
    const double worst = measure(rows, elimination.node_twist(), step, most);
    if (worst <= kSettled) {
      stats.tree.settled = tree.settled;
      break;
    }
    const double slope = start_slope < 0.0 ? slack_.head(count).dot(way_.head(count)) : 0.0;
    if (slope > -kOvershoot * start_slope && ++cuts < kMaxCuts) {
      const double part = start_slope / (start_slope - slope);
      for (Eigen::Index i = 0; i < count; ++i) rows[i].lambda -= (1.0 - part) * way_[i];
      way_.head(count) *= part;
      start_slope *= part;
      caution = std::max(kAlarm * caution, kFirstCaution);
      continue;
    }
    if (++stats.rounds > kMaxRounds) break;
    choose(rows);
    couple(elimination, rows, most, caution);
    caution *= kCalm;
    if (caution < kLeastCaution) caution = 0.0;
    const auto n = static_cast<Eigen::Index>(chosen_.size());
    stats.sweeps += pgs_.solve(g_.topLeftCorner(n, n), r_.head(n), low_.head(n), high_.head(n),
                               lambda_.head(n));
    way_.head(count).setZero();
    for (Eigen::Index a = 0; a < n; ++a) {
      way_[chosen_[a]] = lambda_[a];
      rows[chosen_[a]].lambda += lambda_[a];
    }
    start_slope = slack_.head(count).dot(way_.head(count));
  }
  elimination.set_push(nullptr);
  for (const Row& row : rows) stats.active += row.hard() && row.one_sided && row.lambda > 0.0;
  return stats;
}

}  // namespace limber
