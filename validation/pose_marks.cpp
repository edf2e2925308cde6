#include "validation/pose_marks.h"

#include <algorithm>
#include <array>

namespace limber {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr Rgb kWhite{255, 255, 255};
constexpr std::array<double, 3> kAxisShare{1.0, 0.7, 0.45};  // x, y, z
constexpr double kBorder = 3.0;                              // px kept free inside a cell
constexpr double kApart = 4.0;                               // px from which on a line is drawn

/// The end of a line from a point inside the cell, cut at its border.
Vector2d cut(const Box& cell, const Vector2d& from, const Vector2d& to) {
  const Vector2d low(cell.x + kBorder, cell.y + kBorder);
  const Vector2d high(cell.x + cell.width - kBorder, cell.y + cell.height - kBorder);
  double share = 1.0;
  for (int k = 0; k < 2; ++k) {
    const double step = to[k] - from[k];
    if (step > 0.0) share = std::min(share, (high[k] - from[k]) / step);
    if (step < 0.0) share = std::min(share, (low[k] - from[k]) / step);
  }
  return from + std::max(share, 0.0) * (to - from);
}

/// A frame as it is seen.
struct Triad {
  Vector2d origin;
  std::array<Vector2d, 3> ends;
  bool axes = true;
};

class Pen {
 public:
  Pen(Canvas& canvas, const Box& cell, const Camera& camera, double axis_m)
      : canvas_(canvas), cell_(cell), camera_(camera), axis_m_(axis_m) {}

  Vector2d pixel(const Vector3d& p) const { return camera_.project(p).head<2>(); }

  Triad triad(const Vector3d& origin, const Eigen::Quaterniond& rotation, bool axes) const {
    Triad out;
    out.origin = pixel(origin);
    out.axes = axes;
    for (int k = 0; k < 3; ++k) {
      const Vector3d end = origin + axis_m_ * kAxisShare[k] * (rotation * Vector3d::Unit(k));
      out.ends[k] = cut(cell_, out.origin, pixel(end));
    }
    return out;
  }
  void draw(const Triad& t, double width, double radius, Rgb color, double opacity = 1.0) const {
    if (t.axes) {
      for (const Vector2d& end : t.ends) canvas_.line(t.origin, end, width, color, opacity);
    }
    canvas_.disc(t.origin, radius, color, opacity);
  }
  void line(const Vector2d& from, const Vector2d& to, double width, Rgb color,
            double opacity) const {
    canvas_.line(from, cut(cell_, from, to), width, color, opacity);
  }
  /// Two strokes back from the tip of a line that goes on.
  void arrow_head(const Vector2d& from, const Vector2d& tip, Rgb color) const {
    if ((tip - from).norm() < 1.0) return;
    const Vector2d back = 13.0 * (from - tip).normalized();
    for (const double angle : {0.45, -0.45}) {
      canvas_.line(tip, tip + Eigen::Rotation2Dd(angle) * back, 3.0, color);
    }
  }

 private:
  Canvas& canvas_;
  Box cell_;
  Camera camera_;
  double axis_m_;
};

}  // namespace

Vector3d shown_target(const PoseMark& mark, double most_m) {
  const Vector3d reached = mark.reached.translation();
  const Vector3d miss = mark.target.translation() - reached;
  const double length = miss.norm();
  return length <= most_m ? mark.target.translation()
                          : Vector3d(reached + miss * (most_m / length));
}

std::vector<Vector3d> extent_of(const PoseMark& mark, double axis_m, double most_m) {
  const Vector3d target = shown_target(mark, most_m), reached = mark.reached.translation();
  std::vector<Vector3d> points{target, reached};
  if (!mark.oriented) return points;
  const bool far = (target - mark.target.translation()).norm() > 1e-9;
  for (int k = 0; k < 3; ++k) {
    const Vector3d axis = axis_m * kAxisShare[k] * Vector3d::Unit(k);
    points.emplace_back(reached + mark.reached.rotation() * axis);
    if (!far) points.emplace_back(target + mark.target.rotation() * axis);
  }
  return points;
}

void draw_pose_marks(Canvas& canvas, const Box& cell, const Camera& camera,
                     std::span<const PoseMark> marks, double axis_m, double most_m) {
  const Pen pen(canvas, cell, camera, axis_m);
  struct Seen {
    Triad target, reached;
    bool far = false;
  };
  std::vector<Seen> seen;
  for (const PoseMark& mark : marks) {
    const Vector3d at = shown_target(mark, most_m), reached = mark.reached.translation();
    const bool far = (at - mark.target.translation()).norm() > 1e-9;
    seen.push_back({pen.triad(at, mark.target.rotation(), mark.oriented && !far),
                    pen.triad(reached, mark.reached.rotation(), mark.oriented), far});
  }
  for (const Seen& s : seen) {
    pen.draw(s.reached, 6.0, 8.0, kWhite, 0.8);
    if (!s.far) pen.draw(s.target, 9.5, 9.5, kWhite, 0.8);
  }
  for (const Seen& s : seen) {
    if ((s.target.origin - s.reached.origin).norm() > kApart) {
      pen.line(s.reached.origin, s.target.origin, 4.5, kWhite, 0.75);
      pen.line(s.reached.origin, s.target.origin, 2.0, palette::kTarget, 0.85);
    }
    if (s.far) {
      pen.arrow_head(s.reached.origin, s.target.origin, palette::kTarget);
    } else {
      pen.draw(s.target, 7.0, 8.0, palette::kTarget);
    }
  }
  for (const Seen& s : seen) pen.draw(s.reached, 3.2, 4.6, palette::kReached);
}

}  // namespace limber
