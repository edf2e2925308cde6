#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>

#include "pipeline/commands.h"
#include "pipeline/gates.h"
#include "pipeline/measure.h"
#include "pipeline/reading_budget.h"
#include "validation/contact_detection.h"
#include "validation/limit_check.h"

namespace limber {
namespace {

using json = nlohmann::ordered_json;

/// A file that moves, understood as a figure.
struct Performance {
  Imported imported;
  Figure figure;
  Calibration calibration;
  MeasuredMotion measured() const {
    return {{&imported.character, &figure, &calibration, &imported.clips.front()}, floor()};
  }

  /// Ankles stand at their own height above the floor.
  double floor() const {
    if (!figure.has(Role::leftFoot) || !figure.has(Role::rightFoot)) return 0.0;
    const Clip& clip = imported.clips.front();
    std::vector<DualQuaternion> model(imported.character.skeleton.parents.size());
    std::vector<std::vector<Eigen::Vector3d>> ankles(2);
    for (std::int64_t f = 0; f < clip.frames(); ++f) {
      model_from_local(imported.character.skeleton, clip.frame(f), model);
      ankles[0].push_back(model[figure.at(Role::leftFoot)].translation());
      ankles[1].push_back(model[figure.at(Role::rightFoot)].translation());
    }
    return floor_level(ankles) - calibration.ankle_height;
  }
};

Result<Performance> load_performance(const std::string& path, bool keep_reference_frame) {
  ImportOptions options;
  options.keep_reference_frame = keep_reference_frame;
  auto imported = import_within_budget(path, options);
  const auto in_file = [&](Error error) {
    if (error.file.empty()) error.file = path;
    return error;
  };
  if (!imported) return in_file(imported.error());
  if (imported->clips.empty()) {
    return Error{.code = "clip-none",
                 .message = "the file holds no motion",
                 .file = path,
                 .hint = "give the animated file"};
  }
  Performance out{.imported = std::move(*imported), .figure = {}, .calibration = {}};
  auto figure = identify_figure(out.imported.character);
  if (!figure) return in_file(figure.error());
  out.figure = std::move(*figure);
  auto calibration = calibrate(out.imported.character, out.figure, {}, out.imported.reference_pose,
                               &out.imported.clips.front());
  if (!calibration) return in_file(calibration.error());
  out.calibration = std::move(*calibration);
  return out;
}

json error_json(const Error& e) {
  return {{"error",
           {{"code", e.code},
            {"message", e.message},
            {"file", e.file},
            {"joint", e.joint},
            {"hint", e.hint}}}};
}

/// The shipped rig whose joints, hierarchy and bones the file has, if any.
std::optional<Rig> rig_worn_by(const Skeleton& skeleton) {
  for (const std::string& name : shipped_rig_names()) {
    const auto rig = shipped_rig(name);
    const bool same = std::all_of(rig->joints.begin(), rig->joints.end(), [&](const RigJoint& row) {
      const std::int32_t j = skeleton.find(row.name);
      if (j == kNoJoint || row.parent == kNoJoint) return j != kNoJoint;
      const std::int32_t parent = skeleton.parents[j];
      const Eigen::Vector3d t = skeleton.rest_parent_from_joint[j].translation();
      return parent != kNoJoint && skeleton.names[parent] == rig->joints[row.parent].name &&
             (t - row.offset).norm() < 1e-4;
    });
    const auto rows = static_cast<std::size_t>(rig->size());
    if (same && rows + rows / 2 >= skeleton.names.size()) return rig;
  }
  return std::nullopt;
}

json check(const ValidateArgs& args) {
  const auto source = load_performance(args.source, false);
  if (!source) return error_json(source.error());
  const auto output = load_performance(args.file, true);
  if (!output) return error_json(output.error());
  Rig rig = limited_rig(output->imported.character, output->figure, output->calibration, true);
  rig.name = "anatomical";
  if (auto worn = rig_worn_by(output->imported.character.skeleton)) rig = std::move(*worn);
  if (!args.rig.empty()) {
    auto target = load_target(args.rig, {});
    if (!target) {
      json out = error_json(target.error());
      out["usage"] = true;
      return out;
    }
    rig = target->rig;
  }
  const auto& clip = output->imported.clips.front();
  const auto on_rig = clip_on_rig(output->imported.character.skeleton, clip, rig);
  if (!on_rig) {
    return error_json({.code = "rig-not-this-character",
                       .message = "the file lacks a joint of the rig",
                       .file = args.file,
                       .hint = "give the rig that the file was made for"});
  }
  const LimitReport limits = check_joint_limits(rig, *on_rig);
  const double scale =
      size_ratio(source->figure, source->calibration, output->figure, output->calibration);
  const MotionMetrics m = measure_against(source->measured(), output->measured(), scale);
  json worst = json::array();
  for (const LimitFinding& finding : limits.worst) {
    worst.push_back({{"joint", rig.joints[finding.joint].name},
                     {"frame", finding.frame},
                     {"excess_deg", finding.excess_rad * 180.0 / M_PI}});
  }
  const auto feet = [](const ContactFigures& f) {
    return json{{"slide_cm_s", f.slide_cm_s},
                {"drift_cm", f.drift_cm},
                {"penetration_cm", f.penetration_cm}};
  };
  const Clip& source_clip = source->imported.clips.front();
  const bool same_length =
      std::abs(source_clip.duration_s() - clip.duration_s()) < 1.0 / clip.rate_hz;
  json reasons = json::array();
  if (limits.violations > 0) reasons.push_back("joints are beyond their limits");
  if (!same_length) reasons.push_back("file and source differ in duration");
  return {{"schema", "limber-validation/1"},
          {"file", args.file},
          {"source", args.source},
          {"rig", rig.name},
          {"status", reasons.empty() ? "pass" : "fail"},
          {"reasons", reasons},
          {"frames", clip.frames()},
          {"rate_hz", clip.rate_hz},
          {"duration_s", clip.duration_s()},
          {"source_duration_s", source_clip.duration_s()},
          {"limits",
           {{"joints", limits.joints},
            {"violations", limits.violations},
            {"max_violation_deg", limits.max_violation_deg},
            {"worst", worst}}},
          {"contacts",
           {{"source", feet(m.source)},
            {"output", feet(m.output)},
            {"excess", feet(less(m.output, m.source))},
            {"intervals", m.intervals}}},
          {"smoothness",
           {{"jerk_ratio", m.jerk_ratio},
            {"max_angular_velocity_ratio", m.max_angular_velocity_ratio},
            {"pops", m.pops}}}};
}

}  // namespace

int validate_command(const ValidateArgs& args) {
  std::optional<Gates> gates;
  if (!args.gates.empty()) {
    auto read = load_gates(args.gates);
    if (!read) {
      print_error(read.error(), args.json);
      return kUsage;
    }
    gates = std::move(*read);
  }
  const auto answer =
      run_isolated([&] { return check(args).dump(2, ' ', false, json::error_handler_t::replace); },
                   {.may = {.reads = {args.file, args.source, args.rig}}});
  if (!answer) {
    Error error = answer.error();
    error.file = args.file;
    print_error(error, args.json);
    return kSomeFailed;
  }
  json found = json::parse(*answer, nullptr, false);
  if (found.contains("error")) {
    const json& e = found["error"];
    print_error({.code = e["code"],
                 .message = e["message"],
                 .file = e["file"],
                 .joint = e["joint"],
                 .hint = e["hint"]},
                args.json);
    return found.value("usage", false) ? kUsage : kSomeFailed;
  }
  std::vector<GateVerdict> verdicts;
  if (gates) {
    verdicts = judge_gates(*gates, *answer);
    found["gates"] = json::parse(to_json(verdicts));
  }
  if (args.json) {
    fmt::print("{}\n", found.dump(2, ' ', false, json::error_handler_t::replace));
  } else {
    fmt::print("{}: {}\n  {} frames at {:g} Hz, {:.3f} s (source {:.3f} s)\n", args.file,
               found["status"].get<std::string>(), found["frames"].get<std::int64_t>(),
               found["rate_hz"].get<double>(), found["duration_s"].get<double>(),
               found["source_duration_s"].get<double>());
    for (const auto& reason : found["reasons"]) fmt::print("  {}\n", reason.get<std::string>());
    fmt::print("  limits of {}: {} violations in {} joints, worst {:.4f} degrees\n",
               found["rig"].get<std::string>(), found["limits"]["violations"].get<std::int64_t>(),
               found["limits"]["joints"].get<std::int64_t>(),
               found["limits"]["max_violation_deg"].get<double>());
    fmt::print("  feet slide {:.1f} cm/s (source {:.1f}), {} pops\n",
               found["contacts"]["output"]["slide_cm_s"].get<double>(),
               found["contacts"]["source"]["slide_cm_s"].get<double>(),
               found["smoothness"]["pops"].get<std::int64_t>());
    for (const GateVerdict& verdict : verdicts) {
      if (verdict.level == GateLevel::pass) continue;
      fmt::print("  gate {}: {}\n", to_string(verdict.level), describe(verdict));
    }
  }
  const bool missed = std::any_of(verdicts.begin(), verdicts.end(),
                                  [](const GateVerdict& v) { return v.level == GateLevel::fail; });
  if (found["status"] != "pass") return kSomeFailed;
  return missed ? kGateMissed : kAllPassed;
}

}  // namespace limber
