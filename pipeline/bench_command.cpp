#include "pipeline/bench_command.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>
#include <vector>

#include "assets/model/rig.h"
#include "pipeline/workload.h"
#include "solver/ik_solver.h"
#include "validation/ceres_refiner.h"
#include "validation/contact_detection.h"
#include "validation/limit_check.h"

namespace limber {

namespace {

struct FrameResult : EffectorMiss {
  double us = 0.0;
};

class Bench {
 public:
  Bench(const BenchArgs& args, Workload work) : args_(args), work_(std::move(work)) {}

  Result<void> run();
  nlohmann::ordered_json summary() const;
  Result<void> write_solutions() const;

 private:
  Result<void> run_lane(std::size_t first, std::size_t last, IkSolver& solver);
  Result<void> solve(std::size_t frame, IkSolver& solver, std::span<DualQuaternion> pose);

  using Clock = std::chrono::steady_clock;
  static double microseconds(Clock::duration d) {
    return std::chrono::duration<double, std::micro>(d).count();
  }

  const BenchArgs& args_;
  Workload work_;
  std::vector<FrameResult> results_;
  std::vector<double> fk_us_;
  Clip clip_;
};

Result<void> Bench::solve(std::size_t frame, IkSolver& solver, std::span<DualQuaternion> pose) {
  if (args_.solver != "ceres") {
    solver.solve(work_.targets[frame], pose);
    return {};
  }
  const auto refined =
      refine_with_ceres(work_.rig, work_.targets[frame], pose, {.max_iterations = 100});
  if (!refined) return refined.error();
  return {};
}

Result<void> Bench::run_lane(std::size_t first, std::size_t last, IkSolver& solver) {
  const Rig& rig = work_.rig;
  const Skeleton skeleton = skeleton_of(rig);
  Pose pose(rig.joints.size()), world(rig.joints.size());
  const std::vector<double> zero(static_cast<std::size_t>(dof_count(rig)), 0.0);
  for (std::size_t f = first; f < last; ++f) {
    auto start = Clock::now();
    if (work_.rest_start || f == first) {
      pose_from_coordinates(rig, work_.rest_start ? zero : work_.truth_q[f], pose);
      start = Clock::now();
    } else {
      const auto previous = clip_.frame(static_cast<std::int64_t>(f) - 1);
      if (args_.start == "extrapolate" && f >= first + 2) {
        extrapolate(rig, clip_.frame(static_cast<std::int64_t>(f) - 2), previous, pose);
      } else {
        std::copy(previous.begin(), previous.end(), pose.begin());
      }
    }
    if (Result<void> solved = solve(f, solver, pose); !solved) return solved;
    const auto end = Clock::now();
    model_from_local(skeleton, pose, world);
    fk_us_[f] = microseconds(Clock::now() - end);
    results_[f] = {worst_miss(rig, work_.targets[f], world), microseconds(end - start)};
    std::copy(pose.begin(), pose.end(), clip_.frame(static_cast<std::int64_t>(f)).begin());
  }
  return {};
}

Result<void> Bench::run() {
  Rig& rig = work_.rig;
  if (args_.pos) {
    for (RigEffector& effector : rig.effectors) effector.weight_rot = 0.0;
  }
  IkOptions options =
      options_for(work_, args_.solver == "pgs-paper" ? IkMethod::pgs_paper : IkMethod::pgs);
  if (args_.stop_mm > 0.0) options.stop_position_m = 1e-3 * args_.stop_mm;
  Result<IkSolver> solver = IkSolver::create(rig, options);
  if (!solver) return solver.error();
  const std::size_t frames = work_.frames();
  results_.resize(frames);
  fk_us_.resize(frames);
  clip_.joints = rig.size();
  clip_.parent_from_joint.resize(frames * rig.joints.size());
  const auto lanes = std::min(static_cast<std::size_t>(args_.lanes), frames);
  for (std::size_t lane = 0; lane < lanes; ++lane) {
    const std::size_t first = lane * frames / lanes, last = (lane + 1) * frames / lanes;
    if (Result<void> ran = run_lane(first, last, solver.value()); !ran) return ran;
  }
  return {};
}

nlohmann::ordered_json Bench::summary() const {
  std::vector<double> us, mm, deg;
  std::size_t solved = 0;
  const LimitReport limits = check_joint_limits(work_.rig, clip_);
  const bool within = limits.max_violation_deg < 0.5;
  for (const FrameResult& frame : results_) {
    us.push_back(frame.us);
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
  return {{"workload", work_.name + (args_.pos ? " pos" : "")},
          {"solver", args_.solver},
          {"frames", work_.frames()},
          {"us", {{"median", percentile(us, 50.0)}, {"p99", percentile(us, 99.0)}}},
          {"fk_us", percentile(fk_us_, 50.0)},
          {"position_error_mm", spread(mm)},
          {"orientation_error_deg", spread(deg)},
          {"limit_violations", limits.violations},
          {"success_rate", static_cast<double>(solved) / static_cast<double>(work_.frames())}};
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
  for (const auto& [key, unit] :
       {std::pair{"position_error_mm", "mm"}, std::pair{"orientation_error_deg", "degrees"}}) {
    fmt::print("  worst effector  {:.4f} median, {:.4f} p95, {:.4f} max {}\n",
               s[key]["median"].get<double>(), s[key]["p95"].get<double>(),
               s[key]["max"].get<double>(), unit);
  }
  fmt::print("  solved {:.2f} %, limit violations {}\n", 100.0 * s["success_rate"].get<double>(),
             s["limit_violations"].get<std::int64_t>());
}

}  // namespace

int bench_command(const BenchArgs& args) {
  const bool known = args.solver == "pgs" || args.solver == "pgs-paper" || args.solver == "ceres";
  if (!known || (args.start != "extrapolate" && args.start != "previous") || args.lanes < 1 ||
      !(args.stop_mm >= 0.0)) {
    return complain({.code = "bench-options",
                     .message = "an option's value is out of range",
                     .hint = "--solver pgs|pgs-paper|ceres, --start extrapolate|previous, "
                             "--lanes N >= 1, --stop-mm X > 0"},
                    args);
  }
  Result<Workload> work = read_workload(args.workload);
  if (!work) return complain(work.error(), args);
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
