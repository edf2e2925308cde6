// A walk cycle closes in its joints, in its pelvis's height and tilt, and nowhere else: a lap takes
// the figure on over the floor and may turn it. That motion of a lap is what is left between the
// first frame and the frame after the last one, once tilt and height agree.
#include "pipeline/source_cycle.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace limber {
namespace {

using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr std::int64_t kLeastFrames = 8;
constexpr double kSameDeg = 0.1, kSameM = 1e-3;  // a frame that repeats another
constexpr double kAsNearby = 1.5;                // of the steps beside it: a step across the seam
constexpr double kSlackDeg = 0.3, kSlackM = 2e-3;
constexpr double kElsewhereDeg = 5.0;  // a joint that turned less went nowhere,
constexpr double kMuchFarther = 10.0;  // nor one not this many times the step at the seam

double degrees(const Quaterniond& a, const Quaterniond& b) {
  return rotation_angle(a, b) * 180.0 / M_PI;
}

/// The part of a rotation that is about +Y.
Quaterniond yaw_of(const Quaterniond& q) {
  const Quaterniond yaw(q.w(), 0.0, q.y(), 0.0);
  return yaw.norm() < 1e-9 ? Quaterniond::Identity() : yaw.normalized();
}

/// The motion over the floor that takes one place of the pelvis over another.
DualQuaternion over_floor(const DualQuaternion& from, const DualQuaternion& to) {
  const Quaterniond yaw = yaw_of(to.rotation() * from.rotation().conjugate());
  Vector3d way = to.translation() - yaw * from.translation();
  way.y() = 0.0;
  return DualQuaternion::from_rotation_translation(yaw, way);
}

/// How two frames differ, but for where on the floor the figure is and which way it faces.
struct Difference {
  std::vector<double> turn_deg;  // [joint], of the figure's order
  double height_m = 0.0;
};

class Frames {
 public:
  explicit Frames(const SourceMotion& source)
      : source_(source), model_(source.character->skeleton.parents.size()) {}

  std::int64_t count() const { return source_.clip->frames(); }

  DualQuaternion pelvis(std::int64_t frame) {
    model_from_local(source_.character->skeleton, source_.clip->frame(frame), model_);
    return model_[source_.figure->root()];
  }

  Difference difference(std::int64_t from, std::int64_t to) {
    const DualQuaternion a = pelvis(from), b = pelvis(to);
    const DualQuaternion over = over_floor(a, b);
    Difference out;
    out.height_m = std::abs(b.translation().y() - a.translation().y());
    const auto before = source_.clip->frame(from), after = source_.clip->frame(to);
    for (const std::int32_t j : source_.figure->order) {
      if (j == source_.figure->root()) {
        out.turn_deg.push_back(degrees(over.rotation() * a.rotation(), b.rotation()));
      } else if (under_root(j)) {
        out.turn_deg.push_back(degrees(before[j].rotation(), after[j].rotation()));
      }
    }
    return out;
  }

 private:
  bool under_root(std::int32_t j) const {
    const auto& parents = source_.character->skeleton.parents;
    while (j != kNoJoint && j != source_.figure->root()) j = parents[j];
    return j != kNoJoint;
  }

  const SourceMotion& source_;
  std::vector<DualQuaternion> model_;
};

bool is_same(const Difference& d) {
  return d.height_m < kSameM && std::ranges::max(d.turn_deg) < kSameDeg;
}

/// A step no larger than those before and after it.
bool goes_on(const Difference& step, const Difference& before, const Difference& after) {
  const auto fits = [](double x, double a, double b, double slack) {
    return x < kAsNearby * std::max(a, b) + slack;
  };
  for (std::size_t i = 0; i < step.turn_deg.size(); ++i) {
    if (!fits(step.turn_deg[i], before.turn_deg[i], after.turn_deg[i], kSlackDeg)) return false;
  }
  return fits(step.height_m, before.height_m, after.height_m, kSlackM);
}

/// Somewhere in the clip a joint is much farther from the first frame than the last frame is.
bool goes_elsewhere(Frames& frames, const Difference& seam) {
  const double least = std::max(kElsewhereDeg, kMuchFarther * std::ranges::max(seam.turn_deg));
  const std::int64_t step = std::max<std::int64_t>(1, frames.count() / 64);
  for (std::int64_t f = 0; f < frames.count(); f += step) {
    if (std::ranges::max(frames.difference(0, f).turn_deg) > least) return true;
  }
  return false;
}

}  // namespace

std::optional<SourceCycle> find_cycle(const SourceMotion& source) {
  const std::int64_t last = source.clip->frames() - 1;
  if (!source.figure->is_body() || last + 1 < kLeastFrames) return std::nullopt;
  Frames frames(source);
  const Difference seam = frames.difference(last, 0);
  if (!goes_elsewhere(frames, seam)) return std::nullopt;
  const DualQuaternion first = frames.pelvis(0), final = frames.pelvis(last);
  const auto cycle = [&](std::int64_t period, const DualQuaternion& next) {
    const DualQuaternion lap = over_floor(first, next);
    const Vector3d way = lap.transform_point(first.translation()) - first.translation();
    return SourceCycle{period, period == last, lap, way.norm()};
  };
  if (is_same(seam)) return cycle(last, final);
  const Difference before = frames.difference(last - 1, last), after = frames.difference(0, 1);
  if (!goes_on(seam, before, after)) return std::nullopt;
  // The frame after the last one goes on as the steps beside it do, each seen from its pelvis.
  const DualQuaternion step_before = over_floor(frames.pelvis(last - 1), final);
  const DualQuaternion step_after = over_floor(first, frames.pelvis(1));
  const auto seen_way = [](const DualQuaternion& step, const DualQuaternion& from) {
    const Vector3d moved = step.transform_point(from.translation()) - from.translation();
    return Vector3d(yaw_of(from.rotation()).conjugate() * moved);
  };
  const Vector3d way =
      0.5 * (seen_way(step_before, frames.pelvis(last - 1)) + seen_way(step_after, first));
  const Quaterniond yaw = step_before.rotation().slerp(0.5, step_after.rotation());
  const DualQuaternion next = DualQuaternion::from_rotation_translation(
      yaw * final.rotation(), final.translation() + yaw_of(final.rotation()) * way);
  return cycle(last + 1, next);
}

Clip with_laps(const Skeleton& skeleton, const Clip& clip, const SourceCycle& cycle,
               std::int64_t frames) {
  Clip out = clip;
  out.parent_from_joint.clear();
  out.start_s -= double(frames) / clip.rate_hz;
  const auto add = [&](std::int64_t frame, const DualQuaternion& moved) {
    const auto from = clip.frame(frame);
    for (std::int32_t j = 0; j < skeleton.size(); ++j) {
      const bool root = skeleton.parents[j] == kNoJoint;
      out.parent_from_joint.push_back(root ? moved * from[j] : from[j]);
    }
  };
  for (std::int64_t f = -frames; f < clip.frames() + frames; ++f) {
    if (f < 0) {
      add(f + cycle.period, cycle.lap.conjugate());
    } else if (f < clip.frames()) {
      add(f, DualQuaternion::identity());
    } else {
      add(f - cycle.period, cycle.lap);
    }
  }
  return out;
}

}  // namespace limber
