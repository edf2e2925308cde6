#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "pipeline/pose_command.h"

namespace limber {
namespace {

constexpr double kPull = 0.15;   // towards the limb's base, of its length
constexpr double kTooFar = 0.5;  // away from it
constexpr double kBend = 0.4;    // of a joint's range
constexpr int kLimbJoints = 4;   // at most

/// An effector to play with, and the joints between it and the next one that is held.
struct Limb {
  const RigEffector* tip = nullptr;
  std::vector<std::int32_t> joints;  // tip first
};

bool can_move(const RigEffector& effector) {
  return effector.kind == EffectorKind::pose || effector.kind == EffectorKind::position;
}

int depth_of(const Rig& rig, const RigEffector& effector) {
  int joints = effector.strong ? rig.size() : 0;  // strong ones first
  for (std::int32_t j = effector.joint; j != kNoJoint; j = rig.joints[j].parent) ++joints;
  return joints;
}

/// The limb of the strong effector at the end of the longest chain.
Limb limb_of(const Rig& rig) {
  Limb limb;
  for (const RigEffector& effector : rig.effectors) {
    if (!can_move(effector)) continue;
    if (limb.tip == nullptr || depth_of(rig, effector) > depth_of(rig, *limb.tip)) {
      limb.tip = &effector;
    }
  }
  if (limb.tip == nullptr) return limb;
  const auto held = [&](std::int32_t joint) {
    return std::any_of(rig.effectors.begin(), rig.effectors.end(),
                       [&](const RigEffector& e) { return e.strong && e.joint == joint; });
  };
  std::int32_t joint = limb.tip->joint;
  do {
    limb.joints.push_back(joint);
    joint = rig.joints[joint].parent;
  } while (joint != kNoJoint && !held(joint) && limb.joints.size() < kLimbJoints);
  return limb;
}

using json = nlohmann::ordered_json;

/// Hinges and universal joints bent into their ranges, in whole degrees.
json bent(const Rig& rig, const Limb& limb) {
  json posture = json::object();
  for (const std::int32_t j : limb.joints) {
    const RigJoint& joint = rig.joints[j];
    if (joint.type != JointType::hinge && joint.type != JointType::universal) continue;
    json degrees = json::array();
    for (std::int32_t k = 0; k < dof_count(joint.type); ++k) {
      const Range& range = joint.limits[k];
      const double angle = joint.limited() ? range.min + kBend * (range.max - range.min) : kBend;
      degrees.push_back(std::round(angle * 180.0 / M_PI));
    }
    posture[joint.name] = degrees;
  }
  return posture;
}

json in_mm(const Eigen::Vector3d& v) {
  const auto rounded = [](double x) { return std::round(1e3 * x) / 1e3; };
  return {rounded(v.x()), rounded(v.y()), rounded(v.z())};
}

json example_poses(const Rig& rig) {
  json poses = json::array({{{"name", "as at rest"}, {"targets", json::array()}}});
  const Limb limb = limb_of(rig);
  if (limb.tip == nullptr) return poses;
  std::vector<DualQuaternion> world(rig.joints.size());
  const Skeleton skeleton = skeleton_of(rig);
  model_from_local(skeleton, skeleton.rest_parent_from_joint, world);
  const Eigen::Vector3d tip = world[limb.tip->joint].transform_point(limb.tip->offset);
  const Eigen::Vector3d reach = tip - world[limb.joints.back()].translation();

  const std::string& name = limb.tip->name;
  const auto row = [&](const char* key, const Eigen::Vector3d& v) {
    return json{{"effector", name}, {key, in_mm(v)}};
  };
  if (const json posture = bent(rig, limb); !posture.empty()) {
    poses.push_back({{"name", name + " where a posture puts it"}, {"posture", posture}});
  }
  poses.push_back({{"name", name + " pulled in, turning freely"},
                   {"targets", json::array({row("offset", -kPull * reach)})}});
  json far = row("position", tip + kTooFar * reach);
  if (limb.tip->kind == EffectorKind::pose) far["turn_deg"] = {0.0, 0.0, 30.0};
  far["weight"] = 2.0;
  poses.push_back(
      {{"name", name + " pulled too far"}, {"start", "previous"}, {"targets", json::array({far})}});
  return poses;
}

}  // namespace

std::string example_targets(const Rig& rig) {
  json hold = json::array();
  for (const RigEffector& effector : rig.effectors) {
    if (effector.strong) hold.push_back(effector.name);
  }
  if (hold.empty()) hold.push_back(rig.effectors.front().name);
  const json document{
      {"format", "limber/targets/1"},
      {"description",
       "Metres, +Y up. 'hold' keeps effectors where they stand at rest, or in a pose's 'posture' "
       "(joint angles, degrees), unless a target names them. 'offset' and 'turn_deg' (a rotation "
       "vector) count from there; 'position' and 'rotation' (w, x, y, z) are in world space. What "
       "is left out is free."},
      {"hold", hold},
      {"poses", example_poses(rig)}};
  return document.dump(1);
}

}  // namespace limber
