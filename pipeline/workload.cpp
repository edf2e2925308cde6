#include "pipeline/workload.h"

#include <fmt/format.h>
#include <zlib.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <optional>

#include "importers/rig_json.h"

namespace limber {

namespace {

constexpr int kRestartsOfLonePoses = 64;  // sporadic sets: no frame follows from another

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

}  // namespace

Result<Workload> read_workload(const std::filesystem::path& path) {
  const std::optional<std::string> text = read_text(path);
  if (!text) return workload_error("the file cannot be read");
  try {
    return parse_workload(nlohmann::json::parse(*text));
  } catch (const nlohmann::json::exception& fault) {
    return workload_error(fault.what());
  }
}

IkOptions options_for(const Workload& work, IkMethod method) {
  IkOptions options;
  options.method = method;
  options.stop_position_m = work.stop_pos;
  options.stop_orientation_rad = work.stop_rot;
  options.measure_residual = false;
  options.unwind = !work.rest_start;
  options.restarts = work.rest_start ? kRestartsOfLonePoses : 0;
  return options;
}

EffectorMiss worst_miss(const Rig& rig, std::span<const EffectorTarget> targets,
                        std::span<const DualQuaternion> world_from_joint) {
  EffectorMiss worst;
  for (std::size_t e = 0; e < rig.effectors.size(); ++e) {
    const RigEffector& effector = rig.effectors[e];
    if (!effector.strong) continue;
    const DualQuaternion& joint = world_from_joint[effector.joint];
    const Eigen::Vector3d miss =
        targets[e].pose.translation() - joint.transform_point(effector.offset);
    if (effector.weight_pos > 0.0 && effector.kind != EffectorKind::orientation) {
      worst.position_mm = std::max(worst.position_mm, 1e3 * miss.norm());
    }
    if (effector.weight_rot > 0.0 && effector.kind != EffectorKind::position) {
      const double angle = rotation_angle(targets[e].pose.rotation(), joint.rotation());
      worst.orientation_deg = std::max(worst.orientation_deg, angle * 180.0 / M_PI);
    }
  }
  return worst;
}

}  // namespace limber
