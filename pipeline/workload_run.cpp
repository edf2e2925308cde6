#include "pipeline/workload_run.h"

#include <algorithm>
#include <chrono>

#include "solver/ik_clip.h"
#include "solver/lane_solver.h"
#include "validation/ceres_refiner.h"

namespace limber {

namespace {

using Clock = std::chrono::steady_clock;
double microseconds(Clock::duration d) {
  return std::chrono::duration<double, std::micro>(d).count();
}

class Runner {
 public:
  Runner(const Workload& work, const IkOptions& options, std::size_t frames)
      : work_(work), options_(options), pose_(work.rig.joints.size()) {
    run_.clip.joints = work.rig.size();
    run_.clip.parent_from_joint.resize(frames * work.rig.joints.size());
    run_.us.assign(frames, 0.0);
    run_.iterations.assign(frames, 0);
  }

  Result<void> lone_poses();
  Result<void> motion(std::size_t first, std::size_t last);
  Result<void> cycle();
  /// Side by side: lane i solves the frames from cuts[i] to cuts[i + 1].
  Result<void> motions(std::span<const std::size_t> cuts);
  Result<void> with_ceres(std::size_t frame, bool fresh);
  WorkloadRun take() { return std::move(run_); }

 private:
  std::span<DualQuaternion> frame(std::size_t f) {
    return run_.clip.frame(static_cast<std::int64_t>(f));
  }
  std::vector<EffectorTarget> targets(std::size_t first, std::size_t last) const;
  void keep(std::size_t f, double us, int iterations) {
    run_.us[f] = us;
    run_.iterations[f] = iterations;
  }

  const Workload& work_;
  IkOptions options_;
  Pose pose_;
  WorkloadRun run_;
};

std::vector<EffectorTarget> Runner::targets(std::size_t first, std::size_t last) const {
  std::vector<EffectorTarget> all;
  for (std::size_t f = first; f < last; ++f) {
    all.insert(all.end(), work_.targets[f].begin(), work_.targets[f].end());
  }
  return all;
}

Result<void> Runner::lone_poses() {
  Result<IkSolver> solver = IkSolver::create(work_.rig, options_);
  if (!solver) return solver.error();
  const std::vector<double> rest(work_.truth_q.front().size(), 0.0);
  for (std::size_t f = 0; f < run_.us.size(); ++f) {
    pose_from_coordinates(work_.rig, rest, frame(f));
    const auto start = Clock::now();
    const IkReport report = solver->solve(work_.targets[f], frame(f));
    keep(f, microseconds(Clock::now() - start), report.relinearisations);
  }
  return {};
}

Result<void> Runner::motion(std::size_t first, std::size_t last) {
  Result<IkSolver> solver = IkSolver::create(work_.rig, options_);
  if (!solver) return solver.error();
  pose_from_coordinates(work_.rig, work_.truth_q[first], frame(first));
  const std::vector<EffectorTarget> goals = targets(first, last);
  const std::size_t joints = work_.rig.joints.size();
  IkClipSolver clip(
      *solver, work_.rig, goals,
      std::span(run_.clip.parent_from_joint).subspan(first * joints, (last - first) * joints));
  auto start = Clock::now();
  for (std::size_t f = first; f < last; ++f) {
    const IkReport report = clip.next();
    const auto end = Clock::now();
    keep(f, microseconds(end - start), report.relinearisations);
    start = end;
  }
  return {};
}

Result<void> Runner::cycle() {
  Result<IkSolver> solver = IkSolver::create(work_.rig, options_);
  if (!solver) return solver.error();
  const std::size_t frames = run_.us.size();
  pose_from_coordinates(work_.rig, work_.truth_q.front(), frame(0));
  const std::vector<EffectorTarget> goals = targets(0, frames);
  const auto start = Clock::now();
  const auto report = solve_cycle(*solver, work_.rig, goals, run_.clip.parent_from_joint);
  if (!report) return report.error();
  const double each = microseconds(Clock::now() - start) / static_cast<double>(frames);
  const auto count = static_cast<std::size_t>(report->relinearisations);
  for (std::size_t f = 0; f < frames; ++f) {
    keep(f, each, static_cast<int>((f + 1) * count / frames - f * count / frames));
  }
  run_.cycle = report.value();
  return {};
}

Result<void> Runner::motions(std::span<const std::size_t> cuts) {
  Result<LaneSolver> solver = LaneSolver::create(work_.rig, options_);
  if (!solver) return solver.error();
  const std::size_t effectors = work_.rig.effectors.size(), runs = cuts.size() - 1;
  std::vector<EffectorTarget> targets(LaneSolver::lanes * effectors);
  // Lanes without a run of their own, or at its end, stay on a last frame.
  const auto frame_of = [&](std::size_t lane, std::size_t step) {
    const std::size_t run = std::min(lane, runs - 1);
    return std::min(cuts[run] + step, cuts[run + 1] - 1);
  };
  std::size_t longest = 0;
  for (std::size_t lane = 0; lane < LaneSolver::lanes; ++lane) {
    pose_from_coordinates(work_.rig, work_.truth_q[frame_of(lane, 0)], pose_);
    solver->start(static_cast<int>(lane), pose_);
    if (lane < runs) longest = std::max(longest, cuts[lane + 1] - cuts[lane]);
  }
  for (std::size_t step = 0; step < longest; ++step) {
    const auto start = Clock::now();
    for (std::size_t lane = 0; lane < LaneSolver::lanes; ++lane) {
      std::ranges::copy(work_.targets[frame_of(lane, step)],
                        targets.begin() + static_cast<std::ptrdiff_t>(lane * effectors));
    }
    solver->follow(targets);
    for (std::size_t lane = 0; lane < runs; ++lane) {
      solver->pose(static_cast<int>(lane), frame(frame_of(lane, step)));
    }
    const double each = microseconds(Clock::now() - start) / static_cast<double>(runs);
    for (std::size_t lane = 0; lane < runs; ++lane) {
      const std::size_t f = frame_of(lane, step);
      if (cuts[lane] + step == f) {
        keep(f, each, solver->report(static_cast<int>(lane)).relinearisations);
      }
    }
  }
  return {};
}

/// `fresh`: from rest or truth instead of the frame before.
Result<void> Runner::with_ceres(std::size_t f, bool fresh) {
  const std::vector<double> rest(work_.truth_q.front().size(), 0.0);
  if (fresh) pose_from_coordinates(work_.rig, work_.rest_start ? rest : work_.truth_q[f], pose_);
  const auto start = Clock::now();
  const auto refined =
      refine_with_ceres(work_.rig, work_.targets[f], pose_, {.max_iterations = 100});
  if (!refined) return refined.error();
  std::ranges::copy(pose_, frame(f).begin());
  keep(f, microseconds(Clock::now() - start), refined->iterations);
  return {};
}

}  // namespace

Result<WorkloadRun> run_workload_with_ceres(const Workload& work, std::size_t frames,
                                            std::size_t lanes) {
  Runner runner(work, {}, frames);
  for (std::size_t f = 0; f < frames; ++f) {
    const bool cut = (f * lanes) % frames < lanes;  // a run's first frame
    if (auto ran = runner.with_ceres(f, work.rest_start || cut); !ran) return ran.error();
  }
  return runner.take();
}

Result<WorkloadRun> run_workload_cycle(const Workload& work, const IkOptions& options) {
  Runner runner(work, options, work.frames());
  if (auto ran = runner.cycle(); !ran) return ran.error();
  return runner.take();
}

Result<WorkloadRun> run_workload(const Workload& work, const IkOptions& options, std::size_t frames,
                                 std::size_t lanes) {
  Runner runner(work, options, frames);
  if (work.rest_start) {
    if (auto ran = runner.lone_poses(); !ran) return ran.error();
    return runner.take();
  }
  lanes = std::min(lanes, frames);
  std::vector<std::size_t> cuts;
  for (std::size_t lane = 0; lane <= lanes; ++lane) cuts.push_back(lane * frames / lanes);
  const bool side_by_side = lanes > 1 && options.method == IkMethod::pgs;
  for (std::size_t lane = 0; lane < lanes;) {
    const std::size_t count =
        side_by_side ? std::min<std::size_t>(LaneSolver::lanes, lanes - lane) : 1;
    const auto ran = side_by_side ? runner.motions(std::span(cuts).subspan(lane, count + 1))
                                  : runner.motion(cuts[lane], cuts[lane + 1]);
    if (!ran) return ran.error();
    lane += count;
  }
  return runner.take();
}

}  // namespace limber
