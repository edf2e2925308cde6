#pragma once

#include "pipeline/effectors.h"

namespace limber {

/// Shapes the fingers of the track's guess, hand by hand, over the whole clip. Fingers are judged
/// in the palm: whatever the wrist is able to do, they close, spread and touch as in the source.
///  - Each joint turns as the source's; what lies beyond its limits is bent into them early
///    (limit_approach.h).
///  - While the thumb's tip touches a finger's, both move so that the way from one to the other is
///    the source's in the measure of the hand: a pinch touches.
/// A hand alone on a forearm that stays gets its wrist within limits first.
/// Error: `rig-invalid`.
Result<void> shape_fingers(const SourceMotion&, const Target&, EffectorTrack&);

}  // namespace limber
