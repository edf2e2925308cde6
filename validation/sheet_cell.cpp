#include <algorithm>
#include <cmath>
#include <optional>

#include "validation/sheet_parts.h"

namespace limber {
namespace {

/// Grey of the backdrop, by height in the cell: a light room, darker towards the floor.
Rgb backdrop(double t) {
  const auto mix = [t](double a, double b) {
    return static_cast<std::uint8_t>(a + t * (b - a) + 0.5);
  };
  return {mix(253, 238), mix(253, 241), mix(254, 245)};
}

/// How much of a grid line (period 1 in `v`) covers a pixel that spans `span` of v.
double grid_cover(double v, double span, double line) {
  const double off = std::abs(v - std::round(v));
  if (span > 0.5) return 0.0;
  return std::clamp((0.5 * (line + span) - off) / span, 0.0, std::min(1.0, line / span));
}

void draw_floor(Canvas& canvas, const Box& cell, const CellScene& scene, const ShadowMask& shadow) {
  const Eigen::Matrix3d world_from_view = scene.camera.view_from_world.transpose();
  const Eigen::Vector3d& eye = scene.camera.eye;
  const double spacing = scene.size < 0.9 ? 0.25 : 0.5;  // m
  for (std::int32_t y = 0; y < cell.height; ++y) {
    for (std::int32_t x = 0; x < cell.width; ++x) {
      const Eigen::Vector3d ray =
          world_from_view *
          Eigen::Vector3d((x + 0.5 - scene.camera.centre_px.x()) / scene.camera.focal_px,
                          -(y + 0.5 - scene.camera.centre_px.y()) / scene.camera.focal_px, -1.0);
      if (ray.y() > -1e-4 || eye.y() <= 0.0) continue;
      const double along = -eye.y() / ray.y();
      const Eigen::Vector3d hit = eye + along * ray;
      const Eigen::Vector2d away(hit.x() - scene.anchor.x(), hit.z() - scene.anchor.z());
      const double falloff = 1.0 / (1.0 + away.squaredNorm() / (2.6 * scene.size * scene.size));
      const double fade = falloff * falloff;
      // The pixel's footprint on the floor: across the view, and stretched along it.
      const double across = along / scene.camera.focal_px;
      const double stretched = across * ray.norm() / std::abs(ray.y());
      const Eigen::Vector2d level = Eigen::Vector2d(ray.x(), ray.z()).normalized();
      const double span_x = across + std::abs(level.x()) * (stretched - across);
      const double span_z = across + std::abs(level.y()) * (stretched - across);
      const double cover =
          std::max(grid_cover(hit.x() / spacing, span_x / spacing, 0.012 / spacing),
                   grid_cover(hit.z() / spacing, span_z / spacing, 0.012 / spacing));
      const auto pool = static_cast<float>(0.35 * fade);
      canvas.blend(cell.x + x, cell.y + y, {226, 230, 236}, pool);
      const auto grid = static_cast<float>(0.85 * fade * cover);
      if (grid > 0.002F) canvas.blend(cell.x + x, cell.y + y, {166, 174, 187}, grid);
      const float dark = 0.42F * shadow.at(x, y);
      if (dark > 0.002F) canvas.blend(cell.x + x, cell.y + y, {40, 48, 66}, dark);
    }
  }
}

}  // namespace

void draw_scene(Canvas& canvas, const Box& cell, const CellScene& scene) {
  for (std::int32_t y = 0; y < cell.height; ++y) {
    canvas.fill({cell.x, cell.y + y, cell.width, 1}, backdrop((y + 0.5) / cell.height));
  }
  if (scene.ground) {
    ShadowMask shadow(cell.width, cell.height);
    const Eigen::Vector3d back = scene.camera.view_from_world.row(2);
    const Eigen::Vector3d right = scene.camera.view_from_world.row(0);
    const Eigen::Vector3d sun =
        (Eigen::Vector3d(0, 1, 0) - 0.22 * right + 0.18 * back).normalized();
    for (const Surface& surface : scene.surfaces) shadow.draw(surface, scene.camera, sun);
    shadow.soften(2);
    draw_floor(canvas, cell, scene, shadow);
  }
  draw_through(canvas, cell, scene, 1.0);
}

void draw_through(Canvas& canvas, const Box& cell, const CellScene& scene, double opacity) {
  Rasteriser raster(cell.width, cell.height, Lighting::for_camera(scene.camera, scene.up));
  for (const Surface& surface : scene.surfaces) raster.draw(surface, scene.camera);
  raster.outline(0.02 * scene.size);
  const Eigen::Vector4i covered = raster.covered();
  for (std::int32_t y = covered[1]; y < std::min(covered[3], cell.height); ++y) {
    for (std::int32_t x = covered[0]; x < std::min(covered[2], cell.width); ++x) {
      const Eigen::Vector4f p = static_cast<float>(opacity) * raster.pixel(x, y);
      if (p[3] == 0.0F) continue;
      std::uint8_t* out = canvas.at(cell.x + x, cell.y + y);
      for (int k = 0; k < 3; ++k) {
        out[k] = static_cast<std::uint8_t>(p[k] + (1.0F - p[3]) * out[k] + 0.5F);
      }
    }
  }
}

void draw_marks(Canvas& canvas, const Box& cell, const Camera& camera,
                std::span<const EffectorMark> marks) {
  const double size = marks.size() > 14 ? 2.6 : 3.4;
  struct Seen {
    Eigen::Vector2d target, reached;
  };
  std::vector<Seen> seen;
  for (const EffectorMark& mark : marks) {
    const Eigen::Vector3d t = camera.project(mark.target), r = camera.project(mark.reached);
    if (!(t.z() > 0 && r.z() > 0)) continue;
    const auto clip = [&](const Eigen::Vector3d& p) {
      return Eigen::Vector2d(cell.x + std::clamp(p.x(), 3.0, cell.width - 3.0),
                             cell.y + std::clamp(p.y(), 3.0, cell.height - 3.0));
    };
    seen.push_back({clip(t), clip(r)});
  }
  for (const Seen& s : seen) {
    canvas.disc(s.target, size + 1.8, {255, 255, 255}, 0.9);
    canvas.disc(s.target, size + 0.6, palette::kTarget);
  }
  for (const Seen& s : seen) {
    if ((s.target - s.reached).norm() > 1.0)
      canvas.line(s.target, s.reached, 1.6, palette::kTarget);
  }
  for (const Seen& s : seen) {
    canvas.disc(s.reached, size - 0.2, {255, 255, 255});
    canvas.disc(s.reached, size - 1.3, palette::kReached);
  }
}

void draw_ghost(Canvas& canvas, const Box& cell, const Camera& camera,
                std::span<const GhostBone> bones) {
  const auto seen = [&](const Eigen::Vector3d& p) -> std::optional<Eigen::Vector2d> {
    const Eigen::Vector3d at = camera.project(p);
    const bool inside = at.z() > 0.0 && at.x() > 3.0 && at.x() < cell.width - 3.0 && at.y() > 3.0 &&
                        at.y() < cell.height - 3.0;
    if (!inside) return std::nullopt;
    return Eigen::Vector2d(cell.x + at.x(), cell.y + at.y());
  };
  for (const bool halo : {true, false}) {
    for (const auto& [from, to] : bones) {
      const auto a = seen(from), b = seen(to);
      if (!a || !b) continue;
      if (halo) {
        canvas.line(*a, *b, 3.6, {255, 255, 255}, 0.55);
      } else {
        canvas.line(*a, *b, 1.8, palette::kGhost, 0.9);
        canvas.disc(*b, 2.2, palette::kGhost, 0.9);
      }
    }
  }
}

}  // namespace limber
