#pragma once

#include "pipeline/effectors.h"
#include "pipeline/target.h"
#include "validation/clip_refiner.h"
#include "validation/motion_metrics.h"

namespace limber {

/// What refining a clip did to it. Motion is measured against the source, before parts are pushed
/// apart and frames are cut.
struct ClipRefinement {
  ClipRefineReport report;
  MotionMetrics before, after;
};

/// Replaces a solved clip on the rows of `rig`, whose effectors are the track's, by the optimum of
/// the whole clip (validation/clip_refiner.h). What stands in the source stands in it.
Result<ClipRefinement> refine_clip(const SourceMotion&, const Target&, const Rig&,
                                   const EffectorTrack&, Clip& clip);

/// A clip on the rig's rows as one on the target's skeleton.
Clip clip_on_skeleton(const Target&, const Clip& rig_clip);

}  // namespace limber
