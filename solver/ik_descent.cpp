// The outer loop.
//
// f(x) = sum of the squared weighted effector errors, x the coordinates, limits a convex set C
// (boxes and ellipses, see ik_tree.cpp). Per relinearisation
//   d = argmin 1/2 d'(J'WJ + mu D) d - d'J'We,  x + d in C,
// and x <- x + d where f fell. mu is Levenberg's: it grows until f falls, so f never rises and a
// target out of reach ends in a stable best reach; it shrinks with the agreement of predicted and
// actual fall (Nielsen 1999). What the targets leave open drifts: damping therefore pulls not to 0
// but by kEase towards the middle of the ranges, which fades with mu. At a fixed point d = 0, and
// the linear problem's own optimality, projected_residual = 0, is the optimality of f in C: what
// plain projected Gauss-Seidel sweeps would converge to, here reached through the tree
// (tree_elimination.cpp).
//
// Along a clip mu is almost 0: what is missed is little, one undamped step finds it. Not where a
// chain is nearly straight or folded, and two solutions about to become one: a direction of gain s
// = |J d| / |d| then gets a step |e| / s, past what the linear problem knows. A damped one is
//   s |e| / (s^2 + mu) <= |e| / (2 sqrt(mu)),
// so where a step failed, mu = f / (2 kFirm)^2 makes the next one no longer than kFirm. Damping
// then fades slowly: the frames after are near that place too.
//
// Rows that join branches (rows.cpp) enter the linear problem (row_solver.cpp). Soft ones belong to
// f. Hard ones join what must fall as nu times their violation beyond tolerance, an exact penalty:
// nu exceeds their multipliers, so that its minimum obeys them wherever they can be obeyed.
#include "solver/ik_descent.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace limber {

namespace {

constexpr double kLeastDamping = 1e-9, kMostDamping = 1e8;
constexpr double kEase = 5e-4;     // of the way to the middle of the ranges, per relinearisation
constexpr double kShrink = 0.1;    // of the damping, at best, per relinearisation;
constexpr double kFade = 0.45;     // of a clip's
constexpr double kFirm = 0.09;     // rad: the longest step after one that failed, in a clip
constexpr double kMostPush = 1e4;  // of a hard row, per root of the cost
constexpr int kBends = 2, kSettles = 10;
constexpr double kSettleDamping = 1.0;  // of the least step
constexpr double kPenalty = 1.5;        // of the largest multiplier
constexpr double kStalling = 0.7;       // a relative fall below this asks for the errors' curvature
constexpr double kSlide = 0.02;         // of a step: what a swing's touching point may be out by
constexpr int kEarly = 2;               // the first relinearisations, which others may follow,
constexpr double kEarlyBend = 0.2;      // rad: let the border bend by so much besides
constexpr int kChords = 2;              // steps more with the same factors

}  // namespace

IkDescent::IkDescent(const Rig& source, const IkOptions& chosen)
    : rig(source),
      options(chosen),
      tree(source, chosen.collision || chosen.separations > 0),
      elimination(tree),
      goals(tree.effectors.size()),
      now(tree.make_state()),
      next(now),
      at_now(tree.make_kinematics()),
      at_next(at_now),
      load(tree.nodes.size()),
      rows(source, tree, chosen),
      rows_now(rows.make_place()),
      rows_next(rows_now),
      row_solver(tree, rows.none() ? 0 : rows.capacity()),
      settled_damping(chosen.damping),
      step(Eigen::VectorXd::Zero(tree.coordinate_count())) {
  rows_next.rows.reserve(rows_now.rows.capacity());
  for (const IkNode& node : tree.nodes) {
    if (node.ellipse) ellipses.push_back({node.coordinate, node.swing});
  }
  gradient = diagonal = end = wish = anchor = step;
}

bool IkDescent::done(const IkKinematics& k, const RowPlace& place) const {
  if (place.worst > 1.0) return false;
  return k.cost <= options.stop_cost || (options.stop_at_tolerance && place.reached && reached(k));
}

double IkDescent::merit(const IkKinematics& k, const RowPlace& place) const {
  return k.cost + 2.0 * penalty * place.excess;
}

bool IkDescent::reached(const IkKinematics& k) const {
  const double position2 = options.stop_position_m * options.stop_position_m;
  const double rotation2 = options.stop_orientation_rad * options.stop_orientation_rad;
  for (std::size_t e = 0; e < goals.size(); ++e) {
    if (!tree.effectors[e].strong) continue;
    if (goals[e].mass > 0.0 && k.error[e].position.squaredNorm() > position2) return false;
    if (goals[e].inertia > 0.0 && k.error[e].rotation.squaredNorm() > rotation2) return false;
  }
  return true;
}

void IkDescent::evaluate(const IkState& state, IkKinematics& k, RowPlace& place) {
  tree.evaluate(state, goals, k);
  if (rows.none()) return;
  rows.build(state, k, place);
  k.cost += place.cost;
}

void IkDescent::linearise(bool curved) {
  tree.linearise(now, at_now);
  if (!rows.none()) rows.anchor(at_now, rows_now);
  effector_load(tree, goals, at_now, load, curved);
}

/// Of the last linear problem, at its step: gradient (H + damping D) step - J'We, by node twists
/// and composite inertias, with nothing of the elimination in it. Spoils `load`.
double IkDescent::measure_residual(double damping) {
  const bool curved = load.curved;
  const auto twist = elimination.node_twist();
  for (std::size_t n = 0; n < tree.nodes.size(); ++n) {
    load.pull[n] = load.inertia[n] * twist[n] - load.pull[n];
    if (!rows.none()) load.pull[n] -= row_solver.push().wrench[n];
  }
  for (std::size_t n = tree.nodes.size(); n-- > 0;) {
    const IkNode& node = tree.nodes[n];
    Vector6 inner = twist[n];
    for (std::int32_t k = node.coordinate + node.coordinates - 1; k >= node.coordinate; --k) {
      const Vector6& axis = at_now.axis[k];
      const double armature = damping * tree.damping[k];
      gradient[k] = axis.dot(load.pull[n]) + armature * (step[k] - wish[k]);
      if (!rows.none()) gradient[k] -= row_solver.push().force[k];
      diagonal[k] = axis.dot(load.inertia[n] * axis) + armature;
      if (!curved) continue;
      const Vector6 turned = 0.5 * turn_of_pull(axis, load.outer_pull[n]);
      inner -= step[k] * axis;
      gradient[k] -= turned.dot(inner);
      load.pull[n] -= step[k] * turned;
    }
    if (node.parent < 0) continue;
    load.inertia[node.parent] += load.inertia[n];
    load.pull[node.parent] += load.pull[n];
  }
  if (curved) {  // scaled by J'WJ all the same: a curved diagonal may be anything
    effector_load(tree, goals, at_now, load, false);
    compose_load(tree, load);
    for (std::size_t n = 0; n < tree.nodes.size(); ++n) {
      const IkNode& node = tree.nodes[n];
      for (std::int32_t k = node.coordinate; k < node.coordinate + node.coordinates; ++k) {
        diagonal[k] =
            at_now.axis[k].dot(load.inertia[n] * at_now.axis[k]) + damping * tree.damping[k];
      }
    }
  }
  end = now.x + step;
  tree.project(end);
  return projected_residual(end, gradient, diagonal, tree.min, tree.max, ellipses);
}

/// What the model of the last step says the cost will fall by.
double IkDescent::predicted_fall(double damping) const {
  const auto twist = elimination.node_twist();
  if (!load.curved) {
    return at_now.cost - rows_now.cost - predicted_cost(tree, goals, at_now, twist) +
           predicted_row_fall();
  }
  double fall = damping * step.cwiseProduct(step - wish).dot(tree.damping);
  for (std::size_t n = 0; n < tree.nodes.size(); ++n) fall += load.pull[n].dot(twist[n]);
  for (const Row& row : rows_now.rows) fall -= row.lambda * row.rate(twist, step);
  return fall + predicted_row_fall();
}

/// The part of the rows, soft and hard, in what the merit will fall by.
double IkDescent::predicted_row_fall() const {
  double fall = 0.0;
  for (const Row& row : rows_now.rows) {
    const double before = row.value, after = before + row.rate(elimination.node_twist(), step);
    fall += row.hard() ? 2.0 * penalty * (row.excess(before) - row.excess(after))
                       : (before * before - after * after) / row.compliance;
  }
  return fall;
}

/// rows_next become rows_now; those that were there already start from the multipliers they had.
void IkDescent::carry_multipliers() {
  auto old = rows_now.rows.begin();
  for (Row& row : rows_next.rows) {
    while (old != rows_now.rows.end() && old->id < row.id) ++old;
    const bool same = old != rows_now.rows.end() && old->id == row.id;
    if (same && old->hard() == row.hard()) row.lambda = old->lambda;
  }
  std::swap(rows_now, rows_next);
}

EliminationStats IkDescent::solve_rows(double damping, IkReport& report) {
  double worst = 0.0;
  for (const Row& row : rows_now.rows) worst = std::max(worst, row.excess(row.value));
  const double most = kMostPush * (0.01 + std::sqrt(at_now.cost) + worst);
  const RowStats stats =
      row_solver.solve(elimination, now.x, damping, wish, rows_now.rows, most, step);
  report.sweeps += stats.sweeps;
  report.active_rows = stats.active;
  for (const Row& row : rows_now.rows) {
    if (row.hard()) penalty = std::max(penalty, kPenalty * std::abs(row.lambda));
  }
  return stats.tree;
}

/// Second-order correction (R. Fletcher, Practical Methods of Optimization, 1987, section 14.4):
/// the same problem, with hard rows asked for what they turned out to lack after the step. Without
/// it the merit would turn down good steps along curved rows.
void IkDescent::bend_step(double damping, IkReport& report) {
  for (int i = 0; i < kBends && rows_next.worst > 1.0; ++i) {
    auto met = rows_next.rows.begin();
    for (Row& row : rows_now.rows) {
      if (i == 0) row.place = row.value;
      while (met != rows_next.rows.end() && met->id < row.id) ++met;
      if (!row.hard() || met == rows_next.rows.end() || met->id != row.id) continue;
      row.value = met->value - row.rate(elimination.node_twist(), step);
    }
    solve_linear(damping, report);
    tree.move(now, step, next);
    evaluate(next, at_next, rows_next);
  }
  for (Row& row : rows_now.rows) row.value = row.place;
}

/// Hard rows first: where the descent ended before they were kept, the least step that keeps them.
void IkDescent::settle_rows(IkReport& report) {
  for (int i = 0; i < kSettles && rows_now.worst > 1.0; ++i) {
    linearise();
    wish.setZero();
    elimination.linearise(now.x, at_now, load);
    solve_linear(kSettleDamping, report);
    tree.move(now, step, next);
    evaluate(next, at_next, rows_next);
    if (rows_next.worst >= rows_now.worst) break;
    carry_multipliers();
    std::swap(now, next);
    std::swap(at_now, at_next);
  }
}

/// One linear problem, solved; the curved one where it has a minimum.
EliminationStats IkDescent::solve_linear(double damping, IkReport& report) {
  if (!rows.none()) {
    EliminationStats stats = solve_rows(damping, report);
    report.tree_passes += stats.passes;
    if (stats.definite) return stats;
    effector_load(tree, goals, at_now, load, false);
    stats = solve_rows(damping, report);
    report.tree_passes += stats.passes;
    return stats;
  }
  EliminationStats stats = elimination.solve(now.x, damping, wish, step);
  report.tree_passes += stats.passes;
  if (stats.definite) return stats;
  effector_load(tree, goals, at_now, load, false);
  stats = elimination.solve(now.x, damping, wish, step);
  report.tree_passes += stats.passes;
  return stats;
}

/// From `next`, where a step ended, further ones with the factors of the place before (the chord
/// method): each leaves about its own length (rad) of what was left, for a quarter of the work. One
/// longer than the step before it tells that they do not converge (P. Deuflhard, Newton Methods for
/// Nonlinear Problems, 2004, section 2.1: the monotonicity test on simplified steps).
void IkDescent::step_again() {
  const Eigen::Vector3d origin = at_now.origin;
  double length = step.cwiseAbs().maxCoeff();
  for (int i = 0; i < kChords && !done(at_next, rows_next); ++i) {
    at_next.origin = origin;
    effector_load(tree, goals, at_next, load);
    elimination.solve_again(load.pull, step);
    const double before = std::exchange(length, step.cwiseAbs().maxCoeff());
    if (!(length <= before)) return;
    tree.move(next, step, now);
    evaluate(now, at_now, rows_now);
    if (!(at_now.cost < at_next.cost)) return;
    std::swap(now, next);
    std::swap(at_now, at_next);
  }
}

void IkDescent::descend(IkReport& report, bool following) {
  evaluate(now, at_now, rows_next);
  carry_multipliers();
  penalty = 0.0;
  if (tree.nodes.empty()) return;
  report.converged = !following && done(at_now, rows_now);
  if (report.converged) return;
  if (!following) elimination.reset(now.x);
  // Rows bend, which the model leaves out: undamped, it would wander where the cost is flat.
  const double least = rows.none() ? kLeastDamping : options.damping;
  double damping = following ? settled_damping : options.damping, growth = 2.0;
  bool curved = false;
  while (!report.converged && report.relinearisations < options.max_relinearisations) {
    const bool early = following && report.relinearisations < kEarly;
    const bool near = following && at_now.cost < kWoundCost;
    const double shrink = near ? kFade : kShrink;
    elimination.settle_slides_within(following ? kSlide : 0.0, early ? kEarlyBend : 0.0);
    ++report.relinearisations;
    linearise(curved);
    if (!following) anchor = now.x + kEase * (tree.middle - now.x);
    wish = tree.limited.cwiseProduct(anchor - now.x);
    elimination.linearise(now.x, at_now, load);
    bool fell = false;
    double tried = damping;
    while (!fell && !report.converged) {
      tried = damping;
      const EliminationStats stats = solve_linear(damping, report);
      tree.move(now, step, next);
      evaluate(next, at_next, rows_next);
      const bool arrived = following && done(at_next, rows_next);
      const double predicted = arrived ? 0.0 : predicted_fall(damping);
      if (rows_next.worst > 1.0) bend_step(damping, report);
      const double fall = merit(at_now, rows_now) - merit(at_next, rows_next);
      const bool negligible = step.cwiseAbs().maxCoeff() < options.stop_step;
      fell = fall >= 0.0 || arrived;
      if (arrived) {
        damping = std::max(least, shrink * damping);
        report.converged = true;
      } else if (fell) {
        const double agreement = predicted > 0.0 ? fall / predicted : 1.0;
        const double cube = std::pow(2.0 * agreement - 1.0, 3);
        damping = std::max(least, damping * std::max(shrink, 1.0 - cube));
        growth = 2.0;
        const bool level =
            fall < options.stop_cost_decrease * at_now.cost && rows_next.worst <= 1.0;
        report.converged = done(at_next, rows_next) ||
                           ((negligible || level) && stats.settled && agreement > 0.25);
        // Errors that stay large have curvature that counts.
        curved = fall < kStalling * at_now.cost;
      } else {
        // With the pull no damping makes the step small. On the way to a tolerance that is welcome,
        // it leads out of corners; where the optimum itself is sought, it ends short of it.
        if (following || !options.stop_at_tolerance) wish.setZero();
        damping *= growth;
        growth *= 2.0;
        if (near) damping = std::max(damping, at_now.cost / (4.0 * kFirm * kFirm));
        report.converged = negligible || damping > kMostDamping;
        if (!rows.none()) {
          // Rows held, nothing to gain: done. Else descend straight, without easing.
          report.converged |= rows_now.worst <= 1.0 && stats.settled &&
                              predicted < options.stop_cost_decrease * at_now.cost;
          wish.setZero();
        }
      }
    }
    if (options.measure_residual &&
        (report.converged || report.relinearisations == options.max_relinearisations)) {
      report.residual = measure_residual(tried);
    }
    if (!fell) break;
    if (early && !report.converged && rows.none()) {
      step_again();
      report.converged = done(at_next, rows_next);
    }
    carry_multipliers();
    std::swap(now, next);
    std::swap(at_now, at_next);
  }
  settled_damping = std::min(damping, options.damping);
  settle_rows(report);
}

}  // namespace limber
