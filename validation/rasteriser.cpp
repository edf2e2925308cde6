#include "validation/rasteriser.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace limber {
namespace {

constexpr std::int32_t kSamples = 2;  // per pixel and direction
constexpr float kNear = 0.02F;        // m

/// sRGB bytes to linear light, and back through 4096 steps.
struct Gamma {
  std::array<float, 256> linear;
  std::array<std::uint8_t, 4097> display;

  Gamma() {
    for (int i = 0; i < 256; ++i) {
      const double s = i / 255.0;
      linear[i] = static_cast<float>(s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4));
    }
    for (int i = 0; i <= 4096; ++i) {
      const double l = i / 4096.0;
      const double s = l <= 0.0031308 ? 12.92 * l : 1.055 * std::pow(l, 1 / 2.4) - 0.055;
      display[i] = static_cast<std::uint8_t>(std::lround(255.0 * s));
    }
  }
  std::uint8_t encode(float l) const {
    return display[static_cast<int>(std::clamp(l, 0.0F, 1.0F) * 4096.0F + 0.5F)];
  }
};

const Gamma& gamma() {
  static const Gamma table;
  return table;
}

/// Bilinear, repeating. Linear RGB and alpha 0-1.
Eigen::Vector4f sample(const TextureImage& t, float u, float v) {
  const auto wrap = [](float x, std::int32_t n, std::int32_t& i0, std::int32_t& i1) {
    const float p = (x - std::floor(x)) * static_cast<float>(n) - 0.5F;
    const float low = std::floor(p);
    i0 = (static_cast<std::int32_t>(low) + n) % n;
    i1 = (i0 + 1) % n;
    return p - low;
  };
  std::int32_t x0, x1, y0, y1;
  const float fx = wrap(u, t.width, x0, x1), fy = wrap(v, t.height, y0, y1);
  const auto at = [&](std::int32_t x, std::int32_t y) {
    const std::uint8_t* p = t.rgba.data() + (std::size_t(y) * t.width + x) * 4;
    const auto& linear = gamma().linear;
    return Eigen::Vector4f(linear[p[0]], linear[p[1]], linear[p[2]], p[3] / 255.0F);
  };
  const Eigen::Vector4f top = (1 - fx) * at(x0, y0) + fx * at(x1, y0);
  const Eigen::Vector4f bottom = (1 - fx) * at(x0, y1) + fx * at(x1, y1);
  return (1 - fy) * top + fy * bottom;
}

TextureImage halved(const TextureImage& t) {
  TextureImage half;
  half.width = std::max(1, t.width / 2);
  half.height = std::max(1, t.height / 2);
  half.rgba.resize(std::size_t(half.width) * half.height * 4);
  for (std::int32_t y = 0; y < half.height; ++y) {
    for (std::int32_t x = 0; x < half.width; ++x) {
      for (int c = 0; c < 4; ++c) {
        int sum = 2;
        for (const auto& [dx, dy] : {std::pair{0, 0}, {1, 0}, {0, 1}, {1, 1}}) {
          const std::int32_t sx = std::min(2 * x + dx, t.width - 1);
          const std::int32_t sy = std::min(2 * y + dy, t.height - 1);
          sum += t.rgba[(std::size_t(sy) * t.width + sx) * 4 + c];
        }
        half.rgba[(std::size_t(y) * half.width + x) * 4 + c] = static_cast<std::uint8_t>(sum / 4);
      }
    }
  }
  return half;
}

/// Twice the signed area of the triangle a, b, p.
float edge(float ax, float ay, float bx, float by, float px, float py) {
  return (bx - ax) * (py - ay) - (by - ay) * (px - ax);
}

}  // namespace

Eigen::Vector3d Camera::project(const Eigen::Vector3d& p) const {
  const Eigen::Vector3d v = view_from_world * (p - eye);
  const double ahead = -v.z();
  return {centre_px.x() + focal_px * v.x() / ahead, centre_px.y() - focal_px * v.y() / ahead,
          ahead};
}

Eigen::Matrix3d look_at(const Eigen::Vector3d& eye, const Eigen::Vector3d& at,
                        const Eigen::Vector3d& up) {
  const Eigen::Vector3d back = (eye - at).normalized();
  const Eigen::Vector3d right = up.cross(back).normalized();
  Eigen::Matrix3d m;
  m << right.transpose(), back.cross(right).transpose(), back.transpose();
  return m;
}

TexturePyramid pyramid_of(TextureImage image) {
  TexturePyramid pyramid;
  std::size_t holes = 0;
  for (std::size_t i = 3; i < image.rgba.size(); i += 4) holes += image.rgba[i] < 77;
  // A texture that is transparent everywhere keeps something else in its alpha channel.
  pyramid.cut_out = holes > 0 && holes * 4 < image.rgba.size();
  pyramid.levels.push_back(std::move(image));
  while (pyramid.levels.back().width > 4 && pyramid.levels.back().height > 4) {
    pyramid.levels.push_back(halved(pyramid.levels.back()));
  }
  return pyramid;
}

Lighting Lighting::for_camera(const Camera& camera, const Eigen::Vector3d& up) {
  const Eigen::Matrix3d world_from_view = camera.view_from_world.transpose();
  Lighting l;
  l.key = (world_from_view * Eigen::Vector3d(-0.55, 0.75, 0.75)).normalized().cast<float>();
  l.fill = (world_from_view * Eigen::Vector3d(0.8, 0.1, 0.5)).normalized().cast<float>();
  l.up = up.cast<float>();
  return l;
}

// ---------------------------------------------------------------------------- surfaces

struct Rasteriser::Corner {
  float x, y, w;           // samples; w = 1 / distance
  Eigen::Vector3f normal;  // over the distance from here on: linear in the picture
  Eigen::Vector3f color;
  Eigen::Vector2f uv;
};

/// A surface as it lies in the picture; its triangles are first_id and on.
struct Rasteriser::Drawn {
  const Surface* surface = nullptr;
  std::uint32_t first_id = 0;
  std::vector<Corner> corners;
};

/// Barycentric weights of two corners as linear functions of the sample's place.
struct Rasteriser::Weights {
  float a0, ax, ay, b0, bx, by, area;

  Weights(const Corner& a, const Corner& b, const Corner& c)
      : area((b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x)) {
    const float inverse = 1.0F / area;
    ax = (b.y - c.y) * inverse;
    ay = (c.x - b.x) * inverse;
    a0 = (b.x * c.y - b.y * c.x) * inverse;
    bx = (c.y - a.y) * inverse;
    by = (a.x - c.x) * inverse;
    b0 = (c.x * a.y - c.y * a.x) * inverse;
  }
};

Rasteriser::Rasteriser(std::int32_t width, std::int32_t height, const Lighting& light)
    : width_(width * kSamples),
      height_(height * kSamples),
      light_(light),
      depth_(std::size_t(width_) * height_, 0.0F),
      seen_(depth_.size()),
      edge_(depth_.size(), 255),
      bounds_(width_, height_, 0, 0) {}

Rasteriser::~Rasteriser() = default;

void Rasteriser::draw(const Surface& surface, const Camera& camera) {
  Drawn drawn;
  drawn.surface = &surface;
  drawn.first_id = triangles_;
  drawn.corners.resize(surface.positions.size());
  for (std::size_t i = 0; i < drawn.corners.size(); ++i) {
    const Eigen::Vector3d p = camera.project(surface.positions[i].cast<double>());
    Corner& c = drawn.corners[i];
    c.w = p.z() > kNear ? static_cast<float>(1.0 / p.z()) : 0.0F;
    c.x = static_cast<float>(kSamples * p.x());
    c.y = static_cast<float>(kSamples * p.y());
    c.normal = c.w * surface.normals[i];
    c.color = c.w * surface.colors[i];
    c.uv = surface.texture ? Eigen::Vector2f(c.w * surface.uvs[i]) : Eigen::Vector2f::Zero();
  }
  const auto count = static_cast<std::uint32_t>(surface.triangles.size() / 3);
  for (std::uint32_t t = 0; t < count; ++t) triangle(drawn, triangles_ + t, 3 * t);
  triangles_ += count;
  drawn_.push_back(std::move(drawn));
}

void Rasteriser::triangle(const Drawn& drawn, std::uint32_t id, std::uint32_t first) {
  const std::uint32_t* k = &drawn.surface->triangles[first];
  const Corner &a = drawn.corners[k[0]], &b = drawn.corners[k[1]], &c = drawn.corners[k[2]];
  const float reach = static_cast<float>(std::max(width_, height_)) * 4.0F;
  for (const Corner* corner : {&a, &b, &c}) {
    if (!(corner->w > 0) || !(std::abs(corner->x) < reach) || !(std::abs(corner->y) < reach))
      return;
  }
  const Weights w(a, b, c);
  if (!(std::abs(w.area) > 1e-5F)) return;
  const auto low = [](float v) { return static_cast<std::int32_t>(std::floor(v)); };
  const std::int32_t x0 = std::max(0, low(std::min({a.x, b.x, c.x})));
  const std::int32_t x1 = std::min(width_ - 1, low(std::max({a.x, b.x, c.x})));
  const std::int32_t y0 = std::max(0, low(std::min({a.y, b.y, c.y})));
  const std::int32_t y1 = std::min(height_ - 1, low(std::max({a.y, b.y, c.y})));
  if (x0 > x1 || y0 > y1) return;
  bounds_ = {std::min(bounds_[0], x0), std::min(bounds_[1], y0), std::max(bounds_[2], x1 + 1),
             std::max(bounds_[3], y1 + 1)};
  const TexturePyramid* holes = drawn.surface->texture;
  if (holes && !holes->cut_out) holes = nullptr;
  for (std::int32_t y = y0; y <= y1; ++y) {
    const float py = static_cast<float>(y) + 0.5F;
    const float row_a = w.a0 + w.ay * py, row_b = w.b0 + w.by * py;
    for (std::int32_t x = x0; x <= x1; ++x) {
      const float px = static_cast<float>(x) + 0.5F;
      const float wa = row_a + w.ax * px, wb = row_b + w.bx * px, wc = 1.0F - wa - wb;
      if (wa < 0 || wb < 0 || wc < 0) continue;
      const float depth = wa * a.w + wb * b.w + wc * c.w;
      const std::size_t i = std::size_t(y) * width_ + x;
      if (depth <= depth_[i]) continue;
      if (holes) {
        const Eigen::Vector2f uv = (wa * a.uv + wb * b.uv + wc * c.uv) / depth;
        if (sample(holes->levels[0], uv.x(), uv.y())[3] < 0.3F) continue;
      }
      depth_[i] = depth;
      seen_[i] = id;
    }
  }
}

const Rasteriser::Drawn& Rasteriser::owner(std::uint32_t id) const {
  std::size_t d = drawn_.size() - 1;
  while (drawn_[d].first_id > id) --d;
  return drawn_[d];
}

Eigen::Vector3f Rasteriser::shade(std::uint32_t id, float x, float y) const {
  const Drawn& drawn = owner(id);
  const Surface& surface = *drawn.surface;
  const std::uint32_t* k = &surface.triangles[3 * (id - drawn.first_id)];
  const Corner &a = drawn.corners[k[0]], &b = drawn.corners[k[1]], &c = drawn.corners[k[2]];
  const Weights w(a, b, c);
  // A pixel's centre may lie a little outside of what is seen in it.
  float wa = std::max(0.0F, w.a0 + w.ax * x + w.ay * y);
  float wb = std::max(0.0F, w.b0 + w.bx * x + w.by * y);
  float wc = std::max(0.0F, 1.0F - wa - wb);
  const float depth = wa * a.w + wb * b.w + wc * c.w;
  Eigen::Vector3f albedo = (wa * a.color + wb * b.color + wc * c.color) / depth;
  if (surface.texture) {
    const std::vector<TextureImage>& levels = surface.texture->levels;
    const Eigen::Vector2f ua = a.uv / a.w, ab = b.uv / b.w - ua, ac = c.uv / c.w - ua;
    const float texels = std::abs(ab.x() * ac.y() - ab.y() * ac.x()) *
                         static_cast<float>(levels[0].width) * static_cast<float>(levels[0].height);
    float ratio = texels / std::abs(w.area) * (kSamples * kSamples) * 0.5F;
    std::size_t level = 0;
    for (; ratio > 2.0F && level + 1 < levels.size(); ratio *= 0.25F) ++level;
    const Eigen::Vector2f uv = (wa * a.uv + wb * b.uv + wc * c.uv) / depth;
    albedo = albedo.cwiseProduct(sample(levels[level], uv.x(), uv.y()).head<3>());
  }
  Eigen::Vector3f n = wa * a.normal + wb * b.normal + wc * c.normal;
  n /= std::max(n.norm(), 1e-12F);
  const float key = std::max(0.0F, n.dot(light_.key)), fill = std::max(0.0F, n.dot(light_.fill));
  const float sky = 0.5F + 0.5F * n.dot(light_.up);
  const float lit = 0.20F + 0.22F * sky + 0.62F * key + 0.14F * fill;
  const auto& display = gamma();
  return {static_cast<float>(display.encode(albedo[0] * lit)),
          static_cast<float>(display.encode(albedo[1] * lit)),
          static_cast<float>(display.encode(albedo[2] * lit))};
}

void Rasteriser::outline(double step_m) {
  const auto step = static_cast<float>(step_m);
  for (std::int32_t y = std::max(1, bounds_[1]); y < std::min(height_ - 1, bounds_[3]); ++y) {
    for (std::int32_t x = std::max(1, bounds_[0]); x < std::min(width_ - 1, bounds_[2]); ++x) {
      const std::size_t i = std::size_t(y) * width_ + x;
      if (depth_[i] == 0.0F) continue;
      // Inverse distance at which another surface lies a step behind this one; 0 is empty space.
      const float behind = depth_[i] / (1.0F + step * depth_[i]);
      const float furthest = std::min(std::min(depth_[i - 1], depth_[i + 1]),
                                      std::min(depth_[i - width_], depth_[i + width_]));
      if (furthest < behind) edge_[i] = furthest == 0.0F ? 140 : 120;
    }
  }
}

Eigen::Vector4f Rasteriser::pixel(std::int32_t x, std::int32_t y) const {
  Eigen::Vector4f sum = Eigen::Vector4f::Zero();
  std::array<std::uint32_t, kSamples * kSamples> shaded;
  std::array<Eigen::Vector3f, kSamples * kSamples> colors;
  std::size_t known = 0;
  const float cx = static_cast<float>((x + 0.5) * kSamples),
              cy = static_cast<float>((y + 0.5) * kSamples);
  for (std::int32_t sy = y * kSamples; sy < (y + 1) * kSamples; ++sy) {
    for (std::int32_t sx = x * kSamples; sx < (x + 1) * kSamples; ++sx) {
      const std::size_t i = std::size_t(sy) * width_ + sx;
      if (depth_[i] == 0.0F) continue;
      std::size_t k = 0;
      while (k < known && shaded[k] != seen_[i]) ++k;
      if (k == known) {
        shaded[known] = seen_[i];
        colors[known++] = shade(seen_[i], cx, cy);
      }
      sum.head<3>() += colors[k] * (static_cast<float>(edge_[i]) / 255.0F);
      sum[3] += 1.0F;
    }
  }
  return sum / static_cast<float>(kSamples * kSamples);
}

Eigen::Vector4i Rasteriser::covered() const {
  if (bounds_[2] <= bounds_[0]) return Eigen::Vector4i::Zero();
  return {bounds_[0] / kSamples, bounds_[1] / kSamples, (bounds_[2] + kSamples - 1) / kSamples,
          (bounds_[3] + kSamples - 1) / kSamples};
}

// ---------------------------------------------------------------------------- shadow

ShadowMask::ShadowMask(std::int32_t width, std::int32_t height)
    : width_(width), height_(height), mask_(std::size_t(width) * height, 0.0F) {}

void ShadowMask::draw(const Surface& surface, const Camera& camera,
                      const Eigen::Vector3d& towards_light) {
  std::vector<Eigen::Vector3f> seen(surface.positions.size());
  for (std::size_t i = 0; i < seen.size(); ++i) {
    const Eigen::Vector3d p = surface.positions[i].cast<double>();
    seen[i] = camera.project(p - towards_light * (p.y() / towards_light.y())).cast<float>();
  }
  const auto low = [](float v) { return static_cast<std::int32_t>(std::floor(v)); };
  for (std::size_t t = 0; t + 2 < surface.triangles.size(); t += 3) {
    const Eigen::Vector3f& a = seen[surface.triangles[t]];
    const Eigen::Vector3f& b = seen[surface.triangles[t + 1]];
    const Eigen::Vector3f& c = seen[surface.triangles[t + 2]];
    if (!(a.z() > kNear && b.z() > kNear && c.z() > kNear)) continue;
    const float area = edge(a.x(), a.y(), b.x(), b.y(), c.x(), c.y());
    if (!(std::abs(area) > 1e-6F) || !(std::abs(area) < 1e7F)) continue;
    const std::int32_t x0 = std::max(0, low(std::min({a.x(), b.x(), c.x()})));
    const std::int32_t x1 = std::min(width_ - 1, low(std::max({a.x(), b.x(), c.x()})));
    const std::int32_t y0 = std::max(0, low(std::min({a.y(), b.y(), c.y()})));
    const std::int32_t y1 = std::min(height_ - 1, low(std::max({a.y(), b.y(), c.y()})));
    for (std::int32_t y = y0; y <= y1; ++y) {
      for (std::int32_t x = x0; x <= x1; ++x) {
        const float px = static_cast<float>(x) + 0.5F, py = static_cast<float>(y) + 0.5F;
        const float ba = edge(b.x(), b.y(), c.x(), c.y(), px, py) / area;
        const float bb = edge(c.x(), c.y(), a.x(), a.y(), px, py) / area;
        if (ba >= 0 && bb >= 0 && ba + bb <= 1.0F) mask_[std::size_t(y) * width_ + x] = 1.0F;
      }
    }
  }
}

void ShadowMask::soften(std::int32_t radius) {
  // A box along x, then along y, twice: near a Gaussian.
  std::vector<float> line;
  const auto blur = [&](std::size_t begin, std::size_t stride, std::int32_t count) {
    line.assign(count, 0.0F);
    float sum = 0.0F;
    for (std::int32_t i = -radius; i < count; ++i) {
      if (i + radius < count) sum += mask_[begin + (i + radius) * stride];
      if (i - radius - 1 >= 0) sum -= mask_[begin + (i - radius - 1) * stride];
      if (i >= 0) line[i] = sum / static_cast<float>(2 * radius + 1);
    }
    for (std::int32_t i = 0; i < count; ++i) mask_[begin + i * stride] = line[i];
  };
  for (int pass = 0; pass < 2; ++pass) {
    for (std::int32_t y = 0; y < height_; ++y) blur(std::size_t(y) * width_, 1, width_);
    for (std::int32_t x = 0; x < width_; ++x) blur(x, width_, height_);
  }
}

}  // namespace limber
