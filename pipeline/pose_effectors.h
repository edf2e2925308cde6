#pragma once

#include "pipeline/dressed_rig.h"

namespace limber {

/// Gives a rig that names no effectors those of its roles, under the names of the shipped rigs:
/// pelvis, head, l_hand, r_hand, l_foot, r_foot, and the fingertips (thumb_tip, ... of a hand
/// alone; l_thumb_tip, ... of a body). All are poses of weight 1.
void add_effectors_of_roles(DressedRig&);

}  // namespace limber
