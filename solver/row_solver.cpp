// Rows on top of the tree: a dual method.
//
// min over d of 1/2 d'Hd - g'd + sum of soft (J d + c)^2 / (2 compliance), x + d within limits,
// J d + c = 0 or >= 0 for the hard rows. The tree's elimination without limits gives d_0 = H^-1 g
// and, per row, half a response (tree_elimination.h). With multipliers l
//   d = d_0 + H^-1 J'l,
//   min over l of 1/2 l'Gl + (J d_0 + c)'l,  G = J H^-1 J' + E,  E the compliances,
// l >= 0 where a row is one-sided: projected Gauss-Seidel on the multipliers. A limit is a row like
// any other, one-sided, on its own coordinate; a swing's ellipse is the tangents that the step has
// been found to cross, each of which it lies inside of, so that adding one more at the nearest
// border point closes in on it. Limits and rows thus settle together: the fixed point of sweeps
// over the whole problem.
//
// Only what acts is in G: rows of two sides, rows that pressed before, limits that x touches; and
// whatever the step then violates joins for another round, until it violates nothing. What stays
// open costs one product. A trace of G's diagonal keeps redundant rows (two contacts of a rigid
// pair) solvable: they share the push.
#include "solver/row_solver.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>

namespace limber {

namespace {

constexpr int kMaxRounds = 40;
constexpr double kSettled = 1e-10;  // m, rad: a violation that counts as none
constexpr double kPart = 1e-3;      // of a row's tolerance, that does too
constexpr double kFirm = 1e-9;      // of G's diagonal, added for its factor
constexpr int kRefinements = 3;     // which take that trace out again
constexpr double kUnmoved = 1e-14;  // a diagonal below that: nothing that moves feels the row
constexpr double kTouch = 1e-9;     // rad, m: nearer to a limit counts as on it
constexpr double kCross = 1e-8;     // rad, m: a limit crossed by less is clamped after
constexpr double kBorder = 1e-6;    // rad: the same for a swing, whose tangents close in on it
constexpr double kOutward = 1e-3;   // of a swing on its border, to see the border's normal
constexpr int kSweeps = 3;          // to guess which multipliers press
constexpr int kPatience = 4;        // pivots of whole blocks without progress
constexpr int kMaxPivots = 100;     // one by one
constexpr int kFallbackSweeps = 100;
constexpr double kNoise = 1e-13;  // of the largest slack: rounding, not a wrong sign
constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Rows that act at once, with a limit per coordinate and some tangents.
std::size_t room_for(const IkTree& tree, std::size_t rows) {
  if (rows == 0) return 0;
  return std::min(rows, RowSolver::kMaxActive) + 2 * std::size_t(tree.coordinate_count());
}

}  // namespace

DualPgs::DualPgs(std::size_t capacity)
    : factor_(capacity, capacity),
      part_(static_cast<Eigen::Index>(capacity)),
      at_(capacity, At::low),
      should_(capacity, At::low) {
  before_ = part_;
  inside_.reserve(capacity);
}

/// Those inside their range take the minimum over them, the others stay on their bounds.
bool DualPgs::solve_inside(const Eigen::Ref<const Eigen::MatrixXd>& g,
                           const Eigen::Ref<const Eigen::VectorXd>& r,
                           Eigen::Ref<Eigen::VectorXd> l) {
  const auto m = static_cast<Eigen::Index>(inside_.size());
  if (m == 0) return true;
  for (const std::int32_t i : inside_) l[i] = 0.0;
  for (Eigen::Index a = 0; a < m; ++a) {
    const std::int32_t i = inside_[a];
    for (Eigen::Index b = 0; b <= a; ++b) factor_(a, b) = g(i, inside_[b]);
    factor_(a, a) *= 1.0 + kFirm;
  }
  Eigen::Ref<Eigen::MatrixXd> corner = factor_.topLeftCorner(m, m);
  const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> llt(corner);
  if (llt.info() != Eigen::Success) return false;
  for (int i = 0; i < kRefinements; ++i) {
    for (Eigen::Index a = 0; a < m; ++a) part_[a] = -(g.col(inside_[a]).dot(l) + r[inside_[a]]);
    llt.matrixL().solveInPlace(part_.head(m));
    llt.matrixU().solveInPlace(part_.head(m));
    for (Eigen::Index a = 0; a < m; ++a) l[inside_[a]] += part_[a];
  }
  return true;
}

namespace {

/// One sweep of projected Gauss-Seidel, in place.
void sweep(const Eigen::Ref<const Eigen::MatrixXd>& g, const Eigen::Ref<const Eigen::VectorXd>& r,
           const Eigen::Ref<const Eigen::VectorXd>& low,
           const Eigen::Ref<const Eigen::VectorXd>& high, Eigen::Ref<Eigen::VectorXd> l) {
  for (Eigen::Index i = 0; i < l.size(); ++i) {
    l[i] = std::clamp(l[i] - (g.col(i).dot(l) + r[i]) / g(i, i), low[i], high[i]);
  }
}

}  // namespace

DualPgs::Stats DualPgs::solve(const Eigen::Ref<const Eigen::MatrixXd>& g,
                              const Eigen::Ref<const Eigen::VectorXd>& r,
                              const Eigen::Ref<const Eigen::VectorXd>& low,
                              const Eigen::Ref<const Eigen::VectorXd>& high,
                              Eigen::Ref<Eigen::VectorXd> l) {
  Stats stats;
  const Eigen::Index n = r.size();
  for (; stats.sweeps < kSweeps; ++stats.sweeps) sweep(g, r, low, high, l);
  double scale = 0.0;  // of sqrt(g_ii) l_i and r_i / sqrt(g_ii), which have one unit
  for (Eigen::Index i = 0; i < n; ++i) {
    at_[i] = l[i] <= low[i] ? At::low : l[i] >= high[i] ? At::high : At::inside;
    scale = std::max(scale, std::abs(r[i]) / std::sqrt(g(i, i)));
  }
  noise_ = kNoise * scale;
  stats.settled = pivot_blocks(g, r, low, high, l, stats.pivots);
  if (!stats.settled) {
    l.setZero();
    for (int i = 0; i < kFallbackSweeps; ++i) sweep(g, r, low, high, l);
    stats.sweeps += kFallbackSweeps;
    stats.settled = pivot_singly(g, r, low, high, l, stats.pivots);
  }
  l = l.cwiseMax(low).cwiseMin(high);
  return stats;
}

/// At a bound: by how much its slope pulls inwards, in units of r / sqrt(diag).
double DualPgs::inward(const Eigen::Ref<const Eigen::MatrixXd>& g,
                       const Eigen::Ref<const Eigen::VectorXd>& r,
                       const Eigen::Ref<const Eigen::VectorXd>& l, std::int32_t i) const {
  const double slope = (g.col(i).dot(l) + r[i]) / std::sqrt(g(i, i));
  return at_[i] == At::low ? -slope : slope;
}

bool DualPgs::pivot_blocks(const Eigen::Ref<const Eigen::MatrixXd>& g,
                           const Eigen::Ref<const Eigen::VectorXd>& r,
                           const Eigen::Ref<const Eigen::VectorXd>& low,
                           const Eigen::Ref<const Eigen::VectorXd>& high,
                           Eigen::Ref<Eigen::VectorXd> l, int& pivots) {
  const auto n = static_cast<std::int32_t>(r.size());
  std::int32_t fewest = n + 1;
  for (int patience = kPatience; patience > 0; --patience) {
    ++pivots;
    inside_.clear();
    for (std::int32_t i = 0; i < n; ++i) {
      if (at_[i] == At::inside) inside_.push_back(i);
      if (at_[i] != At::inside) l[i] = at_[i] == At::low ? low[i] : high[i];
    }
    if (!solve_inside(g, r, l)) return false;
    std::int32_t wrong = 0;
    for (std::int32_t i = 0; i < n; ++i) {
      should_[i] = at_[i];
      if (at_[i] == At::inside) {
        const double root = std::sqrt(g(i, i));
        if ((low[i] - l[i]) * root > noise_) should_[i] = At::low;
        if ((l[i] - high[i]) * root > noise_) should_[i] = At::high;
      } else if (low[i] < high[i] && inward(g, r, l, i) > noise_) {
        should_[i] = At::inside;
      }
      wrong += should_[i] != at_[i];
    }
    if (wrong == 0) return true;
    if (wrong < fewest) patience = kPatience;
    fewest = std::min(fewest, wrong);
    std::copy_n(should_.begin(), n, at_.begin());
  }
  return false;
}

bool DualPgs::pivot_singly(const Eigen::Ref<const Eigen::MatrixXd>& g,
                           const Eigen::Ref<const Eigen::VectorXd>& r,
                           const Eigen::Ref<const Eigen::VectorXd>& low,
                           const Eigen::Ref<const Eigen::VectorXd>& high,
                           Eigen::Ref<Eigen::VectorXd> l, int& pivots) {
  const auto n = static_cast<std::int32_t>(r.size());
  for (std::int32_t i = 0; i < n; ++i) {
    at_[i] = l[i] <= low[i] ? At::low : l[i] >= high[i] ? At::high : At::inside;
  }
  for (int pivot = 0; pivot < kMaxPivots; ++pivot, ++pivots) {
    inside_.clear();
    for (std::int32_t i = 0; i < n; ++i) {
      if (at_[i] == At::inside) inside_.push_back(i);
    }
    before_.head(n) = l;
    if (!solve_inside(g, r, l)) return false;
    double way = 1.0;
    std::int32_t first = -1;
    for (const std::int32_t i : inside_) {
      const double step = l[i] - before_[i], bound = step > 0.0 ? high[i] : low[i];
      if (step == 0.0 || (bound - before_[i]) / step >= way) continue;
      way = (bound - before_[i]) / step;
      first = i;
    }
    l = before_.head(n) + way * (l - before_.head(n));
    if (first >= 0) {
      at_[first] = l[first] - low[first] < high[first] - l[first] ? At::low : At::high;
      l[first] = at_[first] == At::low ? low[first] : high[first];
      continue;
    }
    double most = noise_;
    for (std::int32_t i = 0; i < n; ++i) {
      if (at_[i] == At::inside || !(low[i] < high[i])) continue;
      const double pull = inward(g, r, l, i);
      if (pull <= most) continue;
      most = pull;
      first = i;
    }
    if (first < 0) return true;
    at_[first] = At::inside;
  }
  return false;
}

RowSolver::RowSolver(const IkTree& tree, std::size_t capacity)
    : tree_(tree),
      push_(tree),
      pgs_(room_for(tree, capacity)),
      acts_(capacity),
      walled_(2 * std::size_t(tree.coordinate_count())) {
  const auto room = static_cast<Eigen::Index>(room_for(tree, capacity));
  chosen_.resize(room);
  half_.setZero(tree.coordinate_count(), room);
  g_.setZero(room, room);
  r_.setZero(room);
  low_ = high_ = lambda_ = applied_ = r_;
  sum_.setZero(tree.coordinate_count());
}

/// A row or wall in place `a`, behind the others or of one that does not press; false where it
/// finds no room or nothing that moves. `slack` is what the step, with all that has been applied to
/// it, leaves.
bool RowSolver::add(TreeElimination& elimination, Eigen::Index a, const Row& row, double slack,
                    double low, double high) {
  if (a == g_.cols()) return false;
  elimination.respond(row, half_.col(a));
  const Eigen::Index n = std::max(a + 1, count_);
  if (row.hard() && half_.col(a).squaredNorm() < kUnmoved) {
    if (a == count_) return false;
    half_.col(a).setZero();  // a place in use stays in use, for nothing
  }
  for (Eigen::Index b = 0; b < n; ++b) g_(a, b) = g_(b, a) = half_.col(a).dot(half_.col(b));
  applied_[a] = 0.0;
  r_[a] = slack - g_.col(a).head(n).dot(applied_.head(n));
  g_(a, a) += row.compliance;
  if (g_(a, a) == 0.0) g_(a, a) = 1.0;
  low_[a] = low;
  high_[a] = high;
  lambda_[a] = row.lambda;
  count_ = n;
  return true;
}

bool RowSolver::add_row(TreeElimination& elimination, std::span<const Row> rows, std::size_t i,
                        const Eigen::VectorXd& step, double most) {
  const Row& row = rows[i];
  const double slack = row.rate(elimination.node_twist(), step) + row.value;
  const double high = row.hard() ? most : kInfinity;
  if (!add(elimination, count_, row, slack, row.one_sided ? 0.0 : -high, high)) return false;
  lambda_[count_ - 1] = std::clamp(row.lambda, low_[count_ - 1], high);
  chosen_[count_ - 1] = static_cast<std::int32_t>(i);
  acts_[i] = 1;
  return true;
}

/// A limit as a row: room + what its terms make of a further step stays above zero.
bool RowSolver::add_wall(TreeElimination& elimination, const Row::Term& first,
                         const Row::Term& second, double room) {
  Row wall;
  wall.terms = {first, second};
  // A swing's tangents replace those of its own that press no more.
  const std::int32_t name = second.node < 0 ? -1 : -2 - second.node;
  Eigen::Index a = count_;
  for (Eigen::Index b = 0; b < count_ && name != -1 && a == count_; ++b) {
    if (chosen_[b] == name && applied_[b] == 0.0) a = b;
  }
  if (!add(elimination, a, wall, room, 0.0, kInfinity)) return false;
  chosen_[a] = name;
  return true;
}

/// A coordinate's range on one side: +1 its minimum, -1 its maximum.
bool RowSolver::add_side(TreeElimination& elimination, std::int32_t node, std::int32_t coordinate,
                         double side, double room) {
  std::uint8_t& walled = walled_[2 * static_cast<std::size_t>(coordinate) + (side > 0.0)];
  if (walled != 0 || !add_wall(elimination, {node, coordinate, side}, {}, room)) return false;
  walled = 1;
  return true;
}

/// Walls for limits that x + step crosses.
bool RowSolver::add_walls(TreeElimination& elimination, const Eigen::VectorXd& x,
                          const Eigen::VectorXd& step) {
  bool added = false;
  for (std::size_t n = 0; n < tree_.nodes.size(); ++n) {
    const IkNode& node = tree_.nodes[n];
    const auto at = static_cast<std::int32_t>(n);
    for (std::int32_t k = node.coordinate; k < node.coordinate + node.coordinates; ++k) {
      const double end = x[k] + step[k];
      const double over = end - tree_.max[k], under = tree_.min[k] - end;
      if (over > kCross) added |= add_side(elimination, at, k, -1.0, -over);
      if (under > kCross) added |= add_side(elimination, at, k, 1.0, -under);
    }
    if (!node.ellipse) continue;
    const std::int32_t k = node.coordinate;
    const Eigen::Vector2d end = x.segment<2>(k) + step.segment<2>(k);
    const Eigen::Vector2d out = end - node.swing.project(end);
    const double over = out.norm();
    if (!(over > kBorder)) continue;
    const Eigen::Vector2d normal = out / over;
    added |= add_wall(elimination, {at, k, -normal.x()}, {at, k + 1, -normal.y()}, -over);
  }
  return added;
}

/// What acts from the beginning.
void RowSolver::begin(TreeElimination& elimination, const Eigen::VectorXd& x,
                      const Eigen::VectorXd& step, std::span<const Row> rows, double most) {
  count_ = 0;
  std::fill(walled_.begin(), walled_.end(), std::uint8_t(0));
  for (std::size_t i = 0; i < rows.size(); ++i) {
    acts_[i] = 0;
    if (!rows[i].one_sided || rows[i].lambda > 0.0) add_row(elimination, rows, i, step, most);
  }
  for (std::size_t n = 0; n < tree_.nodes.size(); ++n) {
    const IkNode& node = tree_.nodes[n];
    const auto at = static_cast<std::int32_t>(n);
    for (std::int32_t k = node.coordinate; k < node.coordinate + node.coordinates; ++k) {
      const double over = x[k] - tree_.max[k], under = tree_.min[k] - x[k];
      if (over > -kTouch) add_side(elimination, at, k, -1.0, -over - step[k]);
      if (under > -kTouch) add_side(elimination, at, k, 1.0, -under + step[k]);
    }
    if (!node.ellipse) continue;
    const Eigen::Vector2d swing = x.segment<2>(node.coordinate);
    const Eigen::Vector2d ahead = swing + step.segment<2>(node.coordinate);
    if (node.swing.level(swing) < 1.0 - kTouch || node.swing.level(ahead) < 1.0) continue;
    // A little beyond the border the nearest point's direction is its normal.
    const Eigen::Vector2d beyond = (1.0 + kOutward) * swing;
    const Eigen::Vector2d border = node.swing.project(beyond);
    const Eigen::Vector2d normal = (beyond - border).stableNormalized();
    add_wall(elimination, {at, node.coordinate, -normal.x()},
             {at, node.coordinate + 1, -normal.y()}, normal.dot(border - ahead));
  }
}

/// Rows and limits that the step violates join; false where there are none.
bool RowSolver::extend(TreeElimination& elimination, const Eigen::VectorXd& x,
                       const Eigen::VectorXd& step, std::span<const Row> rows, double most) {
  bool added = add_walls(elimination, x, step);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (acts_[i] != 0) continue;
    const double slack = rows[i].rate(elimination.node_twist(), step) + rows[i].value;
    if (slack < -kSettled - kPart * rows[i].tolerance) {
      added |= add_row(elimination, rows, i, step, most);
    }
  }
  return added;
}

RowStats RowSolver::solve(TreeElimination& elimination, const Eigen::VectorXd& x, double damping,
                          const Eigen::VectorXd& wish, std::span<Row> rows, double most,
                          Eigen::VectorXd& step) {
  RowStats stats;
  stats.tree = elimination.solve_free(x, damping, wish, step);
  if (!stats.tree.definite) return stats;
  begin(elimination, x, step, rows, most);
  stats.tree.settled = false;
  bool exact = true;
  while (!stats.tree.settled && stats.rounds < kMaxRounds) {
    ++stats.rounds;
    const Eigen::Index n = count_;
    const DualPgs::Stats dual = pgs_.solve(g_.topLeftCorner(n, n), r_.head(n), low_.head(n),
                                           high_.head(n), lambda_.head(n));
    stats.sweeps += dual.sweeps;
    stats.pivots += dual.pivots;
    exact = exact && dual.settled;
    applied_.head(n) = lambda_.head(n) - applied_.head(n);
    sum_.noalias() = half_.leftCols(n) * applied_.head(n);
    applied_.head(n) = lambda_.head(n);
    elimination.complete(sum_, step);
    stats.tree.settled = !extend(elimination, x, step, rows, most);
  }
  stats.tree.settled = stats.tree.settled && exact;
  push_.clear();
  for (Row& row : rows) row.lambda = 0.0;
  for (Eigen::Index a = 0; a < count_; ++a) {
    if (chosen_[a] < 0) continue;
    Row& row = rows[chosen_[a]];
    row.lambda = lambda_[a];
    push_.add(row, row.lambda);
    stats.active += row.hard() && row.one_sided && row.lambda > 0.0;
  }
  return stats;
}

}  // namespace limber
