// Leading over. At frame f following ended at pose a, short of its targets; another solution is b.
// For the k-th of n frames before f the start is its own pose with the part w((n + 1 - k) / (n + 1))
// of every joint's turn from a to b added, w(u) = u^2 (3 - 2 u), and the solver brings that start
// back onto the frame's own targets, moving what they leave open as little as it can. w rests at
// both ends, so the way costs accelerations of at most 6 / n^2 of the turn per frame^2: n follows
// from the turn and kMostBend.
#include "solver/ik_clip.h"

#include <algorithm>
#include <cmath>

namespace limber {

namespace {

constexpr double kMostBend = 3e-3;  // rad per frame^2, of the way to another solution
constexpr int kLonger = 3;          // ways to try, each twice as long as the one before
constexpr std::int64_t kShortest = 8, kLongest = 256;
constexpr std::int64_t kPatience = 30;  // frames before the next try where none was found

double smooth(double u) { return u * u * (3.0 - 2.0 * u); }

/// from moved by the part w of the motion that leads from a to b.
DualQuaternion moved(const DualQuaternion& from, const DualQuaternion& a, const DualQuaternion& b,
                     double w) {
  const Eigen::Quaterniond turn =
      Eigen::Quaterniond::Identity().slerp(w, a.rotation().conjugate() * b.rotation());
  return DualQuaternion::from_rotation_translation(
      (from.rotation() * turn).normalized(),
      from.translation() + w * (b.translation() - a.translation()));
}

double largest_turn(std::span<const DualQuaternion> a, std::span<const DualQuaternion> b) {
  double most = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    most = std::max(most, rotation_angle(a[i].rotation(), b[i].rotation()));
  }
  return most;
}

}  // namespace

IkClipSolver::IkClipSolver(IkSolver& solver, const Rig& rig,
                           std::span<const EffectorTarget> targets,
                           std::span<DualQuaternion> poses)
    : solver_(solver),
      joints_(rig.size()),
      effectors_(static_cast<std::int32_t>(rig.effectors.size())),
      frames_(static_cast<std::int64_t>(poses.size()) / joints_),
      targets_(targets),
      poses_(poses),
      elsewhere_(static_cast<std::size_t>(joints_)),
      way_(static_cast<std::size_t>(std::min(frames_, kLongest) * joints_)) {}

std::span<const EffectorTarget> IkClipSolver::targets(std::int64_t frame) const {
  return targets_.subspan(static_cast<std::size_t>(frame * effectors_),
                          static_cast<std::size_t>(effectors_));
}

std::span<DualQuaternion> IkClipSolver::pose(std::int64_t frame) const {
  return poses_.subspan(static_cast<std::size_t>(frame * joints_),
                        static_cast<std::size_t>(joints_));
}

IkReport IkClipSolver::next() {
  const std::int64_t f = next_++;
  if (f == 0) return solver_.solve(targets(0), pose(0));
  IkReport report = solver_.follow(targets(f), pose(f));
  if (report.reached || f < retry_) return report;
  if (!mend(f, report)) retry_ = f + kPatience;
  return report;
}

/// Looks for another solution of frame f and a way to it. False: there is none.
bool IkClipSolver::mend(std::int64_t f, IkReport& report) {
  std::ranges::copy(pose(f - 1), elsewhere_.begin());
  const IkReport other = solver_.solve(targets(f), elsewhere_);
  report.relinearisations += other.relinearisations;
  report.tree_passes += other.tree_passes;
  if (other.reached) {
    ++mended_;
    const double turn = largest_turn(pose(f), elsewhere_);
    std::int64_t n = std::clamp(static_cast<std::int64_t>(std::sqrt(6.0 * turn / kMostBend)),
                                kShortest, kLongest);
    bool smooth = false;
    for (int i = 0; i < kLonger && !smooth && (i == 0 || n < std::min(f, kLongest)); ++i, n *= 2) {
      smooth = lead_over(f, std::min({n, f - 1, kLongest}));
    }
    jumps_ += !smooth;
    std::ranges::copy(elsewhere_, pose(f).begin());
    report.reached = true;
    report.cost = other.cost;
  }
  solver_.resume(pose(f - 1), pose(f));
  return other.reached;
}

/// Leads `count` frames before f over to elsewhere_. False: one of them lost its targets; nothing
/// has changed.
bool IkClipSolver::lead_over(std::int64_t f, std::int64_t count) {
  for (std::int64_t k = 1; k <= count; ++k) {
    const auto way = std::span(way_).subspan(static_cast<std::size_t>((k - 1) * joints_),
                                             static_cast<std::size_t>(joints_));
    const double w = smooth(double(count + 1 - k) / double(count + 1));
    for (std::int32_t i = 0; i < joints_; ++i) {
      way[i] = moved(pose(f - k)[i], pose(f)[i], elsewhere_[i], w);
    }
    solver_.resume(way, way);
    if (!solver_.follow(targets(f - k), way).reached) return false;
  }
  for (std::int64_t k = 1; k <= count; ++k) {
    std::copy_n(way_.begin() + (k - 1) * joints_, joints_, pose(f - k).begin());
  }
  return true;
}

}  // namespace limber
