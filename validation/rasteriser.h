#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <span>
#include <vector>

#include "validation/image_io.h"

namespace limber {

/// A pinhole camera. Pixels: x right, y down.
struct Camera {
  Eigen::Vector3d eye = Eigen::Vector3d::Zero();
  Eigen::Matrix3d view_from_world = Eigen::Matrix3d::Identity();  ///< rows: right, up, back
  double focal_px = 1.0;
  Eigen::Vector2d centre_px = Eigen::Vector2d::Zero();

  /// x, y in pixels, z the distance ahead of the eye (m); nothing to see where z <= 0.
  Eigen::Vector3d project(const Eigen::Vector3d& p_in_world) const;
};

/// Looks from `eye` at `at`; `up` need not be perpendicular.
Eigen::Matrix3d look_at(const Eigen::Vector3d& eye, const Eigen::Vector3d& at,
                        const Eigen::Vector3d& up);

/// A picture with its ever halved copies, so that a small figure's texture does not flicker.
struct TexturePyramid {
  std::vector<TextureImage> levels;
  bool cut_out = false;  ///< transparent parts are holes
};
TexturePyramid pyramid_of(TextureImage);

/// Triangles of one look, posed, in world space.
struct Surface {
  std::vector<Eigen::Vector3f> positions;
  std::vector<Eigen::Vector3f> normals;  ///< unit, one per position
  std::vector<Eigen::Vector2f> uvs;      ///< where a texture is
  std::vector<Eigen::Vector3f> colors;   ///< linear RGB, one per position; times the texture
  std::vector<std::uint32_t> triangles;
  const TexturePyramid* texture = nullptr;
};

/// Light: a key from the upper left of the camera, a weak fill from the right, sky and ground.
struct Lighting {
  Eigen::Vector3f key, fill, up;  ///< unit, towards the light, world
  static Lighting for_camera(const Camera&, const Eigen::Vector3d& up);
};

/// A z-buffered picture of surfaces with four samples per pixel and soft outlines where depth
/// jumps. Which triangle is seen is found first; light and texture are worked out per finished
/// pixel, for every triangle that shows in it.
class Rasteriser {
 public:
  /// Pixels of the finished picture; the camera's pixels are the same ones.
  Rasteriser(std::int32_t width, std::int32_t height, const Lighting&);
  ~Rasteriser();

  /// The surface must outlive the calls of pixel().
  void draw(const Surface&, const Camera&);
  /// Darkens where depth jumps by more than `step_m`, on the nearer side.
  void outline(double step_m);

  /// Display RGB (0-255, premultiplied) and coverage (0-1) of one finished pixel.
  Eigen::Vector4f pixel(std::int32_t x, std::int32_t y) const;
  /// The part of the picture that may be covered: x0, y0, x1, y1 (exclusive).
  Eigen::Vector4i covered() const;

 private:
  struct Corner;
  struct Drawn;
  struct Weights;

  void triangle(const Drawn&, std::uint32_t id, std::uint32_t first);
  const Drawn& owner(std::uint32_t id) const;
  Eigen::Vector3f shade(std::uint32_t id, float x, float y) const;

  std::int32_t width_, height_;  // samples
  Lighting light_;
  std::vector<Drawn> drawn_;
  std::uint32_t triangles_ = 0;
  std::vector<float> depth_;         // [sample] inverse distance; 0: nothing
  std::vector<std::uint32_t> seen_;  // [sample] triangle
  std::vector<std::uint8_t> edge_;   // [sample] brightness kept, of 255
  Eigen::Vector4i bounds_;           // samples
};

/// Coverage of the shadow that surfaces cast on the plane y = 0 along `towards_light`.
class ShadowMask {
 public:
  ShadowMask(std::int32_t width, std::int32_t height);
  void draw(const Surface&, const Camera&, const Eigen::Vector3d& towards_light);
  void soften(std::int32_t radius_px);
  float at(std::int32_t x, std::int32_t y) const { return mask_[std::size_t(y) * width_ + x]; }

 private:
  std::int32_t width_, height_;
  std::vector<float> mask_;
};

}  // namespace limber
