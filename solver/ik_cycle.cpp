// Going round.
//
// Following a clip forgets: what targets leave open is pulled towards the middle of its range and
// loses its speed (ik_descent.h). So a lap contracts what two starts of it differ by, to the part
// c < 1, and laps one after the other tend to one cycle, wherever the first started. Lap n differs
// from lap n - 1 by about c times what that differed from the one before by; where this has become
// kMet, the cycle is at most kMet c / (1 - c) away, and lap n is the answer: it ends where it
// began, at the speed it began with.
//
// Laps need not meet: mending (ik_clip.cpp) takes where it finds a way, and out of reach there is
// more than one best reach. But lap b goes on from the end of lap a before it, smoothly, so this
// closes too: frame f of n is b's, moved by the part w(f / n) of every joint's turn from b to a,
// w(u) = u^2 (3 - 2 u), and brought back onto its own targets. It begins as b, ends as a, and w
// rests at both ends.
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
constexpr std::size_t kFades = 3;      // pairs of laps to try, the nearest first
constexpr double kDearer = 1.01;       // of its laps' cost: what a frame out of reach may cost

using Steps = Eigen::Matrix3Xd;  // a vector per effector, or joint

/// How targets go from one frame to another: [2 effector] m, then angles at kAngleReach.
Steps target_step(const Rig& rig, std::span<const EffectorTarget> from,
                  std::span<const EffectorTarget> to) {
  Steps step = Steps::Zero(3, static_cast<Eigen::Index>(2 * rig.effectors.size()));
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
  return step;
}

double longest(const Steps& steps) {
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
  const bool repeats = longest(target_step(rig, at(frames - 1), at(0))) <= kSame;
  const std::int64_t period = repeats ? frames - 1 : frames;
  double most = 0.0, most_change = 0.0;
  Steps before = target_step(rig, at(0), at(1));
  const Steps first = before;
  for (std::int64_t f = 1; f < period - 1; ++f) {
    const Steps step = target_step(rig, at(f), at(f + 1));
    most = std::max({most, longest(before), longest(step)});
    most_change = std::max(most_change, longest(step - before));
    before = step;
  }
  const Steps seam = target_step(rig, at(period - 1), at(0));
  const double change = std::max(longest(seam - before), longest(first - seam));
  if (longest(seam) > kAsElsewhere * most + kSame) return Closing::none;
  if (change > kAsElsewhere * most_change + kSame) return Closing::none;
  return repeats ? Closing::repeats : Closing::continues;
}

CycleSteps cycle_steps(const Rig& rig, std::span<const DualQuaternion> poses) {
  const std::size_t joints = rig.joints.size(), frames = poses.size() / joints;
  const Skeleton skeleton = skeleton_of(rig);
  std::vector<Pose> world(frames, Pose(joints));
  for (std::size_t f = 0; f < frames; ++f) {
    model_from_local(skeleton, poses.subspan(f * joints, joints), world[f]);
  }
  const auto step = [&](std::size_t f, Steps& way, Steps& turn) {
    const std::size_t a = f % frames, b = (f + 1) % frames;
    for (std::size_t j = 0; j < joints; ++j) {
      const auto column = static_cast<Eigen::Index>(j);
      way.col(column) = world[b][j].translation() - world[a][j].translation();
      turn.col(column) = rotation_log(poses[a * joints + j].rotation().conjugate() *
                                      poses[b * joints + j].rotation());
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

/// Laps of a cycle, each following the one before.
class Laps {
 public:
  /// `targets` of one lap.
  Laps(IkSolver& solver, const Rig& rig, std::span<const EffectorTarget> targets);

  /// Goes round from `start` until two laps are one, or come no nearer.
  void run(std::span<const DualQuaternion> start, CycleReport&);
  /// The answer of these laps: one that met the one before, else two of them faded, else the one
  /// that came nearest, its seam open.
  void close(CycleReport&);
  /// [frame * joint]
  std::span<const DualQuaternion> answer() const { return answer_; }

 private:
  struct Outcome {
    double cost = 0.0;
    bool reached = false;
  };
  std::size_t frame_of(std::int64_t lap, std::int64_t frame) const {
    return static_cast<std::size_t>(lap * period_ + frame);
  }
  std::span<const DualQuaternion> pose(std::int64_t lap, std::int64_t frame) const {
    return std::span(poses_).subspan(frame_of(lap, frame) * joints_, joints_);
  }
  double apart(std::int64_t lap) const;
  bool fade(std::int64_t lap, CycleReport&);

  IkSolver& solver_;
  const Rig& rig_;
  std::span<const EffectorTarget> targets_;
  std::size_t joints_;
  std::int64_t period_;
  std::vector<DualQuaternion> poses_;                   ///< [lap * frame * joint]
  std::vector<Outcome> outcomes_;                       ///< [lap * frame]
  std::vector<std::pair<double, std::int64_t>> pairs_;  ///< apart from the lap before (rad), lap
  std::vector<DualQuaternion> answer_;
};

Laps::Laps(IkSolver& solver, const Rig& rig, std::span<const EffectorTarget> targets)
    : solver_(solver),
      rig_(rig),
      targets_(targets),
      joints_(rig.joints.size()),
      period_(static_cast<std::int64_t>(targets.size() / rig.effectors.size())) {
  const std::int64_t most = std::clamp(kMostFrames / period_, kLeastLaps, kMostLaps);
  outcomes_.resize(frame_of(most, 0));
  poses_.resize(outcomes_.size() * joints_);
  answer_.resize(frame_of(1, 0) * joints_);
}

/// How far a lap is from the one before it.
double Laps::apart(std::int64_t lap) const {
  double most = 0.0;
  for (std::int64_t f = 0; f < period_; ++f) {
    most = std::max(most, largest_turn(pose(lap - 1, f), pose(lap, f)));
  }
  return most;
}

void Laps::run(std::span<const DualQuaternion> start, CycleReport& report) {
  const auto most = static_cast<std::int64_t>(outcomes_.size()) / period_;
  std::ranges::copy(start, poses_.begin());
  solver_.forget();
  IkClipSolver clip(solver_, rig_, targets_, poses_);
  double nearest = std::numeric_limits<double>::infinity();
  std::int64_t nearest_lap = 0, lap = 0;
  for (; lap < most && nearest > kMet && lap - nearest_lap < kPatience; ++lap) {
    for (std::int64_t f = 0; f < period_; ++f) {
      const IkReport one = clip.next();
      outcomes_[frame_of(lap, f)] = {one.cost, one.reached};
      report.relinearisations += one.relinearisations;
    }
    // Mending may have changed the lap before too.
    for (std::int64_t i = std::max<std::int64_t>(lap - 1, 1); i <= lap; ++i) {
      const double now = apart(i);
      if (now < nearest) nearest_lap = lap;
      nearest = std::min(nearest, now);
    }
  }
  report.laps = static_cast<int>(lap);
  report.mended = clip.mended();
  report.jumps = clip.jumps();
  for (std::int64_t i = 1; i < lap; ++i) pairs_.emplace_back(apart(i), i);
  std::ranges::sort(pairs_);
}

/// Leads a lap into the one before it. False: a frame lost its targets on the way.
bool Laps::fade(std::int64_t lap, CycleReport& report) {
  for (std::int64_t f = 0; f < period_; ++f) {
    const auto way = std::span(answer_).subspan(frame_of(0, f) * joints_, joints_);
    const auto a = pose(lap - 1, f), b = pose(lap, f);
    const double w = smooth(static_cast<double>(f) / static_cast<double>(period_));
    for (std::size_t j = 0; j < joints_; ++j) way[j] = moved(b[j], b[j], a[j], w);
    solver_.resume(way, way);
    const std::size_t effectors = rig_.effectors.size();
    const IkReport one =
        solver_.follow(targets_.subspan(frame_of(0, f) * effectors, effectors), way);
    report.relinearisations += one.relinearisations;
    const Outcome &from = outcomes_[frame_of(lap - 1, f)], &to = outcomes_[frame_of(lap, f)];
    if (!one.reached && (from.reached && to.reached)) return false;
    if (!one.reached && one.cost > kDearer * std::max(from.cost, to.cost)) return false;
    report.unreached += !one.reached;
  }
  return true;
}

void Laps::close(CycleReport& report) {
  const auto [nearest, nearest_lap] = pairs_.front();
  report.closed = nearest <= kMet;
  report.apart_rad = nearest;
  for (std::size_t i = 0; i < std::min(pairs_.size(), kFades) && !report.closed; ++i) {
    report.unreached = 0;
    report.apart_rad = pairs_[i].first;
    report.closed = report.faded = fade(pairs_[i].second, report);
  }
  if (report.faded) return;
  report.unreached = 0;
  for (std::int64_t f = 0; f < period_; ++f) {
    report.unreached += !outcomes_[frame_of(nearest_lap, f)].reached;
    std::ranges::copy(pose(nearest_lap, f), answer_.begin() + frame_of(0, f) * joints_);
  }
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
