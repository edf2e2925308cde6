#pragma once

#include <optional>

#include "pipeline/effectors.h"
#include "validation/motion_metrics.h"

namespace limber {

/// A motion and the height of the floor it stands on.
struct MeasuredMotion {
  SourceMotion motion;
  double floor_y = 0.0;  ///< m
};

/// The motion as validation compares it.
MotionSide motion_side(const MeasuredMotion&);

/// Contacts, sliding, penetration and smoothness of an output against its source; `scale` is the
/// output's size over the source's.
MotionMetrics measure_against(const MeasuredMotion& source, const MeasuredMotion& output,
                              double scale);

/// The motion of a skeleton on a rig's rows, joints paired by name; none where one is missing.
std::optional<Clip> clip_on_rig(const Skeleton&, const Clip&, const Rig&);

}  // namespace limber
