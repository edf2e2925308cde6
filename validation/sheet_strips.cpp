#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "validation/sheet_parts.h"

namespace limber {
namespace {

constexpr std::int32_t kErrorHeight = 92, kBarHeight = 14, kBarGap = 8, kAxisHeight = 34;
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

void draw_error(Canvas& canvas, const TimeAxis& axis, std::int32_t top,
                const std::vector<double>& error_mm) {
  double most = 0.0;
  for (const double e : error_mm) most = std::isfinite(e) ? std::max(most, e) : most;
  const double full = round_above(std::max(most * 1.04, 0.1), {1, 1.5, 2, 2.5, 3, 4, 5, 6, 8});
  const double bottom = top + kErrorHeight;
  const auto y_of = [&](double mm) { return bottom - kErrorHeight * std::min(mm / full, 1.0); };
  for (const double part : {0.0, 0.5, 1.0}) {
    canvas.line({axis.x0, y_of(part * full)}, {axis.x0 + axis.width, y_of(part * full)}, 1.0,
                palette::kRule);
    canvas.text(axis.x0 - 10, y_of(part * full) + 4, fmt::format("{:g}", part * full), 8.5,
                palette::kMuted, Align::right);
  }
  // One column per pixel: the largest error of the frames it covers.
  const auto last = static_cast<std::int64_t>(error_mm.size()) - 1;
  Eigen::Vector2d before(0, 0);
  for (int px = 0; px <= static_cast<int>(axis.width); ++px) {
    const double f = axis.frame_at(axis.x0 + px), half = 0.5 * axis.frame_at(axis.x0 + 1.0);
    const auto low = std::clamp<std::int64_t>(std::llround(std::ceil(f - half)), 0, last);
    const auto high = std::clamp<std::int64_t>(std::llround(std::floor(f + half)), 0, last);
    double e = 0.0;
    if (low > high) {  // between two frames
      const auto a = std::clamp<std::int64_t>(static_cast<std::int64_t>(f), 0, last);
      const double t = f - static_cast<double>(a);
      e = (1 - t) * error_mm[a] + t * error_mm[std::min(a + 1, last)];
    }
    for (std::int64_t k = low; k <= high; ++k) e = std::max(e, error_mm[k]);
    if (!std::isfinite(e)) e = full;
    const Eigen::Vector2d now(axis.x0 + px, y_of(e));
    const auto y = static_cast<std::int32_t>(std::floor(now.y()));
    canvas.fill({static_cast<std::int32_t>(now.x()), y, 1, static_cast<std::int32_t>(bottom) - y},
                palette::kTarget, 0.14);
    if (px > 0) canvas.line(before, now, 1.6, palette::kTarget);
    before = now;
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
  if (has_contacts(sheet)) height += 10 + kHeadHeight + 2 * kBarHeight + kBarGap;
  return height;
}

void draw_strips(Canvas& canvas, const Box& box, const ContactSheet& sheet,
                 std::span<const std::int64_t> frames) {
  canvas.rounded(box, 10, palette::kCard);
  const Clip& clip = *sheet.target.clip;
  TimeAxis axis{double(box.x + kGutter), double(box.width - kGutter - 28), clip.frames(),
                clip.rate_hz, clip.start_s};
  std::int32_t y = box.y + kPadding;
  const std::int32_t first = y + kHeadHeight - 6;
  if (!sheet.error_mm.empty()) {
    canvas.text(box.x + 20, y + 11, "Largest effector error, mm", 10, palette::kInk, Align::left,
                1.15);
    y += kHeadHeight;
    draw_error(canvas, axis, y, sheet.error_mm);
    y += kErrorHeight;
  }
  if (has_contacts(sheet)) {
    if (!sheet.error_mm.empty()) y += 10;
    canvas.text(box.x + 20, y + 17, "Foot contacts", 10, palette::kInk, Align::left, 1.15);
    y += kHeadHeight;
    draw_bar(canvas, axis, y, "left", palette::kLeft, sheet.left_contact);
    y += kBarHeight + kBarGap;
    draw_bar(canvas, axis, y, "right", palette::kRight, sheet.right_contact);
    y += kBarHeight;
  }
  y += 8;
  draw_ticks(canvas, axis, sheet.error_mm.empty() && !has_contacts(sheet) ? y - 8 : first, y,
             frames);
  draw_axis(canvas, axis, y);
}

}  // namespace limber
