#pragma once

#include <cstddef>
#include <span>
#include <string>

#include "pipeline/clip_record.h"
#include "pipeline/isolated.h"

namespace limber {

/// Reads a written file back with the reader that did not write it (assimp; ours in a process of
/// its own where assimp is known to break or fails) and checks it against what was meant: joint
/// positions and rotations, frames, rate, bone lengths, and every joint's limits.
FileCheck certify(std::span<const std::byte> bytes, const std::string& format, const Target&,
                  const Retargeted&, bool limits, SandboxMode);

}  // namespace limber
