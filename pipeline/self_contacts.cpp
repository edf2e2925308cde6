// Bodies of other proportions carry the source's hands into their own hips. Here they are kept out.
//
// Both figures are capsules (body_capsules.cpp). For a pair of parts let g(t) be the gap in the
// solved clip and a(t) = min(scaled gap of the source, 0) the least that is asked for: hands that
// touch go on touching, and only where the source is deeper itself may the target be. What lacks is
// v = max(0, a - g). A row that began to press at v > 0 would start and stop moving the arm at once,
// which is seen. So the row asks for
//   gap >= g + s,   s = w * max over a window of v
// with w an average over the same window by smooth weights: s >= v, because each value that is
// averaged over has v's own place in its window, and s rises from 0 and returns to it smoothly.
//
// Each frame is a projection: the nearest pose to the solved one, in the measure of the effectors'
// cost, that keeps the gaps and the limits. That is the constrained solve itself as far as
// Gauss-Newton sees it, expanded about the solve without rows: the goals are where that has left
// the effectors, so a frame in which nothing presses is that very frame. Ways out on either side of
// a limb are told apart as in the solve, by passes that are joined.
#include "pipeline/self_contacts.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "pipeline/body_capsules.h"
#include "pipeline/clip_passes.h"
#include "solver/ik_solver.h"

namespace limber {
namespace {

constexpr double kEaseS = 0.15;    // half a window
constexpr double kNothing = 1e-6;  // m: a push that counts as none

/// Values per frame and pair of parts.
struct PairTrack {
  explicit PairTrack(std::int64_t frames)
      : values(static_cast<std::size_t>(frames) * part_pairs().size()) {}
  std::span<double> at(std::int64_t frame) {
    const std::size_t n = part_pairs().size();
    return {values.data() + std::size_t(frame) * n, n};
  }
  std::vector<double> values;
};

/// [frame] A smooth function that is at least v and 0 where v is 0 all around.
std::vector<double> smooth_cover(const std::vector<double>& v, std::int64_t reach) {
  const auto last = static_cast<std::int64_t>(v.size()) - 1;
  std::vector<double> highest(v.size()), out(v.size(), 0.0), weight;
  double sum = 0.0;
  for (std::int64_t k = -reach; k <= reach; ++k) {
    weight.push_back(1.0 + std::cos(M_PI * double(k) / double(reach + 1)));
    sum += weight.back();
  }
  for (std::int64_t f = 0; f <= last; ++f) {
    const auto from = v.begin() + std::max<std::int64_t>(f - reach, 0);
    highest[f] = *std::max_element(from, v.begin() + std::min(f + reach, last) + 1);
  }
  for (std::int64_t f = 0; f <= last; ++f) {
    for (std::int64_t k = -reach; k <= reach; ++k) {
      out[f] += weight[k + reach] / sum * highest[std::clamp<std::int64_t>(f + k, 0, last)];
    }
  }
  return out;
}

class Separation {
 public:
  Separation(const SourceMotion& source, const Target& target, const Rig& rig,
             const EffectorTrack& track, Clip& clip)
      : source_(source),
        target_(target),
        track_(track),
        clip_(clip),
        rig_(rig),
        frames_(clip.frames()),
        rows_(rig.joints.size()),
        allowed_(frames_),
        gap_(frames_),
        push_(frames_) {}

  Result<SelfContactFigures> run() {
    if (!measure_source() || !place_capsules()) return figures_;
    measure_target();
    figures_.measured = true;
    figures_.before_m = figures_.left_m = largest_lack();
    if (!plan_pushes()) return figures_;
    if (auto r = press(); !r) return r.error();
    measure_target();
    figures_.left_m = largest_lack();
    return figures_;
  }

 private:
  /// The least gaps, from the source; false where there is no body.
  bool measure_source() {
    const auto capsules = body_capsules(*source_.character, *source_.figure, *source_.calibration);
    if (capsules.empty()) return false;
    const double scale = girth_scale(target_.figure, target_.calibration) /
                         girth_scale(*source_.figure, *source_.calibration);
    std::vector<DualQuaternion> model(source_.character->skeleton.parents.size());
    for (std::int64_t f = 0; f < frames_; ++f) {
      model_from_local(source_.character->skeleton, source_.clip->frame(f), model);
      part_gaps(capsules, model, allowed_.at(f));
      for (double& gap : allowed_.at(f)) gap = std::min(scale * gap, 0.0);
    }
    return true;
  }

  /// The target's capsules on the rig's rows, and which rows are to stay apart.
  bool place_capsules() {
    capsules_ = body_capsules(target_.character, target_.figure, target_.calibration);
    rig_.collisions.clear();
    for (RigJoint& row : rig_.joints) row.capsules.clear();
    for (PartCapsule& c : capsules_) {
      const auto row = std::ranges::find(target_.joint_of_row, c.joint);
      c.joint = static_cast<std::int32_t>(row - target_.joint_of_row.begin());
      rig_.joints[c.joint].capsules.push_back(c.capsule);
    }
    for (std::size_t k = 0; k < part_pairs().size(); ++k) {
      for (const PartCapsule& a : capsules_) {
        for (const PartCapsule& b : capsules_) {
          if (a.part != part_pairs()[k].a || b.part != part_pairs()[k].b) continue;
          rig_.collisions.push_back({a.joint, b.joint});
          pair_of_.push_back(k);
        }
      }
    }
    return !pair_of_.empty();
  }

  void measure_target() {
    std::vector<DualQuaternion> model(rows_);
    for (std::int64_t f = 0; f < frames_; ++f) {
      model_from_rows(rig_, clip_.frame(f), model);
      part_gaps(capsules_, model, gap_.at(f));
    }
  }

  std::vector<double> largest_lack() {
    std::vector<double> out(static_cast<std::size_t>(frames_), 0.0);
    for (std::int64_t f = 0; f < frames_; ++f) {
      for (std::size_t k = 0; k < part_pairs().size(); ++k) {
        out[f] = std::max(out[f], allowed_.at(f)[k] - gap_.at(f)[k]);
      }
    }
    return out;
  }

  /// By how much each pair is pushed; false where nothing is.
  bool plan_pushes() {
    const auto reach = static_cast<std::int64_t>(std::lround(kEaseS * clip_.rate_hz));
    figures_.pressed.assign(static_cast<std::size_t>(frames_), 0);
    bool some = false;
    for (std::size_t k = 0; k < part_pairs().size(); ++k) {
      std::vector<double> lack(static_cast<std::size_t>(frames_));
      for (std::int64_t f = 0; f < frames_; ++f) {
        lack[f] = std::max(0.0, allowed_.at(f)[k] - gap_.at(f)[k]);
      }
      if (*std::ranges::max_element(lack) < kNothing) continue;
      const std::vector<double> cover = smooth_cover(lack, reach);
      for (std::int64_t f = 0; f < frames_; ++f) {
        if (cover[f] < kNothing) continue;
        push_.at(f)[k] = cover[f];
        figures_.pressed[f] = 1;
        some = true;
      }
    }
    return some;
  }

  Result<void> press() {
    IkOptions options;
    options.stop_at_tolerance = false;
    options.collision = true;
    options.measure_residual = false;
    auto solver = IkSolver::create(rig_, options);
    if (!solver) return solver.error();
    for (std::int64_t first = 0; first < frames_;) {
      std::int64_t end = first;
      while (end < frames_ && figures_.pressed[end] != 0) ++end;
      if (end > first) press_run(*solver, first, end);
      first = end + 1;
    }
    return {};
  }

  /// The frames [first, end) and, where there are such, a frame that stays on either side.
  void press_run(IkSolver& solver, std::int64_t first, std::int64_t end) {
    const std::int64_t from = std::max<std::int64_t>(first - 1, 0), to = std::min(end + 1, frames_);
    const std::int64_t count = to - from;
    Pass own(count, rows_), forward(count, rows_), backward(count, rows_);
    for (Pass* pass : {&own, &forward, &backward}) {
      std::copy_n(clip_.frame(from).begin(), std::size_t(count) * rows_, pass->poses.begin());
    }
    const auto pressed = [&](std::int64_t i) { return figures_.pressed[from + i] != 0; };
    for (std::int64_t i = 0; i < count; ++i) {
      if (pressed(i)) solve(solver, from + i, clip_.frame(from + i), own, i);
    }
    for (std::int64_t i = 0; i < count; ++i) {
      if (!pressed(i)) continue;
      solve(solver, from + i, i == 0 ? own.pose(0) : forward.pose(i - 1), forward, i);
    }
    for (std::int64_t i = count - 1; i >= 0; --i) {
      if (!pressed(i)) continue;
      if (same_solution(own, forward, i)) {
        std::ranges::copy(forward.pose(i), backward.pose(i).begin());
        backward.cost[i] = forward.cost[i];
      } else {
        solve(solver, from + i, i == count - 1 ? own.pose(i) : backward.pose(i + 1), backward, i);
      }
    }
    const auto joined = join_passes(std::array<const Pass*, 3>{&own, &forward, &backward});
    std::ranges::copy(joined, clip_.frame(from).begin());
  }

  void solve(IkSolver& solver, std::int64_t frame, std::span<const DualQuaternion> start,
             Pass& pass, std::int64_t place) {
    std::vector<double> least(pair_of_.size());
    for (std::size_t i = 0; i < least.size(); ++i) {
      const std::size_t k = pair_of_[i];
      const double push = push_.at(frame)[k];
      least[i] = push > 0.0 ? gap_.at(frame)[k] + push : allowed_.at(frame)[k];
    }
    solver.set_gaps(least);
    solver.forget();
    const std::span<DualQuaternion> pose = pass.pose(place);
    std::ranges::copy(start, pose.begin());
    const IkReport report = solver.solve(goals(frame), pose);
    pass.cost[place] = report.cost;
  }

  /// Where the effectors are in the clip without rows.
  std::vector<EffectorTarget> goals(std::int64_t frame) const {
    std::vector<EffectorTarget> out(track_.at(frame).begin(), track_.at(frame).end());
    std::vector<DualQuaternion> model(rows_);
    model_from_rows(rig_, clip_.frame(frame), model);
    for (std::size_t e = 0; e < out.size(); ++e) {
      const RigEffector& effector = rig_.effectors[e];
      const DualQuaternion& joint = model[effector.joint];
      out[e].pose = DualQuaternion::from_rotation_translation(
          joint.rotation(), joint.transform_point(effector.offset));
    }
    return out;
  }

  const SourceMotion& source_;
  const Target& target_;
  const EffectorTrack& track_;
  Clip& clip_;
  Rig rig_;
  std::int64_t frames_;
  std::size_t rows_;
  std::vector<PartCapsule> capsules_;  // their joints are rows
  std::vector<std::size_t> pair_of_;   // [rig_.collisions] of part_pairs()
  PairTrack allowed_, gap_, push_;     // m
  SelfContactFigures figures_;
};

}  // namespace

std::int64_t SelfContactFigures::pressed_frames() const {
  return std::count(pressed.begin(), pressed.end(), std::uint8_t(1));
}

Result<SelfContactFigures> keep_parts_apart(const SourceMotion& source, const Target& target,
                                            const Rig& rig, const EffectorTrack& track,
                                            Clip& clip) {
  if (!source.figure->is_body() || !target.figure.is_body()) return SelfContactFigures{};
  return Separation(source, target, rig, track, clip).run();
}

}  // namespace limber
