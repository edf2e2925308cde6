#pragma once

#include <cstdint>

#include "assets/model/result.h"
#include "validation/clip_problem.h"

namespace limber {

struct ClipRefineOptions {
  ClipWeights weights{};
  std::int64_t window = 160;  ///< frames that are solved at once,
  std::int64_t overlap = 24;  ///< and how many of them once more with the next window
  int rounds = 4;             ///< in each of which bounds are held or let go anew
  int iterations = 8;         ///< per round, at most
  double enough = 1e-2;       ///< relative fall of a window's cost per round that still counts
};

struct ClipRefineReport {
  ClipCost before, after;
  bool improved = false;  ///< false: the clip was left as it was
  std::int64_t windows = 0, iterations = 0;
};

/// Replaces a solved clip (on the rig's joints) by the optimum of the whole clip, found by Ceres
/// from there: effectors, standing feet, smoothness (clip_problem.cpp), within limits. Never worse
/// than it was by that objective. Joints that carry no effector and stand above none stay as they
/// are. Time and memory are linear in the frames; one thread, the same bytes on every run.
/// Errors: `refine-input`, `refine-rows` as refine_with_ceres.
Result<ClipRefineReport> refine_clip_with_ceres(const Rig&, const ClipGoals&, Clip&,
                                                const ClipRefineOptions& = {});

}  // namespace limber
