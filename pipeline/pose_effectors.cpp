#include "pipeline/pose_effectors.h"

#include <array>
#include <utility>

namespace limber {
namespace {

constexpr double kTipShare = 0.8;  // last phalanx over the one before it, where no tip is given

constexpr std::array<std::pair<const char*, const char*>, 6> kBody{{{"hips", "pelvis"},
                                                                    {"head", "head"},
                                                                    {"leftHand", "l_hand"},
                                                                    {"rightHand", "r_hand"},
                                                                    {"leftFoot", "l_foot"},
                                                                    {"rightFoot", "r_foot"}}};
constexpr std::array<std::pair<const char*, const char*>, 5> kFingers{{{"Thumb", "thumb_tip"},
                                                                       {"Index", "index_tip"},
                                                                       {"Middle", "middle_tip"},
                                                                       {"Ring", "ring_tip"},
                                                                       {"Little", "little_tip"}}};

/// Where the finger ends, in its last joint's space: at a child joint, or as far as fingers go.
Eigen::Vector3d tip_of(const DressedRig& dressed, std::int32_t row) {
  const Skeleton& skeleton = dressed.character.skeleton;
  for (std::int32_t j = 0; j < skeleton.size(); ++j) {
    if (skeleton.parents[j] == dressed.joint_of_row[row]) {
      return skeleton.rest_parent_from_joint[j].translation();
    }
  }
  const RigJoint& joint = dressed.rig.joints[row];
  return kTipShare * (joint.rest.conjugate() * joint.offset);
}

}  // namespace

void add_effectors_of_roles(DressedRig& dressed) {
  Rig& rig = dressed.rig;
  if (!rig.effectors.empty()) return;
  const auto add = [&](const std::string& role, const std::string& name, bool tip) {
    const std::int32_t row = rig.find_role(role);
    if (row == kNoJoint) return;
    RigEffector effector;
    effector.name = name;
    effector.joint = row;
    if (tip) effector.offset = tip_of(dressed, row);
    rig.effectors.push_back(std::move(effector));
  };
  const bool body = rig.find_role("hips") != kNoJoint;
  for (const auto& [role, name] : kBody) {
    if (body) add(role, name, false);
  }
  for (const char* side : {"left", "right"}) {
    for (const auto& [finger, name] : kFingers) {
      const std::string prefix = body ? std::string(1, side[0]) + "_" : "";
      add(std::string(side) + finger + "Distal", prefix + name, true);
    }
  }
}

}  // namespace limber
