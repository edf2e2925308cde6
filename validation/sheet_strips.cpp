#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <initializer_list>
#include <utility>
#include <vector>

#include "validation/sheet_parts.h"

namespace limber {
namespace {

constexpr std::int32_t kErrorHeight = 92, kSpeedHeight = 64, kLimitsWidth = 430, kBarHeight = 14,
                       kBarGap = 8, kAxisHeight = 34;
constexpr std::int32_t kHeadHeight = 30, kGutter = 96, kPadding = 18;

/// The least of the given multiples of a power of ten that is at least v.
double round_above(double v, std::initializer_list<double> multiples) {
  const double power = std::pow(10.0, std::floor(std::log10(std::max(v, 1e-9))));
  for (const double m : multiples) {
    if (m * power >= v * (1.0 - 1e-9)) return m * power;
  }
  return 10.0 * power;
}

/// Maps frames to pixels; frame 0 at the left edge, the last at the right.
struct TimeAxis {
  double x0 = 0.0, width = 1.0;
  std::int64_t frames = 1;
  double rate_hz = 30.0, start_s = 0.0;

  double x(double frame) const {
    return x0 + width * frame / static_cast<double>(std::max<std::int64_t>(frames - 1, 1));
  }
  double frame_at(double x_px) const {
    return (x_px - x0) / width * static_cast<double>(std::max<std::int64_t>(frames - 1, 1));
  }
};

/// A line of the graph: values of any kind along the frames.
struct Series {
  const std::vector<double>* values = nullptr;
  Rgb color;
  bool filled = false;
};

/// The largest value of the frames that a column of pixels covers.
double value_at(const TimeAxis& axis, int px, const std::vector<double>& values) {
  const auto last = static_cast<std::int64_t>(values.size()) - 1;
  const double f = axis.frame_at(axis.x0 + px), half = 0.5 * axis.frame_at(axis.x0 + 1.0);
  const auto low = std::clamp<std::int64_t>(std::llround(std::ceil(f - half)), 0, last);
  const auto high = std::clamp<std::int64_t>(std::llround(std::floor(f + half)), 0, last);
  if (low > high) {  // between two frames
    const auto a = std::clamp<std::int64_t>(static_cast<std::int64_t>(f), 0, last);
    const double t = f - static_cast<double>(a);
    return (1 - t) * values[a] + t * values[std::min(a + 1, last)];
  }
  double out = 0.0;
  for (std::int64_t k = low; k <= high; ++k) out = std::max(out, values[k]);
  return out;
}

void draw_graph(Canvas& canvas, const TimeAxis& axis, std::int32_t top, std::int32_t graph_height,
                std::span<const Series> all) {
  double most = 0.0;
  for (const Series& series : all) {
    for (const double v : *series.values) most = std::isfinite(v) ? std::max(most, v) : most;
  }
  const double full = round_above(std::max(most * 1.04, 0.1), {1, 1.5, 2, 2.5, 3, 4, 5, 6, 8});
  const double bottom = top + graph_height;
  const auto y_of = [&](double v) { return bottom - graph_height * std::min(v / full, 1.0); };
  for (const double part : {0.0, 0.5, 1.0}) {
    canvas.line({axis.x0, y_of(part * full)}, {axis.x0 + axis.width, y_of(part * full)}, 1.0,
                palette::kRule);
    canvas.text(axis.x0 - 10, y_of(part * full) + 4, fmt::format("{:g}", part * full), 8.5,
                palette::kMuted, Align::right);
  }
  for (const Series& series : all) {
    Eigen::Vector2d before(0, 0);
    for (int px = 0; px <= static_cast<int>(axis.width); ++px) {
      double v = value_at(axis, px, *series.values);
      if (!std::isfinite(v)) v = full;
      const Eigen::Vector2d now(axis.x0 + px, y_of(v));
      const auto y = static_cast<std::int32_t>(std::floor(now.y()));
      if (series.filled) {
        canvas.fill(
            {static_cast<std::int32_t>(now.x()), y, 1, static_cast<std::int32_t>(bottom) - y},
            series.color, 0.14);
      }
      if (px > 0) canvas.line(before, now, 1.6, series.color);
      before = now;
    }
  }
}

/// A graph's name, and beside it what its lines are.
void draw_name(Canvas& canvas, double x, double y, const char* name,
               std::initializer_list<std::pair<const char*, Rgb>> lines = {}) {
  x += canvas.text(x, y, name, 10, palette::kInk, Align::left, 1.15) + 28;
  for (const auto& [word, color] : lines) {
    canvas.disc({x - 10, y - 4.0}, 4.0, color);
    x += canvas.text(x, y, word, 9, palette::kMuted) + 28;
  }
}

void draw_bar(Canvas& canvas, const TimeAxis& axis, std::int32_t top, const char* label, Rgb color,
              const std::vector<std::uint8_t>& contact) {
  const auto x0 = static_cast<std::int32_t>(axis.x0), width = static_cast<std::int32_t>(axis.width);
  canvas.rounded({x0, top, width, kBarHeight}, 4, {236, 239, 243});
  canvas.text(axis.x0 - 10, top + kBarHeight - 3, label, 8.5, palette::kMuted, Align::right);
  const auto frames = static_cast<std::int64_t>(contact.size());
  for (std::int64_t f = 0; f < frames;) {
    std::int64_t end = f;
    while (end < frames && contact[end] == contact[f]) ++end;
    if (contact[f]) {
      const double a = std::max(axis.x(static_cast<double>(f) - 0.5), axis.x0);
      const double b = std::min(axis.x(static_cast<double>(end) - 0.5), axis.x0 + axis.width);
      const auto left = static_cast<std::int32_t>(std::lround(a));
      const auto right = static_cast<std::int32_t>(std::lround(b));
      canvas.rounded({left, top, std::max(2, right - left), kBarHeight}, 3, color);
    }
    f = end;
  }
}

void draw_ticks(Canvas& canvas, const TimeAxis& axis, std::int32_t top, std::int32_t bottom,
                std::span<const std::int64_t> frames) {
  for (const std::int64_t f : frames) {
    const double x = axis.x(static_cast<double>(f));
    canvas.line({x, top}, {x, bottom}, 1.0, palette::kInk, 0.35);
    canvas.disc({x, top - 1.0}, 3.0, palette::kInk);
  }
}

void draw_axis(Canvas& canvas, const TimeAxis& axis, std::int32_t top) {
  const double duration =
      static_cast<double>(std::max<std::int64_t>(axis.frames - 1, 1)) / axis.rate_hz;
  const double step = round_above(duration / 14.0, {1, 2, 5});
  canvas.line({axis.x0, top}, {axis.x0 + axis.width, top}, 1.0, palette::kFaint);
  const double end_s = axis.start_s + duration;
  for (double k = std::ceil(axis.start_s / step - 1e-9); k * step <= end_s + 1e-9; ++k) {
    const double x = axis.x((k * step - axis.start_s) * axis.rate_hz);
    canvas.line({x, top}, {x, top + 5.0}, 1.0, palette::kFaint);
    canvas.text(x, top + 18, fmt::format("{:g}", k * step + 0.0), 8.5, palette::kMuted,
                Align::centre);
  }
  canvas.text(axis.x0 - 10, top + 18, "time, s", 8.5, palette::kMuted, Align::right);
}

bool has_contacts(const ContactSheet& sheet) {
  return !sheet.left_contact.empty() || !sheet.right_contact.empty();
}

}  // namespace

std::int32_t strips_height(const ContactSheet& sheet) {
  std::int32_t height = 2 * kPadding + kAxisHeight;
  if (!sheet.error_mm.empty()) height += kHeadHeight + kErrorHeight;
  if (!sheet.speed.empty()) height += 10 + kHeadHeight + kSpeedHeight;
  if (has_contacts(sheet)) height += 10 + kHeadHeight + 2 * kBarHeight + kBarGap;
  return height;
}

void draw_strips(Canvas& canvas, const Box& whole, const ContactSheet& sheet,
                 std::span<const std::int64_t> frames) {
  Box box = whole;
  if (!sheet.at_limit.empty()) {
    box.width -= kLimitsWidth + 16;
    draw_limit_bars(canvas, {box.x + box.width + 16, box.y, kLimitsWidth, box.height},
                    sheet.at_limit);
  }
  canvas.rounded(box, 10, palette::kCard);
  const Clip& clip = *sheet.target.clip;
  TimeAxis axis{double(box.x + kGutter), double(box.width - kGutter - 28), clip.frames(),
                clip.rate_hz, clip.start_s};
  std::int32_t y = box.y + kPadding;
  const std::int32_t first = y + kHeadHeight - 6;
  const auto apart = [&] { y += y > box.y + kPadding ? 10 : 0; };
  const auto graph = [&](std::int32_t graph_height, std::span<const Series> all) {
    y += kHeadHeight;
    draw_graph(canvas, axis, y, graph_height, all);
    y += graph_height;
  };
  if (!sheet.error_mm.empty()) {
    draw_name(canvas, box.x + 20, y + 11, "Largest effector error, mm");
    graph(kErrorHeight, std::array{Series{&sheet.error_mm, palette::kTarget, true}});
  }
  if (!sheet.speed.empty()) {
    apart();
    draw_name(canvas, box.x + 20, y + 15, "Speed of the fastest of hands, feet and head, m/s",
              {{"source", palette::kFaint}, {"target", palette::kInk}});
    std::vector<Series> speeds{{&sheet.speed, palette::kInk}};
    if (!sheet.source_speed.empty()) {
      speeds.insert(speeds.begin(), Series{&sheet.source_speed, palette::kFaint});
    }
    graph(kSpeedHeight, speeds);
  }
  if (has_contacts(sheet)) {
    apart();
    draw_name(canvas, box.x + 20, y + 17, "Foot contacts");
    y += kHeadHeight;
    draw_bar(canvas, axis, y, "left", palette::kLeft, sheet.left_contact);
    y += kBarHeight + kBarGap;
    draw_bar(canvas, axis, y, "right", palette::kRight, sheet.right_contact);
    y += kBarHeight;
  }
  const bool bare = y == box.y + kPadding;
  y += 8;
  draw_ticks(canvas, axis, bare ? y - 8 : first, y, frames);
  draw_axis(canvas, axis, y);
}

void draw_limit_bars(Canvas& canvas, const Box& box, std::span<const LimitTime> joints) {
  canvas.rounded(box, 10, palette::kCard);
  canvas.text(box.x + 20, box.y + kPadding + 11, "Joints on a limit, % of frames", 10,
              palette::kInk, Align::left, 1.15);
  const std::int32_t first = box.y + kPadding + 28, pitch = 22;
  const std::int32_t name = 170, left = box.x + 20 + name + 10;
  const std::int32_t full = box.x + box.width - 62 - left;
  const auto fit = static_cast<std::size_t>((box.y + box.height - 12 - first) / pitch);
  for (std::size_t i = 0; i < std::min(fit, joints.size()); ++i) {
    const std::int32_t y = first + static_cast<std::int32_t>(i) * pitch;
    canvas.text(left - 10, y + 11, Canvas::fitted(joints[i].joint, 8.5, name), 8.5, palette::kInk,
                Align::right);
    canvas.rounded({left, y, full, kBarHeight}, 4, {236, 239, 243});
    const auto length = static_cast<std::int32_t>(std::lround(full * joints[i].share));
    canvas.rounded({left, y, std::max(3, length), kBarHeight}, 3, palette::kTint);
    canvas.text(left + full + 8, y + 11, fmt::format("{:.0f}", 100.0 * joints[i].share), 8.5,
                palette::kMuted);
  }
}

}  // namespace limber
