#include "pipeline/clip_record.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "pipeline/version.h"
#include "validation/contact_detection.h"

namespace limber {
namespace {

using json = nlohmann::ordered_json;

/// Numbers in reports carry what they mean, not the last bits of a double.
double rounded(double x) {
  if (!std::isfinite(x)) return 0.0;
  return std::round(x * 1e6) / 1e6;
}

json error_json(const Error& error) {
  json out{{"code", error.code}, {"message", error.message}};
  if (!error.file.empty()) out["file"] = error.file;
  if (!error.joint.empty()) out["joint"] = error.joint;
  if (error.frame >= 0) out["frame"] = error.frame;
  if (!error.hint.empty()) out["hint"] = error.hint;
  return out;
}

json warning_json(const Warning& warning) {
  json out{{"code", warning.code}, {"message", warning.message}};
  if (!warning.joint.empty()) out["joint"] = warning.joint;
  if (warning.frame >= 0) out["frame"] = warning.frame;
  return out;
}

json figures(const std::vector<double>& values) {
  return {{"median", rounded(percentile(values, 50.0))},
          {"p95", rounded(percentile(values, 95.0))},
          {"max", values.empty() ? 0.0 : rounded(*std::max_element(values.begin(), values.end()))}};
}

json source_json(const ClipRecord& record) {
  json out{{"path", record.source_path}};
  if (!record.source_clip.empty()) out["clip"] = record.source_clip;
  if (!record.source_sha256.empty()) out["sha256"] = record.source_sha256;
  if (record.source) {
    const SourceFacts& facts = *record.source;
    out["format"] = facts.format;
    out["reader"] = facts.reader;
    if (!facts.reader_reason.empty()) out["reader_reason"] = facts.reader_reason;
    if (!record.convention.empty()) out["convention"] = record.convention;
    out["unit_m"] = facts.unit_m;
    out["unit_evidence"] = facts.unit_evidence;
    out["up"] = facts.up;
    out["rate_hz"] = facts.rate_hz;
    out["frames"] = facts.frames;
    out["joints"] = facts.joints;
  }
  if (record.source_calibration) {
    out["calibration"] = {{"reference", record.source_calibration->reference},
                          {"residual_deg", rounded(record.source_calibration->residual_deg)}};
  }
  return out;
}

json target_json(const Target& target) {
  return {{"path", target.path},
          {"sha256", target.sha256},
          {"rig", target.rig.name},
          {"joints", target.rig.size()},
          {"dof", dof_count(target.rig)},
          {"calibration",
           {{"reference", target.calibration.reference},
            {"residual_deg", rounded(target.calibration.residual_deg)}}}};
}

std::vector<std::string> names_of(const std::vector<std::int32_t>& joints,
                                  const Skeleton& skeleton) {
  std::vector<std::string> out;
  for (const std::int32_t j : joints) out.push_back(skeleton.names[j]);
  return out;
}

/// Chains of both figures, paired by name.
json chains_json(const Skeleton* source, const Figure* from, const Skeleton& target,
                 const Figure& to) {
  json out = json::array();
  for (const FigureChain& chain : to.chains) {
    json entry{{"name", chain.name},
               {"source", json::array()},
               {"target", names_of(chain.joints, target)}};
    double confidence = 0.0;
    if (from != nullptr) {
      for (const FigureChain& other : from->chains) {
        if (other.name != chain.name) continue;
        entry["source"] = names_of(other.joints, *source);
        confidence = std::min(chain.confidence, other.confidence);
      }
    }
    entry["confidence"] = rounded(confidence);
    out.push_back(std::move(entry));
  }
  return out;
}

json roles_json(const Skeleton& skeleton, const Figure& figure) {
  json out = json::object();
  for (int r = 0; r < kRoleCount; ++r) {
    if (figure.joint[r] != kNoJoint) {
      out[std::string(name_of(role_at(r)))] = skeleton.names[figure.joint[r]];
    }
  }
  return out;
}

json effectors_json(const Retargeted& result) {
  json out = json::array();
  for (const EffectorError& error : result.errors) {
    json entry{{"name", error.name}, {"reachable_frames", error.reachable_frames}};
    if (!error.position_mm.empty()) entry["position_error_mm"] = figures(error.position_mm);
    if (!error.orientation_deg.empty()) {
      entry["orientation_error_deg"] = figures(error.orientation_deg);
    }
    out.push_back(std::move(entry));
  }
  return out;
}

json limits_json(const ClipRecord& record) {
  const FileCheck worst = worst_of(record.checks);
  json bent = json::array();
  for (const BentJoint& joint : record.result->bent) {
    bent.push_back({{"joint", joint.joint},
                    {"frames", joint.excess.frames},
                    {"max_deg", rounded(joint.excess.max_deg)},
                    {"frames_by_excess", joint.excess.frames_by_excess}});
  }
  json at_limit = json::array();
  for (const JointAtLimit& joint : record.result->at_limit) {
    at_limit.push_back({{"joint", joint.joint}, {"frames", joint.frames}});
  }
  return {{"joints", worst.limited_joints},
          {"violations", worst.violations},
          {"max_violation_deg", rounded(worst.max_violation_deg)},
          {"source_excess_deg", rounded(record.result->source_excess_deg)},
          {"excess_edges_deg", kExcessEdgesDeg},
          {"bent", bent},
          {"at_limit", at_limit}};
}

json contacts_json(const MotionMetrics& metrics) {
  const auto side = [](const ContactFigures& figures) {
    return json{{"slide_cm_s", rounded(figures.slide_cm_s)},
                {"drift_cm", rounded(figures.drift_cm)},
                {"penetration_cm", rounded(figures.penetration_cm)}};
  };
  return {{"source", side(metrics.source)},
          {"output", side(metrics.output)},
          {"excess", side(less(metrics.output, metrics.source))},
          {"intervals", metrics.intervals}};
}

json cycle_json(const CycleFigures& cycle) {
  return {{"period_frames", cycle.period},
          {"last_frame_repeats_first", cycle.repeats_first},
          {"lap", {{"way_m", rounded(cycle.way_m)}, {"turn_deg", rounded(cycle.turn_deg)}}},
          {"seam", {{"turn_deg", rounded(cycle.seam_deg)}, {"height_mm", rounded(cycle.seam_mm)}}}};
}

json self_contacts_json(const SelfContactFigures& figures) {
  const auto largest_cm = [](const std::vector<double>& depth_m) {
    return depth_m.empty() ? 0.0 : rounded(1e2 * *std::ranges::max_element(depth_m));
  };
  return {{"pressed_frames", figures.pressed_frames()},
          {"depth_before_cm", largest_cm(figures.before_m)},
          {"depth_cm", largest_cm(figures.left_m)}};
}

json certificate_json(const std::vector<FileCheck>& checks) {
  json files = json::array();
  const FileCheck worst = worst_of(checks);
  for (const FileCheck& check : checks) {
    json entry{{"path", check.path}, {"reader", check.reader}};
    if (!check.reason.empty()) entry["reason"] = check.reason;
    entry["joints_max_error_m"] = check.joints_max_error_m;
    entry["violations"] = check.violations;
    entry["ok"] = check.ok;
    if (!check.faults.empty()) entry["faults"] = check.faults;
    files.push_back(std::move(entry));
  }
  json out{{"reader", checks.empty() ? "" : checks.front().reader}};
  if (!checks.empty() && !checks.front().reason.empty()) out["reason"] = checks.front().reason;
  out["joints_max_error_m"] = worst.joints_max_error_m;
  out["ok"] = worst.ok;
  out["files"] = files;
  return out;
}

/// The largest value of each of `samples` equal stretches of a clip.
template <class T>
json sampled_maxima(const std::vector<T>& values, std::size_t samples) {
  json out = json::array();
  for (std::size_t i = 0; i < samples; ++i) {
    const auto begin = values.begin() + std::ptrdiff_t(i * values.size() / samples);
    const auto end = values.begin() + std::ptrdiff_t((i + 1) * values.size() / samples);
    const auto largest = *std::max_element(begin, end);
    if constexpr (std::is_floating_point_v<T>) {
      out.push_back(std::round(largest * 1e2) / 1e2);
    } else {
      out.push_back(largest);
    }
  }
  return out;
}

/// What happens when, in few enough samples to be plotted: a peak of one frame stays visible.
json timeline_json(const Retargeted& result) {
  constexpr std::size_t kMostSamples = 96;
  const std::size_t samples =
      std::min(kMostSamples, static_cast<std::size_t>(result.clip.frames()));
  json out{{"samples", samples}};
  const auto add = [&](const char* name, const auto& values) {
    if (values.size() >= samples && samples > 0) out[name] = sampled_maxima(values, samples);
  };
  add("error_mm", result.worst_error_mm);
  add("source_excess_deg", result.frame_excess_deg);
  add("joints_at_limit", result.frame_joints_at_limit);
  add("left_contact", result.track.left_contact);
  add("right_contact", result.track.right_contact);
  return out;
}

json cost_json(const ClipCost& cost) {
  return {{"effectors", rounded(cost.effectors)},
          {"contacts", rounded(cost.contacts)},
          {"smoothness", rounded(cost.smoothness)},
          {"total", rounded(cost.total())}};
}

json refine_json(const RefineFigures& refine) {
  json out{{"mode", refine.clip ? "clip" : "frame"},
           {"gap_percent",
            {{"median", rounded(percentile(refine.gap_percent, 50.0))},
             {"p95", rounded(percentile(refine.gap_percent, 95.0))}}},
           {"frames", refine.frames.size()}};
  if (!refine.clip) return out;
  const ClipRefineReport& report = refine.clip->report;
  const MotionMetrics &before = refine.clip->before, &after = refine.clip->after;
  out["clip"] = {
      {"improved", report.improved},
      {"windows", report.windows},
      {"iterations", report.iterations},
      {"cost", {{"before", cost_json(report.before)}, {"after", cost_json(report.after)}}},
      {"jerk_p99_m_s3",
       {{"source", rounded(before.jerk_p99_source)},
        {"before", rounded(before.jerk_p99_output)},
        {"after", rounded(after.jerk_p99_output)}}},
      {"slide_cm_s",
       {{"source", rounded(before.source.slide_cm_s)},
        {"before", rounded(before.output.slide_cm_s)},
        {"after", rounded(after.output.slide_cm_s)}}}};
  return out;
}

void add_result(json& out, const ClipRecord& record) {
  const Retargeted& result = *record.result;
  json files = json::array();
  for (const OutputFile& file : record.files) {
    files.push_back({{"path", file.path}, {"sha256", file.sha256}, {"bytes", file.bytes}});
  }
  out["output"] = {{"files", files},
                   {"frames", result.clip.frames()},
                   {"rate_hz", result.clip.rate_hz},
                   {"duration_s", rounded(result.clip.duration_s())},
                   {"scale", rounded(result.track.scale)}};
  out["solver"] = {{"name", result.solver.name},
                   {"relinearisations",
                    {{"median", percentile(result.solver.relinearisations, 50.0)},
                     {"p99", percentile(result.solver.relinearisations, 99.0)}}},
                   {"tree_passes", result.solver.tree_passes},
                   {"sweeps", result.solver.sweeps},
                   {"residual_max", result.solver.residual_max}};
  if (result.cycle) out["cycle"] = cycle_json(*result.cycle);
  out["effectors"] = effectors_json(result);
  if (!record.checks.empty()) out["limits"] = limits_json(record);
  if (record.metrics) {
    if (!record.metrics->feet.empty()) out["contacts"] = contacts_json(*record.metrics);
    if (result.self_contacts.measured) {
      out["self_contacts"] = self_contacts_json(result.self_contacts);
    }
    out["smoothness"] = {
        {"jerk_ratio", rounded(record.metrics->jerk_ratio)},
        {"max_angular_velocity_ratio", rounded(record.metrics->max_angular_velocity_ratio)},
        {"jerk_p99_m_s3",
         {{"source", rounded(record.metrics->jerk_p99_source)},
          {"output", rounded(record.metrics->jerk_p99_output)}}},
        {"pops", record.metrics->pops}};
  }
  if (!result.refine.frames.empty() || result.refine.clip)
    out["refine"] = refine_json(result.refine);
  if (!record.checks.empty()) out["certificate"] = certificate_json(record.checks);
  if (!record.gates.empty()) out["gates"] = json::parse(to_json(record.gates));
  out["timeline"] = timeline_json(result);
}

}  // namespace

FileCheck worst_of(const std::vector<FileCheck>& checks) {
  FileCheck worst;
  worst.ok = !checks.empty();
  for (const FileCheck& check : checks) {
    worst.ok = worst.ok && check.ok;
    worst.joints_max_error_m = std::max(worst.joints_max_error_m, check.joints_max_error_m);
    worst.limited_joints = std::max(worst.limited_joints, check.limited_joints);
    worst.violations = std::max(worst.violations, check.violations);
    worst.max_violation_deg = std::max(worst.max_violation_deg, check.max_violation_deg);
  }
  return worst;
}

const char* to_string(Status status) {
  switch (status) {
    case Status::pass:
      return "pass";
    case Status::warn:
      return "warn";
    case Status::fail:
      return "fail";
  }
  return "";
}

std::string report_json(const ClipRecord& record) {
  json out{{"schema", "limber-report/1"},
           {"limber_version", kVersion},
           {"status", to_string(record.status)},
           {"errors", json::array()},
           {"warnings", json::array()}};
  for (const Error& error : record.errors) out["errors"].push_back(error_json(error));
  for (const Warning& warning : record.warnings) out["warnings"].push_back(warning_json(warning));
  out["source"] = source_json(record);
  if (record.target != nullptr) out["target"] = target_json(*record.target);
  if (record.source_figure && record.target != nullptr && record.source_skeleton != nullptr) {
    out["map"] = {
        {"confidence",
         rounded(std::min(record.source_figure->confidence, record.target->figure.confidence))},
        {"chains", chains_json(record.source_skeleton, &*record.source_figure,
                               record.target->character.skeleton, record.target->figure)}};
  }
  if (record.result) add_result(out, record);
  return out.dump(2, ' ', false, json::error_handler_t::replace) + "\n";
}

std::string map_json(const MapSide& source, const MapSide& target) {
  json out{{"format", "limber-map/1"}};
  const auto side = [](const MapSide& s) {
    json entry{{"path", s.path}};
    if (s.figure != nullptr) {
      entry["convention"] = s.figure->convention;
      entry["confidence"] = rounded(s.figure->confidence);
      entry["roles"] = roles_json(s.character->skeleton, *s.figure);
    } else {
      entry["roles"] = json::object();
    }
    if (s.character != nullptr) entry["joints"] = s.character->skeleton.names;
    return entry;
  };
  out["source"] = side(source);
  out["target"] = side(target);
  if (target.figure != nullptr) {
    out["chains"] = chains_json(source.character == nullptr ? nullptr : &source.character->skeleton,
                                source.figure, target.character->skeleton, *target.figure);
  }
  return out.dump(2, ' ', false, json::error_handler_t::replace) + "\n";
}

}  // namespace limber
