#include "pipeline/pose_solve.h"

#include <algorithm>
#include <cmath>

#include "solver/swing_twist.h"
#include "validation/ceres_refiner.h"

namespace limber {
namespace {

constexpr double kReachedM = 1e-3, kReachedRad = 0.5 * M_PI / 180.0;
constexpr int kRestarts = 24;  // other starts, as `limber bench` gives poses that stand alone
constexpr double kClearlyNearer = 0.9;  // of the cost; less is not worth an odd posture
constexpr int kMostIterations = 200;

/// The rig as one pose asks for it: effectors that are not named have weight 0, a position or an
/// orientation that is left free has none.
Rig rig_for(const Rig& rig, const PoseTargets& pose) {
  Rig out = rig;
  std::vector<RigEffector>& effectors = out.effectors;
  for (RigEffector& effector : effectors) effector.strong = false;
  for (const TargetRow& row : pose.rows) {
    RigEffector& effector = effectors[row.effector];
    effector.strong = rig.effectors[row.effector].strong && row.weight > 0.0;
    if (!row.position) effector.weight_pos = 0.0;
    if (!row.rotation) effector.weight_rot = 0.0;
  }
  const bool any_strong = std::any_of(effectors.begin(), effectors.end(),
                                      [](const RigEffector& e) { return e.strong; });
  for (const TargetRow& row : pose.rows) {  // hints alone: then they are what counts
    if (!any_strong) effectors[row.effector].strong = row.weight > 0.0;
  }
  return out;
}

std::vector<EffectorTarget> targets_for(const Rig& rig, const PoseTargets& pose) {
  std::vector<EffectorTarget> targets(rig.effectors.size());
  for (EffectorTarget& target : targets) target.weight = 0.0;
  for (const TargetRow& row : pose.rows) {
    targets[row.effector] = {.pose = DualQuaternion::from_rotation_translation(
                                 row.rotation.value_or(Eigen::Quaterniond::Identity()),
                                 row.position.value_or(Eigen::Vector3d::Zero())),
                             .weight = row.weight};
  }
  return targets;
}

double angle_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

EffectorOutcome measure(const RigEffector& effector, const TargetRow& row,
                        const DualQuaternion& world_from_joint) {
  EffectorOutcome out;
  out.asked = row;
  out.reached = DualQuaternion::from_rotation_translation(
      world_from_joint.rotation(), world_from_joint.transform_point(effector.offset));
  const Eigen::Vector3d axis = out.reached.rotation() * effector.axis;
  if (row.rotation) {
    const bool by_axis =
        effector.kind == EffectorKind::direction || effector.kind == EffectorKind::line;
    out.angle_error_rad = by_axis ? angle_between(axis, *row.rotation * effector.axis)
                                  : rotation_angle(out.reached.rotation(), *row.rotation);
  }
  if (row.position) {
    Eigen::Vector3d miss = *row.position - out.reached.translation();
    if (effector.kind == EffectorKind::line) {
      const Eigen::Vector3d along = *row.rotation * effector.axis;
      miss -= along * along.dot(miss);
    }
    out.position_error_m = miss.norm();
  }
  return out;
}

std::vector<EffectorOutcome> measure(const Rig& rig, const PoseTargets& pose,
                                     std::span<const DualQuaternion> parent_from_joint) {
  std::vector<DualQuaternion> world(parent_from_joint.size());
  model_from_local(skeleton_of(rig), parent_from_joint, world);
  std::vector<EffectorOutcome> out;
  for (const TargetRow& row : pose.rows) {
    const RigEffector& effector = rig.effectors[row.effector];
    out.push_back(measure(effector, row, world[effector.joint]));
  }
  return out;
}

class PoseSolver {
 public:
  PoseSolver(const Rig& rig, const PoseTargets& asked, SolverChoice solver)
      : rig_(rig_for(rig, asked)),
        asked_(asked),
        solver_(solver),
        targets_(targets_for(rig, asked)) {}

  Result<PoseOutcome> run(std::span<const DualQuaternion> start);

 private:
  Result<IkReport> solve(int restarts, std::vector<DualQuaternion>& pose) const;
  Result<IkReport> descend(IkMethod, int restarts, std::vector<DualQuaternion>& pose) const;
  Result<void> approach(std::vector<DualQuaternion>& pose) const;
  Result<void> search(std::span<const DualQuaternion> start);
  Result<void> judge();

  Rig rig_;
  const PoseTargets& asked_;
  SolverChoice solver_;
  std::vector<EffectorTarget> targets_;
  PoseOutcome out_;
};

Result<IkReport> PoseSolver::solve(int restarts, std::vector<DualQuaternion>& pose) const {
  if (solver_ == SolverChoice::ceres) {
    const auto refined =
        refine_with_ceres(rig_, targets_, pose, {.max_iterations = kMostIterations});
    if (!refined) return refined.error();
    return IkReport{.relinearisations = refined->iterations,
                    .cost = refined->cost_after,
                    .converged = refined->iterations < kMostIterations};
  }
  return descend(solver_ == SolverChoice::pgs ? IkMethod::pgs : IkMethod::pgs_paper, restarts,
                 pose);
}

Result<IkReport> PoseSolver::descend(IkMethod method, int restarts,
                                     std::vector<DualQuaternion>& pose) const {
  IkOptions options;
  options.method = method;
  options.max_relinearisations = kMostIterations;
  options.restarts = restarts;
  if (options.method == IkMethod::pgs) {  // quadratic convergence: a tenth is nearly free
    options.stop_position_m *= 0.1;
    options.stop_orientation_rad *= 0.1;
  }
  options.stop_at_tolerance =  // weak effectors want their say too
      std::all_of(asked_.rows.begin(), asked_.rows.end(), [&](const TargetRow& row) {
        return row.weight == 0.0 || rig_.effectors[row.effector].strong;
      });
  auto solver = IkSolver::create(rig_, options);
  if (!solver) return solver.error();
  return solver->solve(targets_, pose);
}

Result<void> PoseSolver::search(std::span<const DualQuaternion> start) {
  out_.parent_from_joint.assign(start.begin(), start.end());
  project_into_limits(rig_, out_.parent_from_joint);
  std::vector<DualQuaternion> again = out_.parent_from_joint;
  auto report = solve(0, out_.parent_from_joint);
  if (!report) return report.error();
  out_.solver = *report;
  const bool alone = asked_.start == PoseStart::rest && solver_ == SolverChoice::pgs;
  if (!alone || report->reached) return {};
  report = solve(kRestarts, again);
  if (!report) return report.error();
  const bool nearer = report->cost < kClearlyNearer * out_.solver.cost;
  out_.searched = report->relinearisations - out_.solver.relinearisations;
  if (!report->reached && !nearer) return {};
  const int first = out_.solver.relinearisations;
  out_.solver = *report;
  out_.solver.relinearisations = first;
  out_.parent_from_joint = std::move(again);
  return {};
}

/// Where Ceres starts to say what can be reached: the answer, but no corner that a solver was
/// caught in, for Ceres has no other starts of its own.
Result<void> PoseSolver::approach(std::vector<DualQuaternion>& pose) const {
  if (out_.reached || out_.searched > 0) return {};
  std::vector<DualQuaternion> other = pose;
  const auto report = descend(IkMethod::pgs, kRestarts, other);
  if (!report) return report.error();
  if (report->reached || report->cost < kClearlyNearer * out_.solver.cost) pose = std::move(other);
  return {};
}

Result<void> PoseSolver::judge() {
  out_.effectors = measure(rig_, asked_, out_.parent_from_joint);
  out_.reached = true;
  for (const EffectorOutcome& e : out_.effectors) {
    if (!rig_.effectors[e.asked.effector].strong) continue;
    out_.reached =
        out_.reached && e.position_error_m < kReachedM && e.angle_error_rad < kReachedRad;
  }
  std::vector<DualQuaternion> refined = out_.parent_from_joint;
  if (Result<void> near = approach(refined); !near) return near;
  const auto ceres = refine_with_ceres(rig_, targets_, refined, {.max_iterations = 50});
  if (!ceres) return ceres.error();
  out_.refined_cost = ceres->cost_after;
  const std::vector<EffectorOutcome> nearest = measure(rig_, asked_, refined);
  for (std::size_t i = 0; i < nearest.size(); ++i) {
    const EffectorOutcome& e = nearest[i];
    out_.effectors[i].reachable =
        e.asked.position ? e.position_error_m < kReachedM : e.angle_error_rad < kReachedRad;
  }
  Clip clip;
  clip.joints = rig_.size();
  clip.parent_from_joint = out_.parent_from_joint;
  out_.limits = check_joint_limits(rig_, clip);
  out_.contacts = limit_contacts(rig_, out_.parent_from_joint);
  out_.failed = out_.limits.violations > 0 || !std::isfinite(out_.solver.cost);
  return {};
}

Result<PoseOutcome> PoseSolver::run(std::span<const DualQuaternion> start) {
  out_.name = asked_.name;
  if (Result<void> found = search(start); !found) return found.error();
  if (Result<void> judged = judge(); !judged) return judged.error();
  return std::move(out_);
}

}  // namespace

const EffectorOutcome* PoseOutcome::worst() const {
  const auto less = [](const EffectorOutcome& a, const EffectorOutcome& b) {
    // 0.1 m/rad, as the solver's objective weighs them.
    return std::hypot(a.position_error_m, 0.1 * a.angle_error_rad) <
           std::hypot(b.position_error_m, 0.1 * b.angle_error_rad);
  };
  const auto found = std::max_element(effectors.begin(), effectors.end(), less);
  return found == effectors.end() ? nullptr : &*found;
}

Result<std::vector<PoseOutcome>> solve_poses(const Rig& rig, const TargetsFile& file,
                                             SolverChoice solver) {
  const std::vector<DualQuaternion> rest = skeleton_of(rig).rest_parent_from_joint;
  std::vector<PoseOutcome> outcomes;
  for (const PoseTargets& asked : file.poses) {
    const bool on = asked.start == PoseStart::previous && !outcomes.empty();
    auto outcome =
        PoseSolver(rig, asked, solver).run(on ? outcomes.back().parent_from_joint : rest);
    if (!outcome) return outcome.error();
    outcomes.push_back(std::move(*outcome));
  }
  return outcomes;
}

}  // namespace limber
