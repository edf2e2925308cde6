#include "pipeline/humanoid.h"

namespace limber {
namespace {

constexpr std::array<std::string_view, kRoleCount> kNames = {
    // clang-format off
    "hips", "spine", "chest", "upperChest", "neck", "head", "leftEye", "rightEye", "jaw",
    "leftUpperLeg", "leftLowerLeg", "leftFoot", "leftToes",
    "leftShoulder", "leftUpperArm", "leftLowerArm", "leftHand",
    "leftThumbMetacarpal", "leftThumbProximal", "leftThumbDistal",
    "leftIndexProximal", "leftIndexIntermediate", "leftIndexDistal",
    "leftMiddleProximal", "leftMiddleIntermediate", "leftMiddleDistal",
    "leftRingProximal", "leftRingIntermediate", "leftRingDistal",
    "leftLittleProximal", "leftLittleIntermediate", "leftLittleDistal",
    "rightUpperLeg", "rightLowerLeg", "rightFoot", "rightToes",
    "rightShoulder", "rightUpperArm", "rightLowerArm", "rightHand",
    "rightThumbMetacarpal", "rightThumbProximal", "rightThumbDistal",
    "rightIndexProximal", "rightIndexIntermediate", "rightIndexDistal",
    "rightMiddleProximal", "rightMiddleIntermediate", "rightMiddleDistal",
    "rightRingProximal", "rightRingIntermediate", "rightRingDistal",
    "rightLittleProximal", "rightLittleIntermediate", "rightLittleDistal",
    // clang-format on
};

}  // namespace

std::string_view name_of(Role role) { return kNames[index_of(role)]; }

std::optional<Role> role_named(std::string_view name) {
  for (int i = 0; i < kRoleCount; ++i) {
    if (kNames[i] == name) return role_at(i);
  }
  return std::nullopt;
}

std::optional<Role> parent_of(Role role) {
  if (side_of(role) == Side::right && role != Role::rightEye) {
    const std::optional<Role> parent = parent_of(mirrored(role));
    return parent ? std::optional(mirrored(*parent)) : std::nullopt;
  }
  switch (role) {
    case Role::hips:
      return std::nullopt;
    case Role::leftEye:
    case Role::rightEye:
    case Role::jaw:
      return Role::head;
    case Role::leftUpperLeg:
      return Role::hips;
    case Role::leftShoulder:
      return Role::upperChest;
    case Role::leftThumbMetacarpal:
    case Role::leftIndexProximal:
    case Role::leftMiddleProximal:
    case Role::leftRingProximal:
    case Role::leftLittleProximal:
      return Role::leftHand;
    default:
      return role_at(index_of(role) - 1);
  }
}

bool is_required(Role role) {
  if (is_finger(role)) return false;
  switch (side_of(role) == Side::right ? mirrored(role) : role) {
    case Role::hips:
    case Role::spine:
    case Role::head:
    case Role::leftUpperLeg:
    case Role::leftLowerLeg:
    case Role::leftFoot:
    case Role::leftUpperArm:
    case Role::leftLowerArm:
    case Role::leftHand:
      return true;
    default:
      return false;
  }
}

}  // namespace limber
