#include <cctype>

#include "validation/sheet_parts.h"

namespace limber {
namespace {

Rgb verdict_color(const std::string& verdict) {
  return verdict == "pass"   ? palette::kPass
         : verdict == "warn" ? palette::kWarn
         : verdict == "fail" ? palette::kFail
                             : palette::kMuted;
}

}  // namespace

double draw_legend(Canvas& canvas, const Eigen::Vector2d& right_base, const BodyPlan& plan,
                   bool marks, bool tinted) {
  double right = right_base.x();
  const auto entry = [&](const char* word, Rgb color) {
    right -= canvas.text(right, right_base.y(), word, 9.5, palette::kMuted, Align::right);
    canvas.disc({right - 12, right_base.y() - 4.5}, 5.0, color);
    right -= 36;
  };
  if (marks) {
    entry("reached", palette::kReached);
    entry("effector target", palette::kTarget);
  }
  if (tinted) entry("on a limit", palette::kTint);
  if (plan.hand_only) {
    for (std::size_t f = palette::kFingers.size(); f-- > 0;) {
      entry(palette::kFingerNames[f], palette::kFingers[f]);
    }
  } else if (plan.stands) {
    entry("right", palette::kRight);
    entry("left", palette::kLeft);
  }
  return right;
}

void draw_head(Canvas& canvas, const Box& box, const ContactSheet& sheet, const BodyPlan& plan) {
  double x = box.x;
  if (!sheet.verdict.empty()) {
    std::string word = sheet.verdict;
    for (char& c : word) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
    const double width = Canvas::text_width(word, 12) + 32;
    canvas.rounded({static_cast<std::int32_t>(x), box.y + 4, static_cast<std::int32_t>(width), 32},
                   16, verdict_color(sheet.verdict));
    canvas.text(x + 0.5 * width, box.y + 26, word, 12, {255, 255, 255}, Align::centre, 1.4);
    x += width + 18;
  }
  canvas.text(x, box.y + 30, Canvas::fitted(sheet.title, 19, 0.6 * box.width), 19, palette::kInk,
              Align::left, 0.95);
  draw_legend(canvas, Eigen::Vector2d(box.x + box.width, box.y + 26), plan, !sheet.marks.empty(),
              !sheet.tinted_joints.empty());
  // Key figures.
  x = box.x;
  for (const std::string& figure : sheet.key_figures) {
    const double width = Canvas::text_width(figure, 10) + 28;
    if (x + width > box.x + box.width) break;
    canvas.rounded({static_cast<std::int32_t>(x), box.y + 52, static_cast<std::int32_t>(width), 30},
                   8, palette::kCard);
    canvas.text(x + 0.5 * width, box.y + 72, figure, 10, palette::kInk, Align::centre);
    x += width + 10;
  }
}

}  // namespace limber
