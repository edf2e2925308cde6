#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string_view>

namespace limber {

/// The joints of a human figure by their VRM 1.0 humanoid names (VRMC_vrm-1.0, humanoid.md).
/// Each side's block has the same order, the left block first.
enum class Role : std::uint8_t {
  // clang-format off
  hips, spine, chest, upperChest, neck, head, leftEye, rightEye, jaw,
  leftUpperLeg, leftLowerLeg, leftFoot, leftToes,
  leftShoulder, leftUpperArm, leftLowerArm, leftHand,
  leftThumbMetacarpal, leftThumbProximal, leftThumbDistal,
  leftIndexProximal, leftIndexIntermediate, leftIndexDistal,
  leftMiddleProximal, leftMiddleIntermediate, leftMiddleDistal,
  leftRingProximal, leftRingIntermediate, leftRingDistal,
  leftLittleProximal, leftLittleIntermediate, leftLittleDistal,
  rightUpperLeg, rightLowerLeg, rightFoot, rightToes,
  rightShoulder, rightUpperArm, rightLowerArm, rightHand,
  rightThumbMetacarpal, rightThumbProximal, rightThumbDistal,
  rightIndexProximal, rightIndexIntermediate, rightIndexDistal,
  rightMiddleProximal, rightMiddleIntermediate, rightMiddleDistal,
  rightRingProximal, rightRingIntermediate, rightRingDistal,
  rightLittleProximal, rightLittleIntermediate, rightLittleDistal,
  // clang-format on
};
inline constexpr int kRoleCount = 55;
inline constexpr int kFirstLeft = static_cast<int>(Role::leftUpperLeg);
inline constexpr int kFirstRight = static_cast<int>(Role::rightUpperLeg);

enum class Side : std::uint8_t { middle, left, right };

constexpr int index_of(Role role) { return static_cast<int>(role); }
constexpr Role role_at(int index) { return static_cast<Role>(index); }

std::string_view name_of(Role);
std::optional<Role> role_named(std::string_view name);

constexpr Side side_of(Role role) {
  if (role == Role::leftEye) return Side::left;
  if (role == Role::rightEye) return Side::right;
  if (index_of(role) < kFirstLeft) return Side::middle;
  return index_of(role) < kFirstRight ? Side::left : Side::right;
}

/// The same joint of the other side; the midline stays.
constexpr Role mirrored(Role role) {
  if (role == Role::leftEye) return Role::rightEye;
  if (role == Role::rightEye) return Role::leftEye;
  constexpr int block = kFirstRight - kFirstLeft;
  if (side_of(role) == Side::left) return role_at(index_of(role) + block);
  if (side_of(role) == Side::right) return role_at(index_of(role) - block);
  return role;
}

/// `left` on the given side (left or right).
constexpr Role on_side(Role left, Side side) { return side == Side::right ? mirrored(left) : left; }

/// The next joint towards the hips; none for the hips.
std::optional<Role> parent_of(Role);

constexpr bool is_finger(Role role) {
  const Role left = side_of(role) == Side::right ? mirrored(role) : role;
  return left >= Role::leftThumbMetacarpal && left <= Role::leftLittleDistal;
}
constexpr bool is_thumb(Role role) {
  const Role left = side_of(role) == Side::right ? mirrored(role) : role;
  return left >= Role::leftThumbMetacarpal && left <= Role::leftThumbDistal;
}

/// The first joints of index, middle, ring and little finger of the left hand.
inline constexpr std::array<Role, 4> kLeftKnuckles = {
    Role::leftIndexProximal, Role::leftMiddleProximal, Role::leftRingProximal,
    Role::leftLittleProximal};

/// The 15 joints that VRM 1.0 requires of a body.
bool is_required(Role);

}  // namespace limber
