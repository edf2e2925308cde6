// Going round.
//
// Following a clip forgets: what targets leave open is pulled towards the middle of its range and
// loses its speed (ik_descent.h). So where nothing else happens a lap contracts what two starts of
// it differ by, to the part c < 1, and laps one after the other tend to one cycle, wherever the
// first of them started. A lap differs from the one before by about c times what that one did;
// where this has become kMet, the cycle is at most kMet c / (1 - c) away, and the lap is the
// answer: it ends where it began, at the speed it began with.
//
// Laps need not meet: what swings fast carries itself on from lap to lap, mending (ik_clip.cpp)
// takes where it finds a way, and out of reach there is more than one best reach. But all laps are
// one smooth way x_0, x_1, ..., so this closes too: with N frames a lap and a frame c where x_c and
// x_{c+N} are near, n frames about c are x_{k+N} moved by the part w of every joint's turn to x_k,
// w(u) = u^2 (3 - 2 u) from 0 at c - n/2 to 1 at c + n/2, and brought back onto their own targets.
// Then follow x_{c+n/2} to x_{c+N-n/2-1}, and the cycle begins anew. w rests at both ends, so n
// follows from the turn as it does in ik_clip.cpp.
#include "solver/ik_cycle.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "solver/ik_clip.h"
#include "solver/ik_tree.h"
#include "solver/pose_way.h"

namespace limber {

namespace {

constexpr std::int64_t kLeastFrames = 4;  // with fewer there is no change of step elsewhere
constexpr double kSame = 1e-5;            // m: targets that are one
constexpr double kAsElsewhere = 2.0;      // of the largest step elsewhere: is one into the first
constexpr double kAngleReach = 0.1;       // m per rad, as the weights of effectors
constexpr double kMet = 1e-6;             // rad: two laps are one
constexpr std::int64_t kMostFrames = 4096, kLeastLaps = 3, kMostLaps = 64;
constexpr std::int64_t kPatience = 6;  // laps that come no nearer
constexpr std::int64_t kMending = 40;  // frames that the last one solved may still change
constexpr std::size_t kPlaces = 6;     // to close at, the nearest first,
constexpr int kLonger = 3;             // and ways there, each twice as long as the one before
constexpr double kHaste = 2.0;         // of its steps to the laps' own, at most
constexpr double kDearer = 1.01;       // than its laps' cost: a frame of it that is out of reach

using Steps = Eigen::Matrix3Xd;  // a vector per effector, or joint

/// How targets go from one frame to another: [2 effector] m, then angles at kAngleReach.
void target_step(const Rig& rig, std::span<const EffectorTarget> from,
                 std::span<const EffectorTarget> to, Steps& step) {
  step.setZero();
  for (std::size_t e = 0; e < rig.effectors.size(); ++e) {
    const IkEffector effector = make_effector(rig.effectors[e], -1, DualQuaternion::identity());
    const IkGoal goal = make_goal(effector, to[e]);
    const Eigen::Quaterniond turned = to[e].pose.rotation() * from[e].pose.rotation().conjugate();
    const auto column = static_cast<Eigen::Index>(2 * e);
    if (goal.mass > 0.0 || effector.kind == EffectorKind::gaze) {
      step.col(column) = to[e].pose.translation() - from[e].pose.translation();
    }
    if (goal.inertia > 0.0 && effector.kind != EffectorKind::gaze) {
      step.col(column + 1) = kAngleReach * rotation_log(turned);
      if (has_axis(effector.kind)) {
        step.col(column + 1) = kAngleReach * (goal.axis - turned.conjugate() * goal.axis);
      }
    }
  }
}

template <class Vectors>
double longest(const Eigen::MatrixBase<Vectors>& steps) {
  return steps.size() == 0 ? 0.0 : std::sqrt(steps.colwise().squaredNorm().maxCoeff());
}

}  // namespace

Closing closing_of(const Rig& rig, std::span<const EffectorTarget> targets) {
  const std::size_t effectors = rig.effectors.size();
  const auto frames = static_cast<std::int64_t>(effectors == 0 ? 0 : targets.size() / effectors);
  if (frames < kLeastFrames) return Closing::none;
  const auto at = [&](std::int64_t frame) {
    return targets.subspan(static_cast<std::size_t>(frame % frames) * effectors, effectors);
  };
  const Steps none = Steps::Zero(3, static_cast<Eigen::Index>(2 * effectors));
  Steps first = none, before = none, step = none;
  target_step(rig, at(frames - 1), at(0), step);
  const bool repeats = longest(step) <= kSame;
  const std::int64_t period = repeats ? frames - 1 : frames;
  double most = 0.0, most_change = 0.0;
  target_step(rig, at(0), at(1), first);
  before = first;
  for (std::int64_t f = 1; f < period - 1; ++f) {
    target_step(rig, at(f), at(f + 1), step);
    most = std::max({most, longest(before), longest(step)});
    most_change = std::max(most_change, longest(step - before));
    std::swap(before, step);
  }
  Steps& seam = step;
  target_step(rig, at(period - 1), at(0), seam);
  const double change = std::max(longest(seam - before), longest(first - seam));
  if (!(longest(seam) <= kAsElsewhere * most + kSame)) return Closing::none;
  if (!(change <= kAsElsewhere * most_change + kSame)) return Closing::none;
  return repeats ? Closing::repeats : Closing::continues;
}

CycleSteps cycle_steps(const Rig& rig, std::span<const DualQuaternion> poses) {
  const std::size_t joints = rig.joints.size(), frames = poses.size() / joints;
  const Skeleton skeleton = skeleton_of(rig);
  std::vector<DualQuaternion> world(poses.size());
  for (std::size_t first = 0; first < poses.size(); first += joints) {
    model_from_local(skeleton, poses.subspan(first, joints),
                     std::span(world).subspan(first, joints));
  }
  const auto step = [&](std::size_t f, Steps& way, Steps& turn) {
    for (std::size_t j = 0; j < joints; ++j) {
      const std::size_t a = f * joints + j, b = (f + 1) % frames * joints + j;
      const auto column = static_cast<Eigen::Index>(j);
      way.col(column) = world[b].translation() - world[a].translation();
      turn.col(column) = rotation_log(poses[a].rotation().conjugate() * poses[b].rotation());
    }
  };
  CycleSteps out;
  Steps way(3, joints), turn(3, joints), way_before(3, joints), turn_before(3, joints);
  step(frames - 1, way_before, turn_before);
  for (std::size_t f = 0; f < frames; ++f) {  // from f, where the step before ended
    step(f, way, turn);
    PoseStep& in = f + 1 == frames ? out.seam : out.elsewhere;
    in.way_m = std::max(in.way_m, longest(way));
    in.turn_rad = std::max(in.turn_rad, longest(turn));
    PoseStep& at = f == 0 || f + 1 == frames ? out.seam : out.elsewhere;
    at.way_change_m = std::max(at.way_change_m, longest(way - way_before));
    at.turn_change_rad = std::max(at.turn_change_rad, longest(turn - turn_before));
    std::swap(way, way_before);
    std::swap(turn, turn_before);
  }
  return out;
}

namespace {

/// Laps of a cycle, one following the other, as one way.
class Laps {
 public:
  /// `targets` of one lap.
  Laps(IkSolver& solver, const Rig& rig, std::span<const EffectorTarget> targets);

  /// Goes round from `start` until two laps are one, or come no nearer.
  void run(std::span<const DualQuaternion> start, CycleReport&);
  /// Makes a cycle of them: cut where they met, else led over where they are near, else left open.
  void close(CycleReport&);
  /// [frame * joint]
  std::span<const DualQuaternion> answer() const { return answer_; }

 private:
  struct Outcome {
    double cost = 0.0;
    bool reached = false;
  };
  struct Place {
    double apart = std::numeric_limits<double>::infinity();  ///< rad
    std::int64_t frame = 0;  ///< of the way, a lap before the one that it is near to
  };
  std::span<const DualQuaternion> pose(std::int64_t frame) const {
    return std::span(poses_).subspan(static_cast<std::size_t>(frame) * joints_, joints_);
  }
  std::span<const DualQuaternion> answer(std::int64_t frame) const {
    return std::span(answer_).subspan(static_cast<std::size_t>(frame % period_) * joints_, joints_);
  }
  Place nearest(std::int64_t first, std::int64_t last) const;
  void cut(std::int64_t place, CycleReport&);
  bool lead_over(std::int64_t place, std::int64_t count, CycleReport&);
  bool jumps(std::int64_t frame, std::int64_t count) const;

  IkSolver& solver_;
  const Rig& rig_;
  std::span<const EffectorTarget> targets_;
  std::size_t joints_;
  std::int64_t period_, frames_ = 0;   ///< frames: solved
  std::vector<DualQuaternion> poses_;  ///< [frame * joint]
  std::vector<Outcome> outcomes_;      ///< [frame]
  std::vector<DualQuaternion> answer_;
};

Laps::Laps(IkSolver& solver, const Rig& rig, std::span<const EffectorTarget> targets)
    : solver_(solver),
      rig_(rig),
      targets_(targets),
      joints_(rig.joints.size()),
      period_(static_cast<std::int64_t>(targets.size() / rig.effectors.size())) {
  const std::int64_t most = std::clamp(kMostFrames / period_, kLeastLaps, kMostLaps);
  outcomes_.resize(static_cast<std::size_t>(most * period_));
  poses_.resize(outcomes_.size() * joints_);
  answer_.resize(static_cast<std::size_t>(period_) * joints_);
}

/// Where, from frame `first` to before `last`, two frames on end are nearest to those a lap later:
/// in place and speed. Frames that may still change are left out.
Laps::Place Laps::nearest(std::int64_t first, std::int64_t last) const {
  const auto apart = [&](std::int64_t f) { return largest_turn(pose(f), pose(f + period_)); };
  Place best;
  last = std::min(last, frames_ - period_ - kMending);
  for (std::int64_t f = std::max<std::int64_t>(first, 1); f < last; ++f) {
    const double now = std::max(apart(f - 1), apart(f));
    if (now < best.apart) best = {now, f};
  }
  return best;
}

void Laps::run(std::span<const DualQuaternion> start, CycleReport& report) {
  const auto most = static_cast<std::int64_t>(outcomes_.size());
  std::ranges::copy(start, poses_.begin());
  solver_.forget();
  IkClipSolver clip(solver_, rig_, targets_, poses_);
  Place best;
  std::int64_t since = 0;  // laps that came no nearer
  while (frames_ < most && best.apart > kMet && since < kPatience) {
    for (std::int64_t i = 0; i < period_; ++i, ++frames_) {
      const IkReport one = clip.next();
      outcomes_[static_cast<std::size_t>(frames_)] = {one.cost, one.reached};
      report.relinearisations += one.relinearisations;
    }
    const Place place = nearest(frames_ - 3 * period_, frames_);
    const bool nearer = place.apart < best.apart || !std::isfinite(place.apart);
    since = nearer ? 0 : since + 1;
    if (nearer) best = place;
  }
  report.laps = static_cast<int>(frames_ / period_);
  report.mended = clip.mended();
  report.jumps = clip.jumps();
}

/// The lap from frame `place` on.
void Laps::cut(std::int64_t place, CycleReport& report) {
  report.unreached = 0;
  for (std::int64_t f = place; f < place + period_; ++f) {
    std::ranges::copy(pose(f),
                      answer_.begin() + (f % period_) * static_cast<std::int64_t>(joints_));
    report.unreached += !outcomes_[static_cast<std::size_t>(f)].reached;
  }
}

/// The answer's step to a frame that was led over is out of proportion to the two laps' own and the
/// way between them: where targets leave room on two sides of a limit, starts on end may fall
/// apart.
bool Laps::jumps(std::int64_t to, std::int64_t count) const {
  const std::int64_t from = to + period_;
  const double laps =
      std::max(largest_turn(pose(to - 1), pose(to)), largest_turn(pose(from - 1), pose(from)));
  const double way = 1.5 * largest_turn(pose(from), pose(to)) / static_cast<double>(count);
  return largest_turn(answer(to + period_ - 1), answer(to)) > kHaste * (laps + way);
}

/// The same, its end led over to its beginning by `count` frames about the place. False: one of
/// them lost its targets, or jumped.
bool Laps::lead_over(std::int64_t place, std::int64_t count, CycleReport& report) {
  const std::int64_t first = place - count / 2;
  cut(first, report);
  for (std::int64_t i = 0; i < count; ++i) {
    const std::int64_t to = first + i, from = to + period_;
    const auto way =
        std::span(answer_).subspan(static_cast<std::size_t>(to % period_) * joints_, joints_);
    const double w = ease(static_cast<double>(i + 1) / static_cast<double>(count + 1));
    for (std::size_t j = 0; j < joints_; ++j) {
      way[j] = moved(pose(from)[j], pose(from)[j], pose(to)[j], w);
    }
    solver_.resume(way, way);
    const std::size_t effectors = rig_.effectors.size();
    const IkReport one = solver_.follow(
        targets_.subspan(static_cast<std::size_t>(to % period_) * effectors, effectors), way);
    report.relinearisations += one.relinearisations;
    const Outcome &a = outcomes_[static_cast<std::size_t>(to)],
                  &b = outcomes_[static_cast<std::size_t>(from)];
    report.unreached += a.reached - one.reached;
    if (one.reached) continue;
    if (a.reached && b.reached) return false;
    if (one.cost > kDearer * std::max(a.cost, b.cost)) return false;
  }
  for (std::int64_t i = 0; i <= count; ++i) {
    if (jumps(first + i, count)) return false;
  }
  return true;
}

void Laps::close(CycleReport& report) {
  std::vector<Place> places;
  places.reserve(static_cast<std::size_t>(frames_ / period_));
  for (std::int64_t f = 0; f + period_ < frames_; f += period_) {
    places.push_back(nearest(f, f + period_));
  }
  std::ranges::sort(places, {}, &Place::apart);
  if (places.size() > kPlaces) places.resize(kPlaces);
  const Place best = places.front();
  report.apart_rad = best.apart;
  report.closed = best.apart <= kMet;
  for (std::size_t i = 0; i < places.size() && !report.closed; ++i) {
    const Place& place = places[i];
    if (!std::isfinite(place.apart)) break;
    const auto shortest =
        std::max(static_cast<std::int64_t>(std::sqrt(6.0 * place.apart / kMostBend)), kShortestWay);
    const std::int64_t room = 2 * std::min(place.frame, frames_ - period_ - kMending - place.frame);
    std::int64_t count = std::min(shortest, period_);
    for (int k = 0; k < kLonger && count <= room && !report.closed; ++k) {
      report.apart_rad = place.apart;
      report.closed = report.led_over = lead_over(place.frame, count, report);
      if (count == period_) break;
      count = std::min(2 * count, period_);
    }
  }
  if (report.led_over) return;
  report.apart_rad = best.apart;
  cut(best.frame, report);
}

}  // namespace

Result<CycleReport> solve_cycle(IkSolver& solver, const Rig& rig,
                                std::span<const EffectorTarget> targets,
                                std::span<DualQuaternion> poses) {
  CycleReport report;
  report.closing = closing_of(rig, targets);
  if (report.closing == Closing::none) {
    return Error{.code = "clip-open",
                 .message = "the targets of the last frame do not go on into those of the first",
                 .hint = "cut the clip to whole periods, or solve it as one that ends"};
  }
  const std::size_t effectors = rig.effectors.size(), joints = rig.joints.size();
  const std::size_t frames = targets.size() / effectors;
  const std::size_t period = report.closing == Closing::repeats ? frames - 1 : frames;
  report.period = static_cast<std::int64_t>(period);
  Laps laps(solver, rig, targets.first(period * effectors));
  laps.run(poses.first(joints), report);
  laps.close(report);
  for (std::size_t f = 0; f < frames; ++f) {
    std::ranges::copy(laps.answer().subspan((f % period) * joints, joints),
                      poses.begin() + static_cast<std::ptrdiff_t>(f * joints));
  }
  report.steps = cycle_steps(rig, laps.answer());
  return report;
}

}  // namespace limber
