#include "pipeline/validation_check.h"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>

#include "pipeline/map_file.h"
#include "pipeline/measure.h"
#include "pipeline/reading_budget.h"
#include "validation/contact_detection.h"
#include "validation/limit_check.h"
#include "validation/motion_faults.h"

namespace limber {
namespace {

using json = nlohmann::ordered_json;

/// A file that moves, understood as a figure.
struct Performance {
  Imported imported;
  Clip clip;
  Figure figure;
  Calibration calibration;
  MeasuredMotion measured() const {
    return {{&imported.character, &figure, &calibration, &clip}, floor()};
  }

  /// Ankles stand at their own height above the floor.
  double floor() const {
    if (!figure.has(Role::leftFoot) || !figure.has(Role::rightFoot)) return 0.0;
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

/// The clip of that name; the first where none is given.
Result<Clip> chosen_clip(const Imported& imported, const std::string& name) {
  for (const Clip& clip : imported.clips) {
    if (name.empty() || clip.name == name) return clip;
  }
  if (imported.clips.empty()) {
    return Error{.code = "clip-none",
                 .message = "the file holds no motion",
                 .hint = "give the animated file"};
  }
  return Error{.code = "clip-unknown",
               .message = "the file has no clip of that name",
               .hint = "see limber inspect"};
}

/// Which part of a file counts, and what its joints are.
struct Choice {
  std::string clip;
  std::optional<std::pair<std::int64_t, std::int64_t>> range;
  RoleOverrides roles;
  bool keep_reference_frame = false;
};

Result<void> cut(Clip& clip, std::pair<std::int64_t, std::int64_t> range) {
  const std::int64_t last = std::min(range.second, clip.frames() - 1);
  if (range.first < 0 || range.first > last) {
    return Error{.code = "range-empty",
                 .message = "the clip has no such frames",
                 .hint = "give --range FIRST:LAST within the clip"};
  }
  auto& poses = clip.parent_from_joint;
  poses.erase(poses.begin() + (last + 1) * clip.joints, poses.end());
  poses.erase(poses.begin(), poses.begin() + range.first * clip.joints);
  clip.start_s += double(range.first) / clip.rate_hz;
  return {};
}

Result<Performance> load_performance(const std::string& path, const Choice& choice) {
  ImportOptions options;
  options.keep_reference_frame = choice.keep_reference_frame;
  auto imported = import_within_budget(path, options);
  const auto in_file = [&](Error error) {
    if (error.file.empty()) error.file = path;
    return error;
  };
  if (!imported) return in_file(imported.error());
  auto clip = chosen_clip(*imported, choice.clip);
  if (!clip) return in_file(clip.error());
  Performance out{
      .imported = std::move(*imported), .clip = std::move(*clip), .figure = {}, .calibration = {}};
  auto figure = identify_figure(out.imported.character, choice.roles);
  if (!figure) return in_file(figure.error());
  out.figure = std::move(*figure);
  auto calibration =
      calibrate(out.imported.character, out.figure, {}, out.imported.reference_pose, &out.clip);
  if (!calibration) return in_file(calibration.error());
  out.calibration = std::move(*calibration);
  if (choice.range) {
    if (auto r = cut(out.clip, *choice.range); !r) return in_file(r.error());
  }
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

/// The user's own mistake, not the file's.
json usage_json(const Error& e) {
  json out = error_json(e);
  out["usage"] = true;
  return out;
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

/// The rig whose limits count: the one that was asked for, a shipped one that the file wears, or
/// the file's own figure with anatomical limits.
Result<Rig> rig_of(const ValidateArgs& args, const Performance& output) {
  if (!args.rig.empty()) {
    auto target = load_target(args.rig, {});
    if (!target) return target.error();
    return std::move(target->rig);
  }
  if (auto worn = rig_worn_by(output.imported.character.skeleton)) return std::move(*worn);
  Rig rig = limited_rig(output.imported.character, output.figure, output.calibration, true);
  rig.name = "anatomical";
  return rig;
}

json findings_json(const MotionFaults& faults) {
  json findings = json::array();
  for (const MotionFault& fault : faults) {
    json finding{
        {"code", fault.code}, {"level", fault.fails ? "fail" : "warn"}, {"message", fault.message}};
    if (!fault.joint.empty()) finding["joint"] = fault.joint;
    if (fault.frame >= 0) finding["frame"] = fault.frame;
    findings.push_back(std::move(finding));
  }
  return findings;
}

json limits_json(const Rig& rig, const LimitReport& limits) {
  json worst = json::array();
  for (const LimitFinding& finding : limits.worst) {
    worst.push_back({{"joint", rig.joints[finding.joint].name},
                     {"frame", finding.frame},
                     {"excess_deg", finding.excess_rad * 180.0 / M_PI}});
  }
  return {{"joints", limits.joints},
          {"violations", limits.violations},
          {"max_violation_deg", limits.max_violation_deg},
          {"worst", worst}};
}

json contacts_json(const MotionMetrics& m) {
  const auto feet = [](const ContactFigures& f) {
    return json{{"slide_cm_s", f.slide_cm_s},
                {"drift_cm", f.drift_cm},
                {"penetration_cm", f.penetration_cm}};
  };
  return {{"source", feet(m.source)},
          {"output", feet(m.output)},
          {"excess", feet(less(m.output, m.source))},
          {"intervals", m.intervals}};
}

MotionFaults all_faults(const Performance& source, const Performance& output, const Rig& rig,
                        const Clip& on_rig, const LimitReport& limits, const MotionMetrics& metrics,
                        double scale) {
  const MotionSide from = motion_side(source.measured()), to = motion_side(output.measured());
  MotionFaults faults;
  for (MotionFaults some : {timing_faults(source.clip, output.clip), limit_faults(rig, limits),
                            bone_faults(rig, on_rig), side_faults(from, to),
                            contact_faults(metrics, to, scale), pop_faults(metrics, output.clip)}) {
    std::ranges::move(some, std::back_inserter(faults));
  }
  return faults;
}

const char* verdict_of(const MotionFaults& faults) {
  if (std::ranges::any_of(faults, &MotionFault::fails)) return "fail";
  return faults.empty() ? "pass" : "warn";
}

json check(const ValidateArgs& args) {
  Choice choice{.clip = args.clip, .range = args.range, .roles = {}};
  if (!args.map.empty()) {
    auto map = read_map_file(args.map);
    if (!map) return usage_json(map.error());
    choice.roles = std::move(map->source);
  }
  const auto source = load_performance(args.source, choice);
  if (!source) return error_json(source.error());
  Choice whole;
  whole.keep_reference_frame = true;
  const auto output = load_performance(args.file, whole);
  if (!output) return error_json(output.error());
  const auto rig = rig_of(args, *output);
  if (!rig) return usage_json(rig.error());
  const Clip& clip = output->clip;
  const auto on_rig = clip_on_rig(output->imported.character.skeleton, clip, *rig);
  if (!on_rig) {
    return error_json({.code = "rig-not-this-character",
                       .message = "the file lacks a joint of the rig",
                       .file = args.file,
                       .hint = "give the rig that the file was made for"});
  }
  const LimitReport limits = check_joint_limits(*rig, *on_rig);
  const double scale =
      size_ratio(source->figure, source->calibration, output->figure, output->calibration);
  const MotionMetrics m = measure_against(source->measured(), output->measured(), scale);
  const MotionFaults faults = all_faults(*source, *output, *rig, *on_rig, limits, m, scale);
  return {{"schema", "limber-validation/1"},
          {"file", args.file},
          {"source", args.source},
          {"rig", rig->name},
          {"status", verdict_of(faults)},
          {"findings", findings_json(faults)},
          {"frames", clip.frames()},
          {"rate_hz", clip.rate_hz},
          {"duration_s", clip.duration_s()},
          {"source_duration_s", source->clip.duration_s()},
          {"limits", limits_json(*rig, limits)},
          {"contacts", contacts_json(m)},
          {"smoothness",
           {{"jerk_ratio", m.jerk_ratio},
            {"max_angular_velocity_ratio", m.max_angular_velocity_ratio},
            {"pops", m.pops}}}};
}

}  // namespace

std::string check_against_source(const ValidateArgs& args) {
  return check(args).dump(2, ' ', false, json::error_handler_t::replace);
}

}  // namespace limber
