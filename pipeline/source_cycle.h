#pragma once

#include <cstdint>
#include <optional>

#include "assets/model/clip.h"
#include "pipeline/effectors.h"

namespace limber {

/// A clip that goes round: after `period` frames it is where it was, but for the way of a lap.
struct SourceCycle {
  std::int64_t period = 0;     ///< frames; one that repeats the first is not counted
  bool repeats_first = false;  ///< the clip's last frame is the first of the next lap
  DualQuaternion lap;          ///< world motion of a lap: a turn about +Y and a way on the floor
  double way_m = 0.0;          ///< that the pelvis goes in it, over the floor
};

/// Finds out whether a body's clip closes: every joint goes from the last frame to the first as it
/// goes from frame to frame there, or the last frame is the first once more, and in between the
/// figure went elsewhere. Nothing for clips that do not close, and for lone hands.
std::optional<SourceCycle> find_cycle(const SourceMotion&);

/// The clip with `frames` of the laps before and after it; `frames` is at most a period.
Clip with_laps(const Skeleton&, const Clip&, const SourceCycle&, std::int64_t frames);

}  // namespace limber
