#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "tests/bench/peers/report.h"
#include "validation/sheet_canvas.h"

namespace limber::peers {

namespace {

constexpr int kPanelWidth = 620, kPanelHeight = 420, kMargin = 24, kLegendRow = 22, kColumns = 2;
constexpr int kHeadroom = 110;  // above 100 %, where marks that share a place are piled up
constexpr int kLegendColumn = 300;

/// A panel's axes: mean microseconds, logarithmic, against the share solved.
struct Axes {
  Box box;
  double low = 0.0, high = 1.0;  // log10 us

  double x(double us) const {
    return box.x + box.width * (std::log10(std::max(us, 1e-3)) - low) / (high - low);
  }
  double y(double share) const { return box.y + box.height * (1.0 - share); }
};

Rgb colour_of(const Score& score) {
  if (score.ours) return palette::kReached;
  if (score.name.starts_with("ours")) return palette::kTint;
  return score.name.starts_with("MuJoCo") ? palette::kLeft : palette::kRight;
}

Axes axes_for(const Chapter& chapter, const Box& panel) {
  Axes axes{
      {panel.x + 52, panel.y + 44 + kHeadroom, panel.width - 76, panel.height - 92 - kHeadroom}};
  double least = 1e9, most = 0.0;
  for (const Score& s : chapter.scores) {
    if (!s.absent.empty()) continue;
    least = std::min(least, s.us_mean);
    most = std::max(most, s.us_mean);
  }
  if (most <= 0.0) return axes;
  axes.low = std::floor(std::log10(least));
  axes.high = std::max(std::ceil(std::log10(most)), axes.low + 1.0);
  return axes;
}

void draw_grid(Canvas& canvas, const Axes& axes) {
  const Box& b = axes.box;
  for (double decade = axes.low; decade <= axes.high + 0.5; decade += 1.0) {
    const double x = axes.x(std::pow(10.0, decade));
    canvas.line({x, double(b.y)}, {x, double(b.y + b.height)}, 1.0, palette::kRule);
    canvas.text(x, b.y + b.height + 20, fmt::format("{:g}", std::pow(10.0, decade)), 9.0,
                palette::kMuted, Align::centre);
  }
  for (int percent = 0; percent <= 100; percent += 25) {
    const double y = axes.y(0.01 * percent);
    canvas.line({double(b.x), y}, {double(b.x + b.width), y}, 1.0, palette::kRule);
    canvas.text(b.x - 12, y + 4, fmt::format("{}", percent), 9.0, palette::kMuted, Align::right);
  }
  canvas.text(b.x + b.width, b.y + b.height + 38, "mean us per frame", 9.0, palette::kMuted,
              Align::right);
}

void mark(Canvas& canvas, const Eigen::Vector2d& at, std::size_t number, Rgb colour) {
  canvas.disc(at, 9.5, palette::kCard);
  canvas.disc(at, 8.5, colour);
  canvas.text(at.x(), at.y() + 4, fmt::format("{}", number), 8.0, palette::kCard, Align::centre,
              1.3);
}

/// Marks that would cover each other are piled up, in order of time, on a stem to their place.
void draw_marks(Canvas& canvas, const Chapter& chapter, const Axes& axes) {
  std::vector<std::size_t> order;
  for (std::size_t i = 0; i < chapter.scores.size(); ++i) {
    if (chapter.scores[i].absent.empty()) order.push_back(i);
  }
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return chapter.scores[a].us_mean < chapter.scores[b].us_mean;
  });
  std::vector<Eigen::Vector2d> taken;
  for (const std::size_t i : order) {
    const Score& s = chapter.scores[i];
    Eigen::Vector2d at(axes.x(s.us_mean), axes.y(s.success));
    const double true_y = at.y();
    const auto covers = [&](const Eigen::Vector2d& p) { return (p - at).norm() < 18.0; };
    while (std::any_of(taken.begin(), taken.end(), covers)) at.y() -= 6.0;
    if (at.y() < true_y) canvas.line({at.x(), true_y}, at, 1.5, colour_of(s), 0.5);
    mark(canvas, at, i + 1, colour_of(s));
    taken.push_back(at);
  }
}

/// Names by number, per panel: sets of lone poses have fewer contestants.
void draw_legend(Canvas& canvas, const Chapter& chapter, const Box& panel) {
  for (std::size_t i = 0; i < chapter.scores.size(); ++i) {
    const double y = panel.y + 54.0 + kLegendRow * 0.72 * static_cast<double>(i);
    mark(canvas, {panel.x + 10.0, y}, i + 1, colour_of(chapter.scores[i]));
    canvas.text(panel.x + 28, y + 4, chapter.scores[i].name, 8.5, palette::kInk);
  }
}

}  // namespace

std::vector<unsigned char> plot_report(const std::vector<Chapter>& chapters) {
  const int rows = (static_cast<int>(chapters.size()) + kColumns - 1) / kColumns;
  const int cell = kPanelWidth + kLegendColumn + kMargin;
  Canvas canvas(kMargin + kColumns * cell, kMargin + std::max(rows, 1) * (kPanelHeight + kMargin),
                palette::kPage);
  for (std::size_t i = 0; i < chapters.size(); ++i) {
    const int column = static_cast<int>(i) % kColumns, row = static_cast<int>(i) / kColumns;
    const Box panel{kMargin + column * cell, kMargin + row * (kPanelHeight + kMargin), kPanelWidth,
                    kPanelHeight};
    canvas.rounded({panel.x, panel.y, cell - kMargin, panel.height}, 8.0, palette::kCard);
    canvas.text(panel.x + 20, panel.y + 26, chapters[i].workload + ": share solved, %", 11.0,
                palette::kInk, Align::left, 1.4);
    const Axes axes = axes_for(chapters[i], panel);
    draw_grid(canvas, axes);
    draw_marks(canvas, chapters[i], axes);
    draw_legend(canvas, chapters[i], {panel.x + kPanelWidth, panel.y, 0, 0});
  }
  Result<std::vector<std::byte>> png = encode_png(canvas.take());
  if (!png) return {};
  const auto* bytes = reinterpret_cast<const unsigned char*>(png->data());
  return {bytes, bytes + png->size()};
}

}  // namespace limber::peers
