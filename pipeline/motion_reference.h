#pragma once

#include <vector>

#include "assets/model/character.h"
#include "assets/model/clip.h"
#include "pipeline/figure.h"

namespace limber {

/// A neutral pose read from a body's motion, for files whose own poses all lie or are folded
/// (LaFAN1, Rokoko, iClone): joints stand in it as they do on average while the trunk is upright,
/// arms and legs are turned about their length so that elbows and knees bend as in the T-pose, and
/// feet as they stand. `like` is the frame whose offsets between joints are taken.
/// Model from joint, facing +Z.
std::vector<DualQuaternion> motion_reference(const Character&, const Figure&, const Clip&,
                                             std::int64_t like);

}  // namespace limber
