#include "pipeline/bench_command.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

#include "assets/model/rig.h"
#include "pipeline/workload.h"
#include "pipeline/workload_run.h"
#include "solver/ik_solver.h"
#include "validation/contact_detection.h"
#include "validation/limit_check.h"

namespace limber {

namespace {

struct FrameResult : EffectorMiss {
  double us = 0.0;
  int iterations = 0;
};

nlohmann::ordered_json step_json(const PoseStep& step) {
  constexpr double kDeg = 180.0 / M_PI;
  return {{"position_mm", 1e3 * step.way_m},
          {"angle_deg", kDeg * step.turn_rad},
          {"velocity_jump_mm", 1e3 * step.way_change_m},
          {"velocity_jump_deg", kDeg * step.turn_change_rad}};
}

/// The seam of a cycle beside the largest step elsewhere; velocities are per frame.
nlohmann::ordered_json cycle_json(const CycleReport& cycle) {
  return {{"period", cycle.period},
          {"last_frame_repeats_first", cycle.closing == Closing::repeats},
          {"laps", cycle.laps},
          {"closed", cycle.closed},
          {"led_over", cycle.led_over},
          {"laps_apart_deg", cycle.apart_rad * 180.0 / M_PI},
          {"seam", step_json(cycle.steps.seam)},
          {"elsewhere", step_json(cycle.steps.elsewhere)}};
}

class Bench {
 public:
  Bench(const BenchArgs& args, Workload work) : args_(args), work_(std::move(work)) {}

  Result<void> run();
  nlohmann::ordered_json summary() const;
  Result<void> write_solutions() const;

 private:
  void measure(const WorkloadRun&);

  const BenchArgs& args_;
  Workload work_;
  std::vector<FrameResult> results_;
  std::optional<CycleReport> cycle_;
  std::vector<double> fk_us_;
  Clip clip_;
};

void Bench::measure(const WorkloadRun& run) {
  using Clock = std::chrono::steady_clock;
  const Skeleton skeleton = skeleton_of(work_.rig);
  Pose world(work_.rig.joints.size());
  for (std::size_t f = 0; f < work_.frames(); ++f) {
    const auto start = Clock::now();
    model_from_local(skeleton, run.clip.frame(static_cast<std::int64_t>(f)), world);
    fk_us_.push_back(std::chrono::duration<double, std::micro>(Clock::now() - start).count());
    results_.push_back(
        {worst_miss(work_.rig, work_.targets[f], world), run.us[f], run.iterations[f]});
  }
}

Result<void> Bench::run() {
  Rig& rig = work_.rig;
  if (args_.pos) {
    for (RigEffector& effector : rig.effectors) effector.weight_rot = 0.0;
  }
  IkOptions options =
      options_for(work_, args_.solver == "pgs-paper" ? IkMethod::pgs_paper : IkMethod::pgs);
  if (args_.stop_mm > 0.0) options.stop_position_m = 1e-3 * args_.stop_mm;
  if (args_.stop_deg > 0.0) options.stop_orientation_rad = args_.stop_deg * M_PI / 180.0;
  if (args_.sweeps > 0) options.sweeps = args_.sweeps;
  options.extrapolate = args_.start == "extrapolate";
  const auto lanes = static_cast<std::size_t>(args_.lanes);
  Result<WorkloadRun> run = args_.cycle ? run_workload_cycle(work_, options)
                            : args_.solver == "ceres"
                                ? run_workload_with_ceres(work_, work_.frames(), lanes)
                                : run_workload(work_, options, work_.frames(), lanes);
  if (!run) return run.error();
  measure(run.value());
  cycle_ = run->cycle;
  clip_ = std::move(run->clip);
  return {};
}

nlohmann::ordered_json Bench::summary() const {
  std::vector<double> us, mm, deg, iterations;
  std::size_t solved = 0;
  const LimitReport limits = check_joint_limits(work_.rig, clip_);
  const bool within = limits.max_violation_deg < 0.5;
  for (const FrameResult& frame : results_) {
    us.push_back(frame.us);
    iterations.push_back(frame.iterations);
    mm.push_back(frame.position_mm);
    deg.push_back(frame.orientation_deg);
    solved += within && frame.position_mm < 1e3 * work_.success_pos &&
              frame.orientation_deg < work_.success_rot * 180.0 / M_PI;
  }
  const auto spread = [](const std::vector<double>& values) {
    return nlohmann::ordered_json{{"median", percentile(values, 50.0)},
                                  {"p95", percentile(values, 95.0)},
                                  {"max", percentile(values, 100.0)}};
  };
  nlohmann::ordered_json summary = {
      {"workload", work_.name + (args_.pos ? " pos" : "")},
      {"solver", args_.solver},
      {"frames", work_.frames()},
      {"us", {{"median", percentile(us, 50.0)}, {"p99", percentile(us, 99.0)}}},
      {"fk_us", percentile(fk_us_, 50.0)},
      {"iterations",
       {{"median", percentile(iterations, 50.0)}, {"p99", percentile(iterations, 99.0)}}},
      {"position_error_mm", spread(mm)},
      {"orientation_error_deg", spread(deg)},
      {"limit_violations", limits.violations},
      {"success_rate", static_cast<double>(solved) / static_cast<double>(work_.frames())}};
  if (cycle_) summary["cycle"] = cycle_json(*cycle_);
  return summary;
}

Result<void> Bench::write_solutions() const {
  const auto ndof = static_cast<std::size_t>(dof_count(work_.rig));
  std::vector<double> row(ndof + 1);
  std::ofstream out(args_.solutions, std::ios::binary);
  for (std::size_t f = 0; f < work_.frames(); ++f) {
    coordinates_from_pose(work_.rig, clip_.frame(static_cast<std::int64_t>(f)),
                          std::span(row).first(ndof));
    row[ndof] = results_[f].us;
    // Little-endian hosts only, as everything we build for is.
    out.write(reinterpret_cast<const char*>(row.data()),
              static_cast<std::streamsize>(row.size() * sizeof(double)));
  }
  out.close();
  if (out) return {};
  return Error{.code = "bench-output",
               .message = "the solutions cannot be written",
               .file = args_.solutions.string(),
               .hint = "check that the folder exists and has room"};
}

int complain(Error error, const BenchArgs& args) {
  if (error.file.empty()) error.file = args.workload.string();
  fmt::print(stderr, "limber bench: {}: {}: {}\n", error.file, error.code, error.message);
  if (!error.hint.empty()) fmt::print(stderr, "  {}\n", error.hint);
  return 2;
}

void print_lines(const nlohmann::ordered_json& s) {
  fmt::print("{} | {} | {} frames\n", s["workload"].get<std::string>(),
             s["solver"].get<std::string>(), s["frames"].get<std::size_t>());
  fmt::print("  time per frame  {:.2f} us median, {:.2f} us p99 (forward kinematics {:.2f} us)\n",
             s["us"]["median"].get<double>(), s["us"]["p99"].get<double>(),
             s["fk_us"].get<double>());
  fmt::print("  iterations      {:.0f} median, {:.0f} p99\n",
             s["iterations"]["median"].get<double>(), s["iterations"]["p99"].get<double>());
  for (const auto& [key, unit] :
       {std::pair{"position_error_mm", "mm"}, std::pair{"orientation_error_deg", "degrees"}}) {
    fmt::print("  worst effector  {:.4f} median, {:.4f} p95, {:.4f} max {}\n",
               s[key]["median"].get<double>(), s[key]["p95"].get<double>(),
               s[key]["max"].get<double>(), unit);
  }
  fmt::print("  solved {:.2f} %, limit violations {}\n", 100.0 * s["success_rate"].get<double>(),
             s["limit_violations"].get<std::int64_t>());
  if (!s.contains("cycle")) return;
  for (const char* at : {"seam", "elsewhere"}) {
    const auto& step = s["cycle"][at];
    fmt::print("  {:<15} {:.4f} mm, {:.4f} degrees; velocity jump {:.4f} mm, {:.4f} degrees\n", at,
               step["position_mm"].get<double>(), step["angle_deg"].get<double>(),
               step["velocity_jump_mm"].get<double>(), step["velocity_jump_deg"].get<double>());
  }
}

}  // namespace

int bench_command(const BenchArgs& args) {
  const bool known = args.solver == "pgs" || args.solver == "pgs-paper" || args.solver == "ceres";
  if (!known || (args.start != "extrapolate" && args.start != "previous") || args.lanes < 1 ||
      !(args.stop_mm >= 0.0) || !(args.stop_deg >= 0.0) || args.sweeps < 0) {
    return complain({.code = "bench-options",
                     .message = "an option's value is out of range",
                     .hint = "--solver pgs|pgs-paper|ceres, --start extrapolate|previous, "
                             "--lanes N >= 1, --stop-mm X > 0, --stop-deg X > 0, --sweeps N >= 1"},
                    args);
  }
  Result<Workload> work = read_workload(args.workload);
  if (!work) return complain(work.error(), args);
  if (args.cycle && (args.solver == "ceres" || args.lanes > 1 || work->rest_start)) {
    return complain({.code = "bench-options",
                     .message = "--cycle is of a motion, solved by pgs or pgs-paper in one lane",
                     .hint = "leave out --cycle, or --lanes and --solver ceres"},
                    args);
  }
  Bench bench(args, std::move(work.value()));
  if (Result<void> ran = bench.run(); !ran) return complain(ran.error(), args);
  if (!args.solutions.empty()) {
    if (Result<void> written = bench.write_solutions(); !written) {
      return complain(written.error(), args);
    }
  }
  const nlohmann::ordered_json summary = bench.summary();
  if (args.json) {
    fmt::print("{}\n", summary.dump(2));
  } else {
    print_lines(summary);
  }
  return 0;
}

}  // namespace limber
