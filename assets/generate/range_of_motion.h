#pragma once

#include "assets/generate/bvh_clip.h"

namespace limber::generate {

/// A body of 1.75 m, fingers included, with VRM 1.0 names, from T-pose to T-pose: neck, arms,
/// elbows and forearms, trunk, a squat and leg raises on planted feet, steps in place, fists.
MadeClip range_of_motion();

}  // namespace limber::generate
