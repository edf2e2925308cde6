#include "pipeline/bench_command.h"

#include <fmt/format.h>
#include <zlib.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

#include "assets/model/rig.h"
#include "importers/rig_json.h"
#include "solver/ik_solver.h"
#include "solver/lane_solver.h"
#include "validation/ceres_refiner.h"
#include "validation/limit_check.h"

namespace limber {

namespace {

constexpr int kRestartsOfLonePoses = 24;  // sporadic sets: no frame follows from another

struct Workload {
  std::string name;
  Rig rig;
  bool rest_start = false;  ///< every frame starts at q = 0, else frame 0 at its truth
  double stop_pos = 1e-4, stop_rot = 8.7266e-4, success_pos = 1e-3, success_rot = 8.7266e-3;
  std::vector<std::vector<double>> truth_q;          ///< [frame][ndof]
  std::vector<std::vector<EffectorTarget>> targets;  ///< [frame][effector]
  std::size_t frames() const { return targets.size(); }
};

struct FrameResult {
  double us = 0.0, position_mm = 0.0, orientation_deg = 0.0;
  int iterations = 0;
};

Error workload_error(std::string message) {
  return {.code = "bench-workload",
          .message = std::move(message),
          .hint = "a workload is an ikwork/1 document, plain or gzipped"};
}

/// gzip or plain: zlib tells them apart.
std::optional<std::string> read_text(const std::filesystem::path& path) {
  const gzFile file = gzopen(path.c_str(), "rb");
  if (file == nullptr) return std::nullopt;
  std::string text;
  std::vector<char> block(1 << 20);
  int got = 0;
  while ((got = gzread(file, block.data(), static_cast<unsigned>(block.size()))) > 0) {
    text.append(block.data(), static_cast<std::size_t>(got));
  }
  const bool whole = gzeof(file) != 0 && got == 0;
  gzclose(file);
  if (!whole) return std::nullopt;
  return text;
}

EffectorTarget read_target(const nlohmann::json& row) {
  const Eigen::Quaterniond rotation(row.at(3).get<double>(), row.at(4).get<double>(),
                                    row.at(5).get<double>(), row.at(6).get<double>());
  return {.pose = DualQuaternion::from_rotation_translation(
              rotation.normalized(),
              {row.at(0).get<double>(), row.at(1).get<double>(), row.at(2).get<double>()})};
}

Result<Workload> parse_workload(const nlohmann::json& document) {
  if (document.at("format") != "ikwork/1") return workload_error("the format is not ikwork/1");
  Workload work;
  work.name = fmt::format("{} {}", document.at("rig").get<std::string>(),
                          document.at("set").get<std::string>());
  const nlohmann::json rig = {{"format", "ikrig/1"},
                              {"name", document.at("rig")},
                              {"joints", document.at("joints")},
                              {"effectors", document.at("effectors")}};
  Result<Rig> read = read_rig_json(rig.dump());
  if (!read) return read.error();
  work.rig = std::move(read.value());
  work.rest_start = document.at("start") == "rest";
  const nlohmann::json& tolerance = document.at("tolerance");
  work.stop_pos = tolerance.at("stop_pos").get<double>();
  work.stop_rot = tolerance.at("stop_rot").get<double>();
  work.success_pos = tolerance.at("success_pos").get<double>();
  work.success_rot = tolerance.at("success_rot").get<double>();
  work.truth_q = document.at("truth_q").get<std::vector<std::vector<double>>>();
  const auto ndof = static_cast<std::size_t>(dof_count(work.rig));
  for (const nlohmann::json& frame : document.at("targets")) {
    std::vector<EffectorTarget> targets;
    for (const nlohmann::json& row : frame) targets.push_back(read_target(row));
    if (targets.size() != work.rig.effectors.size()) {
      return workload_error("a frame has not one target per effector");
    }
    work.targets.push_back(std::move(targets));
  }
  for (const auto& q : work.truth_q) {
    if (q.size() != ndof) return workload_error("a frame's truth_q has not ndof numbers");
  }
  if (work.targets.empty() || work.truth_q.size() != work.frames()) {
    return workload_error("truth_q and targets differ in length, or are empty");
  }
  return work;
}

Result<Workload> read_workload(const std::filesystem::path& path) {
  const std::optional<std::string> text = read_text(path);
  if (!text) return workload_error("the file cannot be read");
  try {
    return parse_workload(nlohmann::json::parse(*text));
  } catch (const nlohmann::json::exception& fault) {
    return workload_error(fault.what());
  }
}

FrameResult measure(const Rig& rig, std::span<const EffectorTarget> targets,
                    std::span<const DualQuaternion> world) {
  FrameResult result;
  for (std::size_t e = 0; e < rig.effectors.size(); ++e) {
    const RigEffector& effector = rig.effectors[e];
    if (!effector.strong) continue;
    const DualQuaternion& joint = world[effector.joint];
    const Eigen::Vector3d miss =
        targets[e].pose.translation() - joint.transform_point(effector.offset);
    if (effector.weight_pos > 0.0 && effector.kind != EffectorKind::orientation) {
      result.position_mm = std::max(result.position_mm, 1e3 * miss.norm());
    }
    if (effector.weight_rot > 0.0 && effector.kind != EffectorKind::position) {
      const double angle = rotation_angle(targets[e].pose.rotation(), joint.rotation());
      result.orientation_deg = std::max(result.orientation_deg, angle * 180.0 / M_PI);
    }
  }
  return result;
}

double percentile(std::vector<double> values, double p) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  const auto i = static_cast<std::size_t>(p * static_cast<double>(values.size()));
  return values[std::min(i, values.size() - 1)];
}

class Bench {
 public:
  Bench(const BenchArgs& args, Workload work) : args_(args), work_(std::move(work)) {}

  Result<void> run();
  nlohmann::ordered_json summary() const;
  Result<void> write_solutions() const;

 private:
  Result<void> run_lane(std::size_t first, std::size_t last, IkSolver& solver);
  Result<void> run_in_lanes(std::span<const std::size_t> cuts, const IkOptions& options);
  /// Returns the iterations it took.
  Result<int> solve(std::size_t frame, bool first, IkSolver& solver,
                    std::span<DualQuaternion> pose);

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

Result<int> Bench::solve(std::size_t frame, bool first, IkSolver& solver,
                         std::span<DualQuaternion> pose) {
  if (args_.solver != "ceres") {
    const bool alone = first || work_.rest_start;
    return (alone ? solver.solve(work_.targets[frame], pose)
                  : solver.follow(work_.targets[frame], pose))
        .relinearisations;
  }
  const auto refined =
      refine_with_ceres(work_.rig, work_.targets[frame], pose, {.max_iterations = 100});
  if (!refined) return refined.error();
  return refined.value().iterations;
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
    }
    if (!work_.rest_start && f > first) {
      const auto previous = clip_.frame(static_cast<std::int64_t>(f) - 1);
      std::copy(previous.begin(), previous.end(), pose.begin());
    }
    const Result<int> iterations = solve(f, f == first, solver, pose);
    if (!iterations) return iterations.error();
    const auto end = Clock::now();
    model_from_local(skeleton, pose, world);
    fk_us_[f] = microseconds(Clock::now() - end);
    results_[f] = measure(rig, work_.targets[f], world);
    results_[f].us = microseconds(end - start);
    results_[f].iterations = iterations.value();
    std::copy(pose.begin(), pose.end(), clip_.frame(static_cast<std::int64_t>(f)).begin());
  }
  return {};
}

/// Runs side by side: lane i solves the frames from cuts[i] to cuts[i + 1].
Result<void> Bench::run_in_lanes(std::span<const std::size_t> cuts, const IkOptions& options) {
  const Rig& rig = work_.rig;
  Result<LaneSolver> made = LaneSolver::create(rig, options);
  if (!made) return made.error();
  LaneSolver& solver = made.value();
  const int used = static_cast<int>(cuts.size()) - 1;
  const std::size_t effectors = rig.effectors.size();
  Pose pose(rig.joints.size()), world(rig.joints.size());
  std::vector<EffectorTarget> targets(LaneSolver::lanes * effectors);
  std::size_t longest = 0;
  for (int lane = 0; lane < LaneSolver::lanes; ++lane) {
    pose_from_coordinates(rig, work_.truth_q[cuts[std::min(lane, used - 1)]], pose);
    solver.start(lane, pose);
    if (lane < used) longest = std::max(longest, cuts[lane + 1] - cuts[lane]);
  }
  // Lanes without a run of their own, or at its end, stay on their last frame.
  const auto frame_of = [&](int lane, std::size_t step) {
    const int run = std::min(lane, used - 1);
    return std::min(cuts[run] + step, cuts[run + 1] - 1);
  };
  for (std::size_t step = 0; step < longest; ++step) {
    for (int lane = 0; lane < LaneSolver::lanes; ++lane) {
      std::ranges::copy(work_.targets[frame_of(lane, step)], targets.begin() + lane * effectors);
    }
    const auto start = Clock::now();
    solver.follow(targets);
    for (int lane = 0; lane < used; ++lane) {
      solver.pose(lane, clip_.frame(static_cast<std::int64_t>(frame_of(lane, step))));
    }
    const double each = microseconds(Clock::now() - start) / used;
    for (int lane = 0; lane < used; ++lane) {
      const std::size_t f = frame_of(lane, step);
      if (results_[f].us > 0.0) continue;
      model_from_local(skeleton_of(rig), clip_.frame(static_cast<std::int64_t>(f)), world);
      results_[f] = measure(rig, work_.targets[f], world);
      results_[f].us = each;
    }
  }
  return {};
}

Result<void> Bench::run() {
  Rig& rig = work_.rig;
  if (args_.pos) {
    for (RigEffector& effector : rig.effectors) effector.weight_rot = 0.0;
  }
  IkOptions options;
  options.method = args_.solver == "pgs-paper" ? IkMethod::pgs_paper : IkMethod::pgs;
  options.stop_position_m = args_.stop_mm > 0.0 ? 1e-3 * args_.stop_mm : work_.stop_pos;
  options.stop_orientation_rad =
      args_.stop_deg > 0.0 ? args_.stop_deg * M_PI / 180.0 : work_.stop_rot;
  if (args_.sweeps > 0) options.sweeps = args_.sweeps;
  options.unwind = !work_.rest_start;
  options.extrapolate = args_.start == "extrapolate";
  options.measure_residual = false;
  options.restarts = work_.rest_start ? kRestartsOfLonePoses : 0;
  Result<IkSolver> solver = IkSolver::create(rig, options);
  if (!solver) return solver.error();
  const std::size_t frames = work_.frames();
  results_.resize(frames);
  fk_us_.resize(frames);
  clip_.joints = rig.size();
  clip_.parent_from_joint.resize(frames * rig.joints.size());
  const auto lanes = std::min(static_cast<std::size_t>(args_.lanes), frames);
  std::vector<std::size_t> cuts;
  for (std::size_t lane = 0; lane <= lanes; ++lane) cuts.push_back(lane * frames / lanes);
  if (lanes > 1 && args_.solver == "pgs" && !work_.rest_start) {
    for (std::size_t lane = 0; lane < lanes; lane += LaneSolver::lanes) {
      const std::size_t count = std::min<std::size_t>(LaneSolver::lanes, lanes - lane);
      if (auto ran = run_in_lanes(std::span(cuts).subspan(lane, count + 1), options); !ran) {
        return ran;
      }
    }
    return {};
  }
  for (std::size_t lane = 0; lane < lanes; ++lane) {
    if (auto ran = run_lane(cuts[lane], cuts[lane + 1], solver.value()); !ran) return ran;
  }
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
    return nlohmann::ordered_json{{"median", percentile(values, 0.5)},
                                  {"p95", percentile(values, 0.95)},
                                  {"max", percentile(values, 1.0)}};
  };
  return {{"workload", work_.name + (args_.pos ? " pos" : "")},
          {"solver", args_.solver},
          {"frames", work_.frames()},
          {"us", {{"median", percentile(us, 0.5)}, {"p99", percentile(us, 0.99)}}},
          {"fk_us", percentile(fk_us_, 0.5)},
          {"iterations",
           {{"median", percentile(iterations, 0.5)}, {"p99", percentile(iterations, 0.99)}}},
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
