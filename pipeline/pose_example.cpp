#include <algorithm>
#include <nlohmann/json.hpp>

#include "pipeline/pose_command.h"

namespace limber {
namespace {

constexpr double kStep = 0.15;  // of the rig's size

/// Distance of the farthest joint or effector from the root, at rest.
double size_of(const Rig& rig, std::span<const DualQuaternion> world) {
  double size = 0.0;
  const Eigen::Vector3d root = world[0].translation();
  for (const DualQuaternion& joint : world) {
    size = std::max(size, (joint.translation() - root).norm());
  }
  for (const RigEffector& e : rig.effectors) {
    size = std::max(size, (world[e.joint].transform_point(e.offset) - root).norm());
  }
  return size;
}

bool can_move(const RigEffector& effector) {
  return effector.kind == EffectorKind::pose || effector.kind == EffectorKind::position;
}

/// The effector to play with: the strong one at the end of the longest chain.
const RigEffector* tip_of(const Rig& rig) {
  const auto depth = [&](const RigEffector& effector) {
    int joints = 0;
    for (std::int32_t j = effector.joint; j != kNoJoint; j = rig.joints[j].parent) ++joints;
    return joints + (effector.strong ? rig.size() : 0);
  };
  const RigEffector* tip = nullptr;
  for (const RigEffector& effector : rig.effectors) {
    if (can_move(effector) && (tip == nullptr || depth(effector) > depth(*tip))) tip = &effector;
  }
  return tip;
}

}  // namespace

std::string example_targets(const Rig& rig) {
  using json = nlohmann::ordered_json;
  std::vector<DualQuaternion> world(rig.joints.size());
  const Skeleton skeleton = skeleton_of(rig);
  model_from_local(skeleton, skeleton.rest_parent_from_joint, world);
  const double step = std::max(1e-3, std::round(1e3 * kStep * size_of(rig, world)) * 1e-3);
  json hold = json::array();
  for (const RigEffector& effector : rig.effectors) {
    if (effector.strong) hold.push_back(effector.name);
  }
  if (hold.empty()) hold.push_back(rig.effectors.front().name);
  json poses = json::array({{{"name", "as at rest"}, {"targets", json::array()}}});
  if (const RigEffector* tip = tip_of(rig)) {
    json row{{"effector", tip->name}, {"offset", {0.0, -0.5 * step, -0.5 * step}}};
    poses.push_back({{"name", tip->name + " moved"}, {"targets", json::array({row})}});
    if (tip->kind == EffectorKind::pose) {
      row["turn_deg"] = {0.0, 0.0, 30.0};
      poses.push_back({{"name", tip->name + " moved and turned"},
                       {"start", "previous"},
                       {"targets", json::array({row})}});
    }
    const Eigen::Vector3d point = world[tip->joint].transform_point(tip->offset);
    const Eigen::Vector3d far = point + Eigen::Vector3d(0.0, 2.0 * step, 0.0);
    row = {{"effector", tip->name}, {"position", {far.x(), far.y(), far.z()}}, {"weight", 2.0}};
    poses.push_back({{"name", "too far for " + tip->name}, {"targets", json::array({row})}});
  }
  const json document{
      {"format", "limber/targets/1"},
      {"description",
       "Metres, +Y up. 'hold' keeps effectors where they are at rest, unless a pose names them. "
       "'offset' and 'turn_deg' (a rotation vector) count from rest; 'position' and 'rotation' "
       "(w, x, y, z) are world. What is left out is free."},
      {"hold", hold},
      {"poses", poses}};
  return document.dump(1);
}

}  // namespace limber
