#pragma once

#include <cstdint>
#include <string>

#include "pipeline/retarget.h"

namespace limber {

/// One frame of a retargeted clip as a task of its own: `limber pose RIG --targets TARGETS` solves
/// it alone, from rest, and compares with Ceres.
struct FrameReplay {
  std::string rig;      ///< `ikrig/1`, with the clip's effectors
  std::string targets;  ///< `limber/targets/1`
};
FrameReplay replay_of(const Retargeted&, std::int64_t frame);

}  // namespace limber
