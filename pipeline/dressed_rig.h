#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "assets/model/character.h"
#include "assets/model/rig.h"

namespace limber {

/// A rig with its effectors, and the figure that wears it: a rig's mannequin, or a character with
/// the rig of its anatomical limits.
struct DressedRig {
  Rig rig;
  Character character;                     ///< roles are the rig's
  std::vector<std::int32_t> joint_of_row;  ///< [rig joint] joint of the character's skeleton
};

/// RIG as commands take it: a shipped rig's name, a rig JSON, or a character of any format.
Result<DressedRig> dressed_rig(const std::string& name_or_path);

}  // namespace limber
