#pragma once

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "validation/contact_sheet.h"
#include "validation/figure_model.h"
#include "validation/sheet_canvas.h"
#include "validation/sheet_view.h"

namespace limber {

/// What one cell shows.
struct CellScene {
  std::span<const Surface> surfaces;
  Camera camera;  ///< pixels of the cell
  bool ground = true;
  Eigen::Vector3d anchor = Eigen::Vector3d::Zero();  ///< world point that the camera follows
  Eigen::Vector3d up{0, 1, 0};
  double size = 1.0;  ///< of the figure, m; the grid fades and outlines scale with it
};

/// Background, floor grid, shadow and figure.
void draw_scene(Canvas&, const Box& cell, const CellScene&);

/// The scene's surfaces alone, over what is there already.
void draw_through(Canvas&, const Box& cell, const CellScene&, double opacity);

/// Targets red, reached green, joined.
void draw_marks(Canvas&, const Box& cell, const Camera&, std::span<const EffectorMark>);

/// Another figure's bones, seen through: [bone] its two ends in world space.
using GhostBone = std::pair<Eigen::Vector3d, Eigen::Vector3d>;
void draw_ghost(Canvas&, const Box& cell, const Camera&, std::span<const GhostBone>);

/// Title, verdict, key figures, legend (of sides, or of a hand's fingers).
void draw_head(Canvas&, const Box&, const ContactSheet&, const BodyPlan&);

/// What the colours mean, ending at a baseline point on the right. Returns where it begins.
double draw_legend(Canvas&, const Eigen::Vector2d& right_base, const BodyPlan&, bool marks,
                   bool tinted);

/// Error, speed and contacts along time, with the drawn frames ticked, and beside them the joints
/// that are most on their limits.
void draw_strips(Canvas&, const Box&, const ContactSheet&, std::span<const std::int64_t> frames);
std::int32_t strips_height(const ContactSheet&);

/// Bars for the joints that are most on their limits; as many as fit.
void draw_limit_bars(Canvas&, const Box&, std::span<const LimitTime>);

}  // namespace limber
