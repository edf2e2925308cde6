#include "pipeline/foot_contacts.h"

#include <algorithm>
#include <cmath>

#include "pipeline/smooth_cover.h"
#include "validation/contact_detection.h"

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kSwingBackS = 0.30;   // a pinned foot's offset is given back within this time
constexpr double kEaseS = 0.06;        // pins take hold, and soles settle, over this time
constexpr double kMaxSettleM = 0.06;   // a standing foot is lowered by no more than this
constexpr double kMaxLevelled = 0.17;  // rad; a standing foot is flattened by no more than this
constexpr double kNearFloorM = 0.02;   // below this a foot's place is held as if it stood

enum class Pin : std::uint8_t { none, ankle, toes };

double smooth_step(double t) {
  t = std::clamp(t, 0.0, 1.0);
  return t * t * (3.0 - 2.0 * t);
}

/// [frame] whether a point of the source's foot stands.
std::vector<std::uint8_t> stands(const FootPath& path, const std::vector<Vector3d>& track,
                                 double floor) {
  ContactOptions options;
  options.scale = path.speed_scale;
  options.release_height = 1.3;
  options.release_speed = 1.5;
  return contact_mask(detect_contacts(track, path.rate_hz, floor, options),
                      static_cast<std::int64_t>(track.size()));
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
std::vector<double> eased(const std::vector<std::uint8_t>& stands, double rate_hz) {
  const auto frames = static_cast<std::int64_t>(stands.size());
  const auto half = std::max<std::int64_t>(1, std::llround(kEaseS * rate_hz));
  std::vector<double> out(stands.size());
  for (std::int64_t f = 0; f < frames; ++f) {
    const std::int64_t a = std::max<std::int64_t>(0, f - half), b = std::min(frames - 1, f + half);
    const auto standing = std::count(stands.begin() + a, stands.begin() + b + 1, 1);
    out[f] = smooth_step(double(standing) / double(b - a + 1));
  }
  return out;
}

/// The turn about a level axis that takes `share` of the slope from a line along the sole.
Quaterniond levelling(const Vector3d& along, double share) {
  const Vector3d run = horizontal(along);
  if (run.norm() < 1e-6) return Quaterniond::Identity();
  const double slope = std::atan2(along.y(), run.norm());
  const double taken = share * std::clamp(slope, -kMaxLevelled, kMaxLevelled);
  return Quaterniond(Eigen::AngleAxisd(taken, Vector3d::UnitY().cross(run).normalized()));
}

/// A recorded foot whose heel and ball both stand is seldom quite flat; one that is drawn is, or
/// its heel floats. Toes never point into the floor that their ball stands on.
void level_soles(FootPath& path, const std::vector<double>& heel, const std::vector<double>& ball) {
  for (std::size_t f = 0; f < path.ankle.size(); ++f) {
    const Vector3d sole = path.foot_turn[f] * (path.ball - path.heel);
    path.foot_turn[f] = levelling(sole, std::min(heel[f], ball[f])) * path.foot_turn[f];
    const Vector3d toes = path.toes_turn[f] * (path.tip - path.ball);
    if (toes.y() < 0.0) path.toes_turn[f] = levelling(toes, ball[f]) * path.toes_turn[f];
  }
}

/// The lowest point of the sole above the floor.
double clearance(const FootPath& path, std::size_t f) {
  const Vector3d ball = path.foot_turn[f] * path.ball;
  const Vector3d tip = ball + path.toes_turn[f] * (path.tip - path.ball);
  return path.ankle[f].y() - path.floor_y +
         std::min({(path.foot_turn[f] * path.heel).y(), ball.y(), tip.y()});
}

void settle_soles(FootPath& path, const std::vector<double>& standing) {
  for (std::size_t f = 0; f < path.ankle.size(); ++f) {
    const double lowest = clearance(path, f);
    path.ankle[f].y() -= lowest < 0.0 ? lowest : standing[f] * std::min(lowest, kMaxSettleM);
  }
}

/// Full while the foot stands or nearly touches the floor, eased around that.
std::vector<double> holds(const FootPath& path, const std::vector<double>& standing) {
  const auto frames = static_cast<std::int64_t>(path.ankle.size());
  const auto half = std::max<std::int64_t>(1, std::llround(kEaseS * path.rate_hz));
  std::vector<double> needed(standing), out(standing.size());
  for (std::int64_t f = 0; f < frames; ++f) {
    needed[f] = std::max(standing[f], smooth_step(1.0 - clearance(path, f) / kNearFloorM));
  }
  const std::vector<double> wide = running_max(needed, half);
  for (std::int64_t f = 0; f < frames; ++f) {
    double sum = 0.0, weight = 0.0;
    for (std::int64_t d = -half; d <= half; ++d) {
      if (f + d < 0 || f + d >= frames) continue;
      const double w = 1.0 - double(std::abs(d)) / double(half + 1);
      sum += w * wide[f + d];
      weight += w;
    }
    out[f] = sum / weight;
  }
  return out;
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
  const std::vector<std::uint8_t> heel = stands(path, path.source_ankle, source_ankle_floor);
  const std::vector<std::uint8_t> ball = stands(path, path.source_toe, source_toe_floor);
  std::vector<Pin> pin(heel.size(), Pin::none);
  for (std::size_t f = 0; f < pin.size(); ++f) {
    pin[f] = heel[f] != 0   ? Pin::ankle
             : ball[f] != 0 ? Pin::toes
                            : Pin::none;  // a flat foot is held by its ankle
    path.contact.push_back(pin[f] != Pin::none);
  }
  level_soles(path, eased(heel, path.rate_hz), eased(ball, path.rate_hz));
  pin_horizontally(path, pin);
  const std::vector<double> standing = eased(path.contact, path.rate_hz);
  settle_soles(path, standing);
  path.hold = holds(path, standing);
}

}  // namespace limber
