#include "pipeline/foot_contacts.h"

#include <algorithm>
#include <cmath>

#include "validation/contact_detection.h"

namespace limber {
namespace {

using Eigen::Vector3d;

constexpr double kSwingBackS = 0.30;  // a pinned foot's offset is given back within this time
constexpr double kEaseS = 0.06;       // pins take hold, and soles settle, over this time
constexpr double kMaxSettleM = 0.06;  // a standing foot is lowered by no more than this

enum class Pin : std::uint8_t { none, ankle, toes };

double smooth_step(double t) {
  t = std::clamp(t, 0.0, 1.0);
  return t * t * (3.0 - 2.0 * t);
}

std::vector<Pin> pins(const FootPath& path, double ankle_floor, double toe_floor) {
  ContactOptions options;
  options.scale = path.speed_scale;
  options.release_height = 1.3;
  options.release_speed = 1.5;
  std::vector<Pin> out(path.ankle.size(), Pin::none);
  const auto mark = [&](const std::vector<Vector3d>& track, double floor, Pin pin) {
    for (const auto& [begin, end] : detect_contacts(track, path.rate_hz, floor, options)) {
      std::fill(out.begin() + begin, out.begin() + end, pin);
    }
  };
  mark(path.source_toe, toe_floor, Pin::toes);
  mark(path.source_ankle, ankle_floor, Pin::ankle);  // a flat foot is held by its ankle
  return out;
}

Vector3d horizontal(Vector3d v) {
  v.y() = 0.0;
  return v;
}

void pin_horizontally(FootPath& path, const std::vector<Pin>& pin) {
  const auto frames = static_cast<std::int64_t>(path.ankle.size());
  const double ease_frames = std::max(1.0, kEaseS * path.rate_hz);
  Vector3d offset = Vector3d::Zero(), released = Vector3d::Zero(), anchor = Vector3d::Zero();
  std::int64_t since_change = 0, swing_frames = 1;
  Pin before = Pin::none;
  for (std::int64_t f = 0; f < frames; ++f) {
    const auto point = [&] {
      return pin[f] == Pin::toes ? Vector3d(path.ankle[f] + path.foot_turn[f] * path.toe_joint)
                                 : path.ankle[f];
    };
    if (pin[f] != before) {
      since_change = 0;
      if (pin[f] == Pin::none) {
        released = offset;
        std::int64_t next = f;
        while (next < frames && pin[next] == Pin::none) ++next;
        swing_frames = std::clamp<std::int64_t>(
            next - f, 1, std::max<std::int64_t>(1, std::llround(kSwingBackS * path.rate_hz)));
      } else {
        anchor = point() + offset;
      }
      before = pin[f];
    }
    if (pin[f] == Pin::none) {
      offset = (1.0 - smooth_step(double(since_change + 1) / double(swing_frames))) * released;
    } else {
      const Vector3d pinned = horizontal(anchor - point());
      offset += smooth_step(double(since_change) / ease_frames) * (pinned - offset);
    }
    path.ankle[f] += offset;
    ++since_change;
  }
}

/// Share of standing frames around each frame: 1 well inside a contact, 0 well outside.
std::vector<double> settled(const std::vector<Pin>& pin, double rate_hz) {
  const auto frames = static_cast<std::int64_t>(pin.size());
  const auto half = std::max<std::int64_t>(1, std::llround(kEaseS * rate_hz));
  std::vector<double> out(pin.size());
  for (std::int64_t f = 0; f < frames; ++f) {
    const std::int64_t a = std::max<std::int64_t>(0, f - half), b = std::min(frames - 1, f + half);
    std::int64_t standing = 0;
    for (std::int64_t k = a; k <= b; ++k) standing += pin[k] != Pin::none;
    out[f] = smooth_step(double(standing) / double(b - a + 1));
  }
  return out;
}

void settle_soles(FootPath& path, const std::vector<Pin>& pin) {
  const std::vector<double> standing = settled(pin, path.rate_hz);
  for (std::size_t f = 0; f < path.ankle.size(); ++f) {
    const Vector3d ball = path.foot_turn[f] * path.ball;
    const Vector3d tip = ball + path.toes_turn[f] * (path.tip - path.ball);
    const double lowest = path.ankle[f].y() - path.floor_y +
                          std::min({(path.foot_turn[f] * path.heel).y(), ball.y(), tip.y()});
    path.ankle[f].y() -= lowest < 0.0 ? lowest : standing[f] * std::min(lowest, kMaxSettleM);
  }
}

}  // namespace

FootPath make_foot(const Target& target, Side side) {
  const Calibration& calibration = target.calibration;
  const std::int32_t foot = target.figure.at(on_side(Role::leftFoot, side));
  const std::int32_t toes = target.figure.at(on_side(Role::leftToes, side));
  const Vector3d ankle = calibration.position(foot);
  const Vector3d bone = calibration.model_from_joint[foot].rotation() * calibration.tip[foot];
  FootPath path;
  path.toe_joint = toes != kNoJoint ? Vector3d(calibration.position(toes) - ankle) : bone;
  const double length = std::max(0.05 * calibration.leg_length, horizontal(path.toe_joint).norm());
  const Vector3d down(0.0, calibration.sole - ankle.y(), 0.0);
  path.heel = down - 0.35 * length * Vector3d::UnitZ();
  path.ball = down + horizontal(path.toe_joint);
  path.tip = path.ball + 0.4 * length * Vector3d::UnitZ();
  return path;
}

void plant(FootPath& path, double source_ankle_floor, double source_toe_floor) {
  const std::vector<Pin> pin = pins(path, source_ankle_floor, source_toe_floor);
  pin_horizontally(path, pin);
  settle_soles(path, pin);
  for (const Pin p : pin) path.contact.push_back(p == Pin::none ? 0 : 1);
}

}  // namespace limber
