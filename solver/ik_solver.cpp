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
// A clip is followed: the start of a frame is extrapolated from the two answers before, the limits
// that were active stay so until their multipliers say otherwise, and damping goes on where it
// stood. So near the answer one relinearisation is enough, and one is always made, however near the
// start is: a pose that is merely good enough would jitter against its neighbours. What the targets
// leave open is pulled to an anchor, the last answer and kCalm of its speed: a free swivel coasts
// to rest instead of oscillating about the middle of its range.
//
// Out of reach, a best reach may cease to be one, and the descent ends in another, far away. Such a
// coordinate goes there in its time (one that strayed by kJump, until it is there): with D left to
// go, in one frame by at most sqrt(2 a D), from where it can still stop, and by at most a more than
// in the frame before; a is kMostStray over the coordinate's lever. The others are solved around
// it.
//
//
// Rows that join branches (rows.cpp) enter the linear problem (row_solver.cpp). Soft ones belong to
// f. Hard ones join what must fall as nu times their violation beyond tolerance, an exact penalty:
// nu exceeds their multipliers, so that its minimum obeys them wherever they can be obeyed.
//
// pgs_paper is paper_ik.cpp.
#include "solver/ik_solver.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "solver/jacobian.h"
#include "solver/paper_ik.h"
#include "solver/pgs.h"
#include "solver/row_solver.h"
#include "solver/rows.h"
#include "solver/speed_limits.h"
#include "solver/tree_elimination.h"

namespace limber {

namespace {

constexpr double kLeastDamping = 1e-9, kMostDamping = 1e8;
constexpr double kShrink = 0.1;  // of the damping, at best, per relinearisation
constexpr double kEase = 5e-4;   // of the way to the middle of its range, per relinearisation
constexpr int kUnwinds = 3;      // a third, two thirds, all of the way to the middle
constexpr double kWoundCost = 0.05 * 0.05;  // m^2; a worse miss is a target out of reach
constexpr double kCalm = 0.9;  // of the speed that the targets leave open, kept from frame to frame
constexpr double kSlide = 0.02;    // of a step: what a swing's touching point may be out by
constexpr double kMostPush = 1e4;  // of a hard row, per root of the cost
constexpr int kBends = 2, kSettles = 10;
constexpr double kSettleDamping = 1.0;  // of the least step
constexpr double kPenalty = 1.5;        // of the largest multiplier
constexpr double kJump = 8e-3;          // m per frame^2: what is more has jumped
constexpr double kHaste = 10.0;         // of what the targets themselves change by
constexpr double kMostStray = 2.5e-3;   // m per frame^2 at a coordinate's farthest effector
constexpr double kStalling = 0.7;       // a relative fall below this asks for the errors' curvature

}  // namespace

struct IkSolver::State {
  State(const Rig& source, const IkOptions& chosen)
      : rig(source),
        options(chosen),
        tree(source, chosen.collision),
        elimination(tree),
        goals(tree.effectors.size()),
        now(tree.make_state()),
        next(now),
        best(now),
        wound(now),
        last(now),
        before(now),
        at_now(tree.make_kinematics()),
        at_next(at_now),
        load(tree.nodes.size()),
        rows(source, tree, chosen),
        rows_now(rows.make_place()),
        rows_next(rows_now),
        row_solver(tree, rows.none() ? 0 : rows.capacity()),
        speed(source, tree, chosen.dt),
        step(Eigen::VectorXd::Zero(tree.coordinate_count())) {
    rows_next.rows.reserve(rows_now.rows.capacity());
    for (const IkNode& node : tree.nodes) {
      if (node.ellipse) ellipses.push_back({node.coordinate, node.swing});
    }
    gradient = diagonal = end = wish = anchor = start = step;
    settled_damping = options.damping;
    outside = skeleton_of(rig).rest_parent_from_joint;
    tree.load(outside, last);
    measure_levers();
    if (options.method == IkMethod::pgs_paper) paper.emplace(source, chosen);
  }

  bool reached(const IkKinematics&) const;
  bool done(const IkKinematics& k, const RowPlace& place) const {
    if (place.worst > 1.0) return false;
    return k.cost <= options.stop_cost ||
           (options.stop_at_tolerance && place.reached && reached(k));
  }
  void evaluate(const IkState&, IkKinematics&, RowPlace&);
  void linearise(bool curved = false);
  double measure_residual(double damping);
  double predicted_fall(double damping) const;
  EliminationStats solve_linear(double damping, IkReport&);
  EliminationStats solve_rows(double damping, IkReport&);
  double predicted_row_fall() const;
  void bend_step(double damping, IkReport&);
  void settle_rows(IkReport&);
  double merit(const IkKinematics& k, const RowPlace& place) const {
    return k.cost + 2.0 * penalty * place.excess;
  }
  void carry_multipliers();
  void descend(IkReport&, bool following = false);
  void remember();
  void measure_levers();
  bool brake();
  void extrapolate();
  IkReport solve_paper(std::span<const EffectorTarget>, std::span<DualQuaternion>);
  void restart(int attempt);
  void solve_with_restarts(IkReport&);
  void solve_levels(std::span<const EffectorTarget>, IkReport&);

  Rig rig;
  IkOptions options;
  IkTree tree;
  TreeElimination elimination;
  std::vector<IkGoal> goals;
  std::vector<EllipseLimit> ellipses;
  IkState now, next, best, wound;
  IkState last, before;  ///< answers to the calls before
  int answers = 0;       ///< how many of them there are
  Eigen::VectorXd lever, free_min, free_max;
  std::vector<Eigen::Vector3d> aimed, aimed_before;  ///< [effector] goals of the calls before
  std::vector<char> braking;                         ///< [coordinate] on its way after a jump
  double settled_damping = 0.0;
  std::vector<DualQuaternion> outside;  ///< [joint] where that is no node: as last given
  IkKinematics at_now, at_next;
  EffectorLoad load;
  IkRows rows;
  RowPlace rows_now, rows_next;
  RowSolver row_solver;
  SpeedLimits speed;
  double penalty = 0.0;
  Eigen::VectorXd step, wish, anchor, start, gradient, diagonal, end;
  std::optional<PaperIk> paper;  ///< pgs_paper: all of it
};

bool IkSolver::State::reached(const IkKinematics& k) const {
  for (std::size_t e = 0; e < goals.size(); ++e) {
    if (!tree.effectors[e].strong) continue;
    if (goals[e].mass > 0.0 && k.error[e].position.norm() > options.stop_position_m) return false;
    if (goals[e].inertia > 0.0 && k.error[e].rotation.norm() > options.stop_orientation_rad) {
      return false;
    }
  }
  return true;
}

void IkSolver::State::evaluate(const IkState& state, IkKinematics& k, RowPlace& place) {
  tree.evaluate(state, goals, k);
  if (rows.none()) return;
  rows.build(state, k, place);
  k.cost += place.cost;
}

void IkSolver::State::linearise(bool curved) {
  tree.linearise(now, at_now);
  if (!rows.none()) rows.anchor(at_now, rows_now);
  effector_load(tree, goals, at_now, load, curved);
}

/// Of the last linear problem, at its step: gradient (H + damping D) step - J'We, by node twists
/// and composite inertias, with nothing of the elimination in it. Spoils `load`.
double IkSolver::State::measure_residual(double damping) {
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
double IkSolver::State::predicted_fall(double damping) const {
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
double IkSolver::State::predicted_row_fall() const {
  double fall = 0.0;
  for (const Row& row : rows_now.rows) {
    const double before = row.value, after = before + row.rate(elimination.node_twist(), step);
    fall += row.hard() ? 2.0 * penalty * (row.excess(before) - row.excess(after))
                       : (before * before - after * after) / row.compliance;
  }
  return fall;
}

/// rows_next become rows_now; those that were there already start from the multipliers they had.
void IkSolver::State::carry_multipliers() {
  auto old = rows_now.rows.begin();
  for (Row& row : rows_next.rows) {
    while (old != rows_now.rows.end() && old->id < row.id) ++old;
    const bool same = old != rows_now.rows.end() && old->id == row.id;
    if (same && old->hard() == row.hard()) row.lambda = old->lambda;
  }
  std::swap(rows_now, rows_next);
}

EliminationStats IkSolver::State::solve_rows(double damping, IkReport& report) {
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
void IkSolver::State::bend_step(double damping, IkReport& report) {
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
void IkSolver::State::settle_rows(IkReport& report) {
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
EliminationStats IkSolver::State::solve_linear(double damping, IkReport& report) {
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

void IkSolver::State::descend(IkReport& report, bool following) {
  evaluate(now, at_now, rows_next);
  carry_multipliers();
  penalty = 0.0;
  if (tree.nodes.empty()) return;
  report.converged = !following && done(at_now, rows_now);
  if (report.converged) return;
  if (!following) elimination.reset(now.x);
  elimination.settle_slides_within(following ? kSlide : 0.0);
  // Rows bend, which the model leaves out: undamped, it would wander where the cost is flat.
  const double least = rows.none() ? kLeastDamping : options.damping;
  double damping = following ? settled_damping : options.damping, growth = 2.0;
  bool curved = false;
  while (!report.converged && report.relinearisations < options.max_relinearisations) {
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
      const double predicted = predicted_fall(damping);
      if (rows_next.worst > 1.0) bend_step(damping, report);
      const double fall = merit(at_now, rows_now) - merit(at_next, rows_next);
      const bool negligible = step.cwiseAbs().maxCoeff() < options.stop_step;
      fell = fall >= 0.0 || (following && done(at_next, rows_next));
      if (fell) {
        const double agreement = predicted > 0.0 ? fall / predicted : 1.0;
        const double cube = std::pow(2.0 * agreement - 1.0, 3);
        damping = std::max(least, damping * std::max(kShrink, 1.0 - cube));
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
    carry_multipliers();
    std::swap(now, next);
    std::swap(at_now, at_next);
  }
  settled_damping = std::min(damping, options.damping);
  settle_rows(report);
}

/// [coordinate] How far its joint is from the farthest effector outside of it, at rest. 0 where it
/// has no range of its own.
void IkSolver::State::measure_levers() {
  lever = free_min = free_max = 0.0 * step;
  aimed.assign(goals.size(), Eigen::Vector3d::Zero());
  aimed_before = aimed;
  braking.assign(static_cast<std::size_t>(step.size()), 0);
  tree.evaluate(last, goals, at_now);
  for (std::size_t e = 0; e < tree.effectors.size(); ++e) {
    for (std::int32_t n = tree.effectors[e].node; n >= 0; n = tree.nodes[n].parent) {
      const double reach = (at_now.error[e].point - at_now.position[n]).norm();
      for (std::int32_t i = 0; i < tree.nodes[n].coordinates; ++i) {
        const std::int32_t k = tree.nodes[n].coordinate + i;
        if (std::isfinite(tree.min[k])) lever[k] = std::max(lever[k], reach);
      }
    }
  }
}

/// Holds the coordinates that `now` lets jump where they may be by this frame; true: there are
/// some. `now` goes back to the frame's start.
bool IkSolver::State::brake() {
  // The targets' own second difference is no jump.
  double pace = 0.0;
  for (std::size_t e = 0; e < goals.size() && answers > 1; ++e) {
    if (goals[e].mass <= 0.0) continue;
    pace = std::max(pace, (goals[e].position - 2.0 * aimed[e] + aimed_before[e]).norm());
  }
  bool some = false;
  free_min = tree.min;
  free_max = tree.max;
  for (Eigen::Index k = 0; k < lever.size(); ++k) {
    const double stray = lever[k] * std::abs(now.x[k] - start[k]);
    braking[k] = stray > (braking[k] ? kMostStray + pace : kJump + kHaste * pace);
    if (!braking[k]) continue;
    const double most = (kMostStray + pace) / lever[k], ahead = now.x[k] - last.x[k];
    const double speed =
        answers > 1 ? std::max((last.x[k] - before.x[k]) * (ahead < 0 ? -1 : 1), 0.0) : 0.0;
    const double way =
        std::min({std::abs(ahead), std::sqrt(2.0 * most * std::abs(ahead)), speed + most});
    tree.min[k] = tree.max[k] = last.x[k] + std::copysign(way, ahead);
    some = true;
  }
  if (!some) return false;
  extrapolate();
  elimination.reset(now.x);
  return true;
}

/// The answer `now` becomes the last one.
void IkSolver::State::remember() {
  std::swap(before, last);
  last = now;
  std::swap(aimed, aimed_before);
  for (std::size_t e = 0; e < goals.size(); ++e) aimed[e] = goals[e].position;
  ++answers;
}

IkReport IkSolver::State::solve_paper(std::span<const EffectorTarget> targets,
                                      std::span<DualQuaternion> pose) {
  const IkReport report = paper->solve(targets, pose);
  tree.load(pose, now);
  for (const std::int32_t joint : tree.outside) outside[joint] = pose[joint];
  remember();
  return report;
}

/// `now` becomes the start of the next frame, `anchor` where it may as well stay.
void IkSolver::State::extrapolate() {
  now = last;
  anchor = last.x + kEase * tree.limited.cwiseProduct(tree.middle - last.x);
  if (!options.extrapolate || answers < 2) return;
  now.x += last.x - before.x;
  anchor += kCalm * (last.x - before.x);
  for (std::size_t n = 0; n < tree.nodes.size(); ++n) {
    const IkNode& node = tree.nodes[n];
    if (node.chart || (node.type != JointType::ball && node.type != JointType::free)) continue;
    now.rotation[n] =
        (last.rotation[n] * before.rotation[n].conjugate() * last.rotation[n]).normalized();
  }
  tree.project(now.x);
}

/// Another start: coordinates with a range drawn from a fixed sequence, the others kept.
void IkSolver::State::restart(int attempt) {
  std::uint64_t seed = 0x9e3779b97f4a7c15ULL * static_cast<std::uint64_t>(attempt + 1);
  const auto uniform = [&seed] {  // splitmix64
    seed += 0x9e3779b97f4a7c15ULL;
    std::uint64_t z = seed;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    return static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1p-53;
  };
  for (Eigen::Index k = 0; k < now.x.size(); ++k) {
    if (std::isfinite(tree.min[k]))
      now.x[k] = tree.min[k] + uniform() * (tree.max[k] - tree.min[k]);
  }
  for (const EllipseLimit& e : ellipses) {
    now.x[e.coordinate] = e.swing.min0 + uniform() * (e.swing.max0 - e.swing.min0);
    now.x[e.coordinate + 1] = e.swing.min1 + uniform() * (e.swing.max1 - e.swing.min1);
  }
  tree.project(now.x);
}

void IkSolver::State::solve_with_restarts(IkReport& report) {
  descend(report);
  const int unwinds = options.unwind && at_now.cost < kWoundCost ? kUnwinds : 0;
  const int attempts = unwinds + options.restarts;
  if (attempts == 0 || (reached(at_now) && rows_now.reached && rows_now.worst <= 1.0)) return;
  wound = best = now;
  double best_cost = at_now.cost;
  IkReport kept = report;
  for (int i = 0; i < attempts; ++i) {
    const bool unwinding = i < unwinds;
    if (unwinding) {
      const double part = static_cast<double>(i + 1) / kUnwinds;
      now.x = wound.x + part * tree.limited.cwiseProduct(tree.middle - wound.x);
      now.rotation = wound.rotation;
    } else {
      restart(i - unwinds);
    }
    IkReport tried;
    descend(tried);
    report.relinearisations += tried.relinearisations;
    report.tree_passes += tried.tree_passes;
    const bool there = reached(at_now) && rows_now.reached && rows_now.worst <= 1.0;
    if (there || (!unwinding && at_now.cost < best_cost)) {
      best = now;
      best_cost = at_now.cost;
      kept = tried;
    }
    if (there) break;
  }
  report.residual = kept.residual;
  report.converged = kept.converged;
  std::swap(now, best);
  evaluate(now, at_now, rows_now);
}

/// One level of priority after the other, each in the null space of those before.
void IkSolver::State::solve_levels(std::span<const EffectorTarget> targets, IkReport& report) {
  for (const std::int32_t level : rows.levels()) {
    rows.aim(targets, level, at_now, goals);
    IkReport one;
    solve_with_restarts(one);
    report.relinearisations += one.relinearisations;
    report.tree_passes += one.tree_passes;
    report.sweeps += one.sweeps;
    report.active_rows = one.active_rows;
    report.residual = std::max(report.residual, one.residual);
    report.converged = (level == rows.levels().front() || report.converged) && one.converged;
  }
  report.row_violation = 0.0;
  for (const Row& row : rows_now.rows) {
    if (row.hard()) report.row_violation = std::max(report.row_violation, row.violation(row.value));
  }
  rows.aim_at_all(targets, goals);
  evaluate(now, at_now, rows_next);  // rows_now keep their multipliers for the next frame
}

IkSolver::IkSolver(std::unique_ptr<State> state) : state_(std::move(state)) {}
IkSolver::IkSolver(IkSolver&&) noexcept = default;
IkSolver& IkSolver::operator=(IkSolver&&) noexcept = default;
IkSolver::~IkSolver() = default;

Result<IkSolver> IkSolver::create(const Rig& rig, const IkOptions& options) {
  if (Result<void> valid = validate(rig); !valid) return valid.error();
  if (!(options.damping > 0.0) || options.max_relinearisations < 1 || options.sweeps < 1 ||
      !(options.stop_step >= 0.0) || options.restarts < 0 || !(options.dt >= 0.0) ||
      !(options.relaxation > 0.0 && options.relaxation < 2.0)) {
    return Error{.code = "solver-options",
                 .message =
                     "damping must be positive; relinearisations and sweeps at least one; "
                     "relaxation between 0 and 2",
                 .hint = "leave the option out to get its default"};
  }
  const bool rowed = std::any_of(rig.effectors.begin(), rig.effectors.end(), [](const auto& e) {
    return e.relative_to != kNoJoint || e.priority != 0;
  });
  if (options.method == IkMethod::pgs_paper &&
      (rowed || !rig.couplings.empty() || options.collision || options.dt > 0.0)) {
    return Error{.code = "solver-options",
                 .message =
                     "pgs-paper has no rows that join branches: no relative effectors, "
                     "priorities, couplings, collision or speeds",
                 .hint = "use pgs for this rig"};
  }
  return IkSolver(std::make_unique<State>(rig, options));
}

void IkSolver::forget() { state_->rows_now.rows.clear(); }

IkReport IkSolver::solve(std::span<const EffectorTarget> targets, std::span<DualQuaternion> pose) {
  return solve(targets, pose, pose);
}

IkReport IkSolver::solve(std::span<const EffectorTarget> targets, std::span<DualQuaternion> pose,
                         std::span<const DualQuaternion> previous) {
  State& s = *state_;
  s.answers = 0;
  if (s.paper) return s.solve_paper(targets, pose);
  IkReport report;
  s.tree.resolve(targets, s.goals);
  if (s.speed.any()) {
    s.tree.load(previous, s.next);
    s.rows.set_previous(s.next);
  }
  s.tree.load(pose, s.now);
  s.settled_damping = s.options.damping;
  std::fill(s.braking.begin(), s.braking.end(), 0);
  s.speed.narrow(s.next, s.tree, s.now);
  if (s.rows.none()) {
    s.solve_with_restarts(report);
  } else {
    s.solve_levels(targets, report);
  }
  s.speed.widen(s.tree);
  s.remember();
  report.cost = s.at_now.cost;
  report.reached = s.rows_next.reached && s.reached(s.at_now);
  if (report.relinearisations == 0) {
    project_into_limits(s.rig, pose);  // what is inside stays bit for bit
  } else {
    for (const std::int32_t joint : s.tree.outside) project_joint(s.rig, joint, pose);
    s.tree.store(s.now, pose);
  }
  for (const std::int32_t joint : s.tree.outside) s.outside[joint] = pose[joint];
  return report;
}

IkReport IkSolver::follow(std::span<const EffectorTarget> targets, std::span<DualQuaternion> pose) {
  State& s = *state_;
  IkReport report;
  s.tree.resolve(targets, s.goals);
  s.extrapolate();
  if (s.paper) {
    for (const std::int32_t joint : s.tree.outside) pose[joint] = s.outside[joint];
    s.tree.store(s.now, pose);
    return s.solve_paper(targets, pose);
  }
  s.start = s.now.x;
  if (s.rows.none()) {
    s.descend(report, true);
    if (!s.reached(s.at_now) && s.brake()) {
      s.descend(report, true);
      s.tree.min = s.free_min;
      s.tree.max = s.free_max;
    }
  } else {
    if (s.speed.any()) s.rows.set_previous(s.last);
    s.speed.narrow(s.last, s.tree, s.now);
    s.solve_levels(targets, report);
    s.speed.widen(s.tree);
  }
  s.remember();
  report.strayed = s.tree.limited.cwiseProduct(s.now.x - s.start).cwiseAbs().maxCoeff();
  report.cost = s.at_now.cost;
  report.reached = s.rows_next.reached && s.reached(s.at_now);
  for (const std::int32_t joint : s.tree.outside) pose[joint] = s.outside[joint];
  s.tree.store(s.now, pose);
  return report;
}

void IkSolver::resume(std::span<const DualQuaternion> before,
                      std::span<const DualQuaternion> last) {
  State& s = *state_;
  s.tree.load(before, s.before);
  s.tree.load(last, s.last);
  s.answers = 2;
  s.elimination.reset(s.last.x);
  s.settled_damping = s.options.damping;
  for (const std::int32_t joint : s.tree.outside) s.outside[joint] = last[joint];
}

double effector_cost(const Rig& rig, std::span<const EffectorTarget> targets,
                     std::span<const DualQuaternion> pose) {
  Pose world(pose.size());
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    const std::int32_t parent = rig.joints[i].parent;
    world[i] = parent < 0 ? pose[i] : world[parent] * pose[i];
  }
  double cost = 0.0;
  for (std::size_t e = 0; e < rig.effectors.size(); ++e) {
    const IkEffector effector = make_effector(rig.effectors[e], -1, DualQuaternion::identity());
    EffectorTarget target = targets[e];
    const std::int32_t base = rig.effectors[e].relative_to;
    if (base != kNoJoint) target.pose = world[base] * target.pose;
    const IkGoal goal = make_goal(effector, target);
    const DualQuaternion& joint = world[rig.effectors[e].joint];
    IkError error;
    measure_error(effector, goal, joint.rotation(), joint.transform_point(effector.offset), error);
    cost += goal.mass * error.position.squaredNorm() + goal.inertia * error.rotation.squaredNorm();
  }
  return cost;
}

}  // namespace limber
