#pragma once

#include <span>

#include "validation/pose_sheet.h"

namespace limber {

/// Where a target is drawn: itself, or, when it is farther than `most_m` from what was reached, a
/// point on the way there.
Eigen::Vector3d shown_target(const PoseMark&, double most_m);

/// The points that a picture has to hold so that a mark is seen whole.
std::vector<Eigen::Vector3d> extent_of(const PoseMark&, double axis_m, double most_m);

/// Ideal frames red, reached ones green on top and thinner, so that both are seen where they agree;
/// a line where they differ. Of a frame's axes x is the longest (`axis_m`) and z the shortest.
/// The camera's pixels are those of the canvas.
void draw_pose_marks(Canvas&, const Box& cell, const Camera&, std::span<const PoseMark>,
                     double axis_m, double most_m);

}  // namespace limber
