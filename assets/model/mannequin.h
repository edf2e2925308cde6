#pragma once

#include "assets/model/character.h"
#include "assets/model/rig.h"

namespace limber {

/// A skinned figure made of the rig's capsules, so that any rig can be exported and drawn. Joints
/// without capsules get one along the bone to each child. The rest pose is q = 0; +Z is forward.
Character mannequin(const Rig&);

}  // namespace limber
