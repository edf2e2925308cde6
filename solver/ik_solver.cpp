// What surrounds the outer loop (ik_descent.cpp): clips, other starts, levels of priority.
//
// A clip is followed: the start of a frame is extrapolated from the two answers before, the limits
// that were active stay so until their multipliers say otherwise, and damping goes on where it
// stood. So near the answer one relinearisation is enough, and one is always made, however near the
// start is: a pose that is merely good enough would jitter against its neighbours. What the targets
// leave open is pulled to an anchor: the last answer, kCalm of its speed, and kHome of the way to
// the middle of its range. Per frame that is x'' = -(1 - kCalm) x' - kHome (x - middle), a spring
// with friction, critically damped by kHome = (1 - kCalm)^2 / 4: it goes home as fast as it can
// without swinging. Away from limits there are more ways on; a swivel left to itself ends in a
// corner of them. Where the targets ask for as much as there is, little is open and they say where
// it should be: there the anchor only drifts home.
//
// Out of reach, what is shown may be slower than the answers: brake.cpp.
//
// pgs_paper is paper_ik.cpp.
#include "solver/ik_solver.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "solver/brake.h"
#include "solver/ik_descent.h"
#include "solver/paper_ik.h"
#include "solver/speed_limits.h"
#include "solver/strewn_numbers.h"

namespace limber {

namespace {

constexpr int kUnwinds = 3;        // a third, two thirds, all of the way to the middle
constexpr double kResumed = 1e-3;  // of the damping: an answer was there already
// Calm and home of the anchor: where targets ask for less than there are coordinates, and else.
constexpr double kCalm = 0.7, kHome = 0.25 * (1.0 - kCalm) * (1.0 - kCalm);
constexpr double kHeldCalm = 0.9, kHeldHome = 5e-4;

/// Whether the targets are fewer numbers than the coordinates they ask for.
bool leave_much_open(const IkTree& tree) {
  int asked = 0;
  for (const IkEffector& effector : tree.effectors) {
    if (effector.weight_pos > 0.0) asked += effector.kind == EffectorKind::line ? 2 : 3;
    if (effector.weight_rot > 0.0) asked += has_axis(effector.kind) ? 2 : 3;
  }
  return asked < tree.coordinate_count();
}

}  // namespace

struct IkSolver::State : IkDescent {
  State(const Rig& source, const IkOptions& chosen)
      : IkDescent(source, chosen),
        best(now),
        wound(now),
        last(now),
        before(now),
        speed(source, tree, chosen.dt),
        places_last(tree.nodes.size() + tree.effectors.size()),
        places_before(places_last),
        open(leave_much_open(tree)),
        outside(skeleton_of(source).rest_parent_from_joint) {
    tree.load(outside, last);
    tree.evaluate(last, goals, at_now);
    brake.emplace(*this);
    if (options.method == IkMethod::pgs_paper) paper.emplace(source, chosen);
  }

  void remember();
  void follow_freely(IkReport&);
  void extrapolate();
  double measure_bend();
  IkReport solve_paper(std::span<const EffectorTarget>, std::span<DualQuaternion>);
  void restart(int attempt);
  void solve_with_restarts(IkReport&);
  void solve_levels(std::span<const EffectorTarget>, IkReport&);
  void answer(std::span<const EffectorTarget>, const IkState& previous, bool following, IkReport&);

  IkState best, wound;
  IkState last, before;  ///< answers to the calls before
  int answers = 0;       ///< how many of them there are
  SpeedLimits speed;
  std::vector<Eigen::Vector3d> places_last, places_before;  ///< nodes, then effectors
  int places = 0;                                           ///< answers that those tell of
  bool open;                                                ///< the targets leave much open
  bool placed = false;  ///< the last answer was put there: it has no speed and stays
  std::optional<Brake> brake;
  std::vector<DualQuaternion> outside;  ///< [joint] where that is no node: as last given
  std::optional<PaperIk> paper;         ///< pgs_paper: all of it
};

/// A frame of a clip without rows.
void IkSolver::State::follow_freely(IkReport& report) {
  if (!brake->on()) {
    descend(report, true);
    if (answers < 2 || !brake->too_fast(before, last)) return;
    extrapolate();
  }
  brake->slow_down(before, last, report);
}

/// The largest second difference (m) that the answer makes with those before.
double IkSolver::State::measure_bend() {
  double most = 0.0;
  const auto measure = [&](std::size_t i, const Eigen::Vector3d& place) {
    const Eigen::Vector3d bend = place - 2.0 * places_last[i] + places_before[i];
    most = std::max(most, bend.squaredNorm());
    places_before[i] = place;
  };
  const std::size_t nodes = tree.nodes.size();
  for (std::size_t n = 0; n < nodes; ++n) measure(n, at_now.position[n]);
  for (std::size_t e = 0; e < goals.size(); ++e) measure(nodes + e, at_now.error[e].point);
  std::swap(places_last, places_before);
  return places++ < 2 ? 0.0 : std::sqrt(most);
}

/// The answer `now` becomes the last one.
void IkSolver::State::remember() {
  std::swap(before, last);
  last = now;
  placed = false;
  brake->remember(goals);
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
  anchor = last.x;
  if (!placed)
    anchor += (open ? kHome : kHeldHome) * tree.limited.cwiseProduct(tree.middle - last.x);
  if (!options.extrapolate || answers < 2) return;
  now.x += last.x - before.x;
  anchor += (open ? kCalm : kHeldCalm) * (last.x - before.x);
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
  StrewnNumbers uniform(static_cast<std::uint64_t>(attempt + 1));
  for (Eigen::Index k = 0; k < now.x.size(); ++k) {
    if (std::isfinite(tree.min[k]))
      now.x[k] = tree.min[k] + uniform.next() * (tree.max[k] - tree.min[k]);
  }
  for (const EllipseLimit& e : ellipses) {
    now.x[e.coordinate] = e.swing.min0 + uniform.next() * (e.swing.max0 - e.swing.min0);
    now.x[e.coordinate + 1] = e.swing.min1 + uniform.next() * (e.swing.max1 - e.swing.min1);
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

/// From `now` to the answer, and what the report says of it. `previous`: where speeds count from.
void IkSolver::State::answer(std::span<const EffectorTarget> targets, const IkState& previous,
                             bool following, IkReport& report) {
  if (speed.any()) {
    rows.set_previous(previous);
    speed.narrow(previous, tree, now);
  }
  if (!rows.none()) {
    solve_levels(targets, report);
  } else if (following) {
    follow_freely(report);
  } else {
    solve_with_restarts(report);
  }
  speed.widen(tree);
  remember();
  report.cost = at_now.cost;
  report.reached = rows_next.reached && reached(at_now);
}

IkSolver::IkSolver(std::unique_ptr<State> state) : state_(std::move(state)) {}
IkSolver::IkSolver(IkSolver&&) noexcept = default;
IkSolver& IkSolver::operator=(IkSolver&&) noexcept = default;
IkSolver::~IkSolver() = default;

Result<IkSolver> IkSolver::create(const Rig& rig, const IkOptions& options) {
  if (Result<void> valid = validate(rig); !valid) return valid.error();
  if (!(options.damping > 0.0) || options.max_relinearisations < 1 || options.sweeps < 1 ||
      !(options.stop_step >= 0.0) || options.restarts < 0 || options.separations < 0 ||
      !(options.dt >= 0.0) || !(options.relaxation > 0.0 && options.relaxation < 2.0)) {
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
      (rowed || !rig.couplings.empty() || options.collision || options.separations > 0 ||
       options.dt > 0.0)) {
    return Error{.code = "solver-options",
                 .message =
                     "pgs-paper has no rows that join branches: no relative effectors, "
                     "priorities, couplings, collision, separations or speeds",
                 .hint = "use pgs for this rig"};
  }
  return IkSolver(std::make_unique<State>(rig, options));
}

void IkSolver::keep_apart(std::span<const Separation> apart) { state_->rows.keep_apart(apart); }

void IkSolver::forget() { state_->rows_now.rows.clear(); }

IkReport IkSolver::solve(std::span<const EffectorTarget> targets, std::span<DualQuaternion> pose) {
  return solve(targets, pose, pose);
}

IkReport IkSolver::solve(std::span<const EffectorTarget> targets, std::span<DualQuaternion> pose,
                         std::span<const DualQuaternion> previous) {
  State& s = *state_;
  s.answers = s.places = 0;
  if (s.paper) return s.solve_paper(targets, pose);
  IkReport report;
  s.tree.resolve(targets, s.goals);
  if (s.speed.any()) s.tree.load(previous, s.next);
  s.tree.load(pose, s.now);
  s.settled_damping = s.options.damping;
  s.brake->forget();
  s.answer(targets, s.next, false, report);
  if (report.relinearisations == 0) {
    project_into_limits(s.rig, pose);  // what is inside stays bit for bit
  } else {
    for (const std::int32_t joint : s.tree.outside) project_joint(s.rig, joint, pose);
    s.tree.store(s.now, s.at_now, pose);
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
  const double pace = s.brake->pace();
  s.answer(targets, s.last, true, report);
  report.bend = std::max(0.0, s.measure_bend() - pace);
  for (const std::int32_t joint : s.tree.outside) pose[joint] = s.outside[joint];
  s.tree.store(s.now, s.at_now, pose);
  return report;
}

void IkSolver::resume(std::span<const DualQuaternion> before,
                      std::span<const DualQuaternion> last) {
  State& s = *state_;
  s.tree.load(before, s.before);
  s.tree.load(last, s.last);
  s.answers = 2;
  s.places = 0;
  s.placed = before.data() == last.data();
  s.brake->forget(s.placed);
  s.elimination.reset(s.last.x);
  s.settled_damping = (s.placed ? 1.0 : kResumed) * s.options.damping;
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
