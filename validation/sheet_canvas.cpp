#include "validation/sheet_canvas.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

namespace limber {
namespace {

constexpr int kFont = cv::FONT_HERSHEY_SIMPLEX;
constexpr double kCapital = 21.0;  // height of a capital of this font at scale 1
constexpr int kFine = 4;           // letters are drawn this much larger, then averaged

std::string ascii(const std::string& s) {
  std::string out;
  for (std::size_t i = 0; i < s.size(); ++i) {
    const auto c = static_cast<unsigned char>(s[i]);
    if ((c & 0xC0U) == 0x80U) continue;  // the rest of a UTF-8 character
    out += c >= 32 && c < 127 ? s[i] : '?';
  }
  return out;
}

cv::Size pixel_size(const std::string& s, double scale, int thickness) {
  int baseline = 0;
  return cv::getTextSize(s, kFont, scale, thickness, &baseline);
}

}  // namespace

Canvas::Canvas(std::int32_t width, std::int32_t height, Rgb background) {
  image_.width = width;
  image_.height = height;
  image_.rgb.resize(std::size_t(width) * height * 3);
  fill({0, 0, width, height}, background);
}

void Canvas::blend(std::int32_t x, std::int32_t y, Rgb color, float opacity) {
  if (x < 0 || y < 0 || x >= image_.width || y >= image_.height) return;
  std::uint8_t* p = at(x, y);
  const float a = std::clamp(opacity, 0.0F, 1.0F);
  const auto mix = [a](std::uint8_t from, std::uint8_t to) {
    const float m =
        static_cast<float>(from) + a * (static_cast<float>(to) - static_cast<float>(from));
    return static_cast<std::uint8_t>(m + 0.5F);
  };
  p[0] = mix(p[0], color.r);
  p[1] = mix(p[1], color.g);
  p[2] = mix(p[2], color.b);
}

void Canvas::fill(const Box& box, Rgb color, double opacity) {
  for (std::int32_t y = box.y; y < box.y + box.height; ++y) {
    for (std::int32_t x = box.x; x < box.x + box.width; ++x) {
      blend(x, y, color, static_cast<float>(opacity));
    }
  }
}

template <class Distance>
void Canvas::shape(double x0, double y0, double x1, double y1, Rgb color, double opacity,
                   Distance distance) {
  const auto from = [](double v) { return static_cast<std::int32_t>(std::floor(v)) - 1; };
  const auto to = [](double v, std::int32_t most) {
    return std::min(most, static_cast<std::int32_t>(std::ceil(v)) + 1);
  };
  for (std::int32_t y = std::max(0, from(y0)); y < to(y1, image_.height); ++y) {
    for (std::int32_t x = std::max(0, from(x0)); x < to(x1, image_.width); ++x) {
      const double cover = std::clamp(0.5 - distance(Eigen::Vector2d(x + 0.5, y + 0.5)), 0.0, 1.0);
      if (cover > 0.0) blend(x, y, color, static_cast<float>(cover * opacity));
    }
  }
}

void Canvas::rounded(const Box& box, double radius, Rgb color) {
  const Eigen::Vector2d half(0.5 * box.width, 0.5 * box.height);
  const Eigen::Vector2d centre = Eigen::Vector2d(box.x, box.y) + half;
  shape(box.x, box.y, box.x + box.width, box.y + box.height, color, 1.0,
        [&](const Eigen::Vector2d& p) {
          const Eigen::Vector2d d =
              (p - centre).cwiseAbs() - half + Eigen::Vector2d::Constant(radius);
          return d.cwiseMax(0.0).norm() + std::min(d.maxCoeff(), 0.0) - radius;
        });
}

void Canvas::line(const Eigen::Vector2d& a, const Eigen::Vector2d& b, double width, Rgb color,
                  double opacity) {
  if (!a.allFinite() || !b.allFinite()) return;
  const Eigen::Vector2d low = a.cwiseMin(b).array() - width, high = a.cwiseMax(b).array() + width;
  const Eigen::Vector2d ab = b - a;
  const double length2 = std::max(ab.squaredNorm(), 1e-12);
  shape(low.x(), low.y(), high.x(), high.y(), color, opacity, [&](const Eigen::Vector2d& p) {
    const double t = std::clamp((p - a).dot(ab) / length2, 0.0, 1.0);
    return (p - a - t * ab).norm() - 0.5 * width;
  });
}

void Canvas::disc(const Eigen::Vector2d& c, double radius, Rgb color, double opacity) {
  if (!c.allFinite()) return;
  shape(c.x() - radius, c.y() - radius, c.x() + radius, c.y() + radius, color, opacity,
        [&](const Eigen::Vector2d& p) { return (p - c).norm() - radius; });
}

double Canvas::text_width(const std::string& s, double size) {
  return pixel_size(ascii(s), kFine * size / kCapital, 1).width / double(kFine);
}

std::string Canvas::fitted(const std::string& s, double size, double width) {
  std::string cut = ascii(s);
  if (text_width(cut, size) <= width) return cut;
  while (!cut.empty() && text_width(cut + "..", size) > width) cut.pop_back();
  return cut + "..";
}

double Canvas::text(double x, double y, const std::string& utf8, double size, Rgb color,
                    Align align, double weight) {
  const std::string s = ascii(utf8);
  if (s.empty()) return 0.0;
  const double scale = kFine * size / kCapital;
  const int thickness = std::max(1, static_cast<int>(std::lround(kFine * weight * size / 7.5)));
  const cv::Size box = pixel_size(s, scale, thickness);
  const double width = text_width(s, size);
  if (align == Align::centre) x -= 0.5 * width;
  if (align == Align::right) x -= width;
  // A mask of the finer letters with a margin, on whole pixels of the sheet.
  const int margin = 2 + thickness;
  const auto left = static_cast<std::int32_t>(std::floor(x)) - margin;
  const auto base = static_cast<std::int32_t>(std::lround(y));
  const int rows = static_cast<int>(std::ceil(size * 1.9)) + 2 * margin;
  const int columns = static_cast<int>(std::ceil(double(box.width) / kFine)) + 2 * margin + 2;
  cv::Mat mask = cv::Mat::zeros(rows * kFine, columns * kFine, CV_8UC1);
  const int above = static_cast<int>(std::ceil(size * 1.3)) + margin;  // rows over the baseline
  cv::putText(mask, s, cv::Point(static_cast<int>(std::lround((x - left) * kFine)), above * kFine),
              kFont, scale, cv::Scalar(255), thickness, cv::LINE_AA);
  for (int r = 0; r < rows; ++r) {
    for (int c = 0; c < columns; ++c) {
      int sum = 0;
      for (int i = 0; i < kFine; ++i) {
        const std::uint8_t* row = mask.ptr<std::uint8_t>(r * kFine + i) + c * kFine;
        for (int j = 0; j < kFine; ++j) sum += row[j];
      }
      if (sum > 0) blend(left + c, base - above + r, color, sum / (255.0F * kFine * kFine));
    }
  }
  return width;
}

}  // namespace limber
