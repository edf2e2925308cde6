#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "assets/model/character.h"
#include "assets/model/result.h"
#include "pipeline/humanoid.h"

namespace limber {

/// A run of joints that means one thing on every figure (spine, leftArm, rightIndex, ...).
struct FigureChain {
  std::string name;
  std::vector<std::int32_t> joints;  ///< towards the tip
  double confidence = 0.0;           ///< 0 nothing found .. 1 every joint known by its name
};

/// A skeleton understood as a human body or a hand.
struct Figure {
  std::array<std::int32_t, kRoleCount> joint;  ///< by role; kNoJoint where the figure has none
  /// From the joint the file calls hips down to the one that carries both thighs, which has the
  /// role; one joint on most figures. They turn as one, and the first has the body's place.
  std::vector<std::int32_t> pelvis;
  std::vector<std::int32_t> spine;  ///< above the pelvis up to the joint that carries the arms
  std::vector<std::int32_t> neck;   ///< above the spine, below the head
  /// The hierarchy that moves: the skeleton's own, except that hands whose joints are all siblings
  /// (WebXR) get their fingers' chains.
  std::vector<std::int32_t> parents;
  std::vector<std::int32_t> order;  ///< every joint once, parents (of `parents`) first
  std::string convention;           ///< the naming convention's name, or "topology"
  std::vector<FigureChain> chains;
  double confidence = 0.0;

  Figure() { joint.fill(kNoJoint); }
  std::int32_t at(Role role) const { return joint[index_of(role)]; }
  bool has(Role role) const { return at(role) != kNoJoint; }
  bool is_body() const {
    return has(Role::hips) && has(Role::leftUpperLeg) && has(Role::rightUpperLeg);
  }
  /// True for a hand without a body.
  bool is_hand() const { return !is_body() && (has(Role::leftHand) || has(Role::rightHand)); }
  bool has_fingers(Side) const;
  /// The side of a lone hand; the right one where there are two.
  Side hand_side() const { return has(Role::rightHand) ? Side::right : Side::left; }
  /// The joint the whole figure hangs on: the pelvis's first, or the hand of a lone hand.
  std::int32_t root() const;
};

/// Roles given by hand (a map file): role name to joint name; "" removes a role.
using RoleOverrides = std::map<std::string, std::string>;

/// Finds out which joint is what: the file's own humanoid map first, then whole naming conventions
/// (never single aliases: they collide), then topology and geometry for joints without known names.
/// Errors: `map-not-a-figure`, `map-unknown-joint`.
Result<Figure> identify_figure(const Character&, const RoleOverrides& = {});

/// The role of each joint, or none.
std::vector<std::optional<Role>> roles_by_joint(const Figure&, std::int32_t joint_count);

}  // namespace limber
