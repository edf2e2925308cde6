#pragma once

#include <optional>

#include "pipeline/figure.h"

namespace limber {

/// Finds a body in a skeleton without known names, from its hierarchy and its bind (or rest) pose:
/// two mirrored chains that reach the ground are the legs, two that leave the trunk above them and
/// reach out sideways are the arms, the highest end is the head. Fills `joint` alone.
std::optional<Figure> identify_by_topology(const Character&);

}  // namespace limber
