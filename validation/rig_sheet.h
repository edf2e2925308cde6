#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "assets/model/character.h"
#include "assets/model/rig.h"
#include "validation/contact_sheet.h"

namespace limber {

struct RigSheet {
  std::string title, description;  ///< cut where too long
  const Rig* rig = nullptr;
  const Character* character = nullptr;           ///< that wears the rig
  std::vector<std::int32_t> joint_of_row;         ///< [rig joint] of the character's skeleton
  std::vector<DualQuaternion> parent_from_joint;  ///< the skeleton at q = 0
};

/// The space that one joint's bone may take, from its limits alone, in the joint's space at q = 0.
struct LimitShape {
  /// Unit directions of the bone on the border of its swing: a ball's ellipse and a universal
  /// joint's box close, a hinge's arc does not. Empty where only the twist is free.
  std::vector<Eigen::Vector3d> border;
  bool closed = false;
  Range twist{0.0, 0.0};  ///< about the bone, rad
};
/// `bone` is the unit direction of the bone in the joint's space. Nothing for unlimited joints.
LimitShape limit_shape(const RigJoint&, const Eigen::Vector3d& bone);

/// Draws the figure at q = 0 from the front and from the side with each limited joint's cone or
/// arc, and its ranges in degrees. Same input, same pixels. Error: `sheet-input`.
Result<Image> render_rig_sheet(const RigSheet&);

}  // namespace limber
