#include "pipeline/frame_replay.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "exporters/exporter.h"

namespace limber {

using json = nlohmann::ordered_json;

FrameReplay replay_of(const Retargeted& clip, std::int64_t frame) {
  json rows = json::array();
  const std::span<const EffectorTarget> targets = clip.track.at(frame);
  for (std::size_t e = 0; e < targets.size(); ++e) {
    const RigEffector& effector = clip.rig.effectors[e];
    const Eigen::Vector3d p = targets[e].pose.translation();
    const Eigen::Quaterniond r = targets[e].pose.rotation().normalized();
    json row{{"effector", effector.name}};
    if (effector.kind == EffectorKind::pose || effector.kind == EffectorKind::position) {
      row["position"] = {p.x(), p.y(), p.z()};
    }
    if (effector.kind != EffectorKind::position) {
      row["rotation"] = {r.w(), r.x(), r.y(), r.z()};
    }
    row["weight"] = targets[e].weight;
    rows.push_back(std::move(row));
  }
  const json file{{"format", "limber/targets/1"},
                  {"description", fmt::format("frame {} of a clip", frame)},
                  {"poses", {{{"name", fmt::format("frame {}", frame)}, {"targets", rows}}}}};
  return {.rig = write_rig_json(clip.rig), .targets = file.dump(1) + "\n"};
}

}  // namespace limber
