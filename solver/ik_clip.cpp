// Leading over. At frame f following ended at pose a, short of its targets; another solution is b.
// For the k-th of n frames before f the start is its own pose with the part w((n + 1 - k) / (n +
// 1)) of every joint's turn from a to b added, w(u) = u^2 (3 - 2 u), and the solver brings that
// start back onto the frame's own targets, moving what they leave open as little as it can. w rests
// at both ends, so the way costs accelerations of at most 6 / n^2 of the turn per frame^2: n
// follows from the turn and kMostBend.
//
// The other solution comes from the frame itself, unwound (IkOptions::unwind), or from some frames
// ahead, unwound there and followed back: what closes at f may be open again later. Strewn starts
// mostly fall back to a. Solutions that the next frames lose again are the last choice.
//
// No way may be there: limits can cut what the targets leave open in two, and following took the
// wrong side of the cut when it opened, some frames ago. So the other solution is followed
// backwards and joined where it comes near. Ways that bend sharply are taken if there is no other.
// Where following jumped shortly before it lost its targets, the way begins before the jump.
//
// Smoothing. Ways have kinks where a limit takes hold of them, and so has following where the free
// interval of a swivel closes. Once the frames after such a kink have answers too, each frame about
// it starts from where the cubic through its neighbours at -2h, -h, h, 2h passes it,
//   (4 (x(-h) + x(h)) - x(-2h) - x(2h)) / 6,
// and goes back onto its targets: the bend spreads over what the targets leave open. Wide strides h
// first, so that it spreads far, then narrow ones.
#include "solver/ik_clip.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "solver/ik_descent.h"
#include "solver/pose_way.h"
#include "solver/strewn_numbers.h"

namespace limber {

namespace {

constexpr int kLonger = 3;  // ways to try, each twice as long as the one before
constexpr std::int64_t kShortest = kShortestWay, kLongest = 256, kFarthestBack = 256;
constexpr std::array<std::int64_t, 3> kAhead{0, 8, 32};  // frames: where to solve unwound
constexpr std::size_t kTries = 8;        // in search of other solutions, these and strewn ones;
constexpr std::size_t kTriesIfSome = 4;  // if some was found,
constexpr std::size_t kEnough = 2;       // until so many were
constexpr std::int64_t kLasting = 8;     // frames that a solution should last
constexpr double kStrewnWidth = 0.35;    // rad on each axis of each joint
constexpr double kJump = 8e-3;           // m per frame^2 beyond what targets do: a frame has jumped
constexpr int kCalmFrames = 16;          // after a jump
constexpr std::int64_t kLongestJump = 40;     // frames until it counts as over;
constexpr std::int64_t kLongestLost = 120;    // where the targets were lost with it
constexpr int kJoints = 6;                    // places to join at, the nearest first
constexpr double kMerged = 0.003;             // rad: two solutions are one
constexpr std::int64_t kMostPatience = 1024;  // frames before the next try where none was found
constexpr double kSmoothBend = 0.25;          // rad per frame^2: what a way should keep below
constexpr double kKink = 0.05;                // rad per frame^2: more than that is smoothed
constexpr double kSharp = 3.0;                // times what it was
constexpr std::int64_t kBefore = 6;           // to twice as many frames before
constexpr std::int64_t kSpread = 16;          // frames about it
constexpr std::array<std::int64_t, 6> kStrides{4, 2, 1, 4, 2, 1};
// Frames may be solved again for a hurry's sake, some for each new frame, saved up to so many.
constexpr double kCreditPerFrame = 0.5, kMostCredit = 400.0;

/// Every joint turned by up to `width` rad about an axis of its own.
void strew(double width, std::uint64_t seed, std::span<DualQuaternion> pose) {
  StrewnNumbers numbers(seed);
  const auto uniform = [&numbers] { return 2.0 * numbers.next() - 1.0; };
  for (DualQuaternion& joint : pose) {
    const Eigen::Vector3d v = width * Eigen::Vector3d(uniform(), uniform(), uniform());
    const Eigen::Quaterniond turn(Eigen::AngleAxisd(v.norm(), v.normalized()));
    joint = DualQuaternion::from_rotation_translation((joint.rotation() * turn).normalized(),
                                                      joint.translation());
  }
}

/// The largest second difference of a joint's rotation, rad per frame^2.
double bend(std::span<const DualQuaternion> a, std::span<const DualQuaternion> b,
            std::span<const DualQuaternion> c) {
  double most = 0.0;
  for (std::size_t i = 0; i < b.size(); ++i) {
    const Eigen::Vector4d middle = b[i].real.coeffs();
    const Eigen::Vector4d from = a[i].real.coeffs(), to = c[i].real.coeffs();
    const Eigen::Vector4d bent = (middle.dot(from) < 0.0 ? -1.0 : 1.0) * from - 2.0 * middle +
                                 (middle.dot(to) < 0.0 ? -1.0 : 1.0) * to;
    most = std::max(most, bent.squaredNorm());
  }
  return 2.0 * std::sqrt(most);
}

}  // namespace

IkClipSolver::IkClipSolver(IkSolver& solver, const Rig& rig,
                           std::span<const EffectorTarget> targets, std::span<DualQuaternion> poses)
    : solver_(solver),
      joints_(rig.size()),
      effectors_(static_cast<std::int32_t>(rig.effectors.size())),
      frames_(static_cast<std::int64_t>(poses.size()) / joints_),
      targets_(targets),
      poses_(poses),
      elsewhere_(kTries * static_cast<std::size_t>(joints_)),
      credit_(kMostCredit),
      way_(static_cast<std::size_t>(std::min(frames_, kLongest) * joints_)),
      back_(static_cast<std::size_t>(std::min(frames_, kFarthestBack) * joints_)),
      between_(static_cast<std::size_t>(joints_)) {}

std::span<DualQuaternion> IkClipSolver::row(std::vector<DualQuaternion>& poses, std::int64_t index,
                                            std::int32_t joints) {
  return std::span(poses).subspan(static_cast<std::size_t>(index * joints),
                                  static_cast<std::size_t>(joints));
}

std::span<const EffectorTarget> IkClipSolver::targets(std::int64_t frame) const {
  const auto first = static_cast<std::size_t>(frame * effectors_);
  return targets_.subspan(targets_.empty() ? 0 : first % targets_.size(),
                          static_cast<std::size_t>(effectors_));
}

std::span<DualQuaternion> IkClipSolver::pose(std::int64_t frame) const {
  return poses_.subspan(static_cast<std::size_t>(frame * joints_),
                        static_cast<std::size_t>(joints_));
}

IkReport IkClipSolver::next() {
  const std::int64_t f = next_++;
  credit_ = std::min(credit_ + kCreditPerFrame, kMostCredit);
  if (f == 0) return solver_.solve(targets(0), pose(0));
  IkReport report = solver_.follow(targets(f), pose(f));
  watch(f, report);
  if (!report.reached && report.cost < kWoundCost && f >= retry_ && !mend(f, report)) {
    // What cannot be reached now may well stay so.
    patience_ = std::min(2 * patience_, kMostPatience);
    retry_ = f + patience_;
  }
  if (report.reached) patience_ = 1;
  if (f > 1 && report.reached && credit_ > 0.0 && report.bend > kJump && sharp(f)) {
    mark_rough(f, f);
  }
  smooth_rough(f);
  return report;
}

/// Limits can leave less and less room until following has to hurry. Where that came to rest again,
/// the frames before go there in time: backwards the room opens, and there is no hurry.
void IkClipSolver::watch(std::int64_t f, const IkReport& report) {
  if (jumped_ < 0) {
    if (report.reached && report.bend > kJump && f > 2 && credit_ > 0.0) jumped_ = f;
    calm_ = 0;
    return;
  }
  // Where following lost its targets besides, it is mended with that.
  if (!report.reached && f - jumped_ < kLongestLost) return;
  calm_ = report.bend < 0.5 * kJump ? calm_ + 1 : 0;
  if (calm_ < kCalmFrames && f - jumped_ < kLongestJump) return;
  if (report.reached) {
    const std::int64_t over = f - calm_;
    std::ranges::copy(pose(over), row(back_, 0, joints_).begin());
    ++mended_;
    // Not by what bends nearly as much as the jump itself.
    const double half = 0.5 * worst_kink(jumped_, over);
    way_bend_ = kSmoothBend;
    bool joined = join_earlier(over, over - jumped_ + 1);
    if (!joined && half > kSmoothBend) {
      way_bend_ = half;
      joined = join_earlier(over, over - jumped_ + 1);
    }
    jumps_ += !joined;
    solver_.resume(pose(f - 1), pose(f));
  }
  jumped_ = -1;
}

/// From `pose`, which solves frame f + k, follows to frame f + to. False: it lost its targets.
bool IkClipSolver::follow_to(std::int64_t f, std::int64_t k, std::int64_t to,
                             std::span<DualQuaternion> pose) {
  solver_.resume(pose, pose);
  while (k != to) {
    k += k < to ? 1 : -1;
    if (!solver_.follow(targets(f + k), pose).reached) return false;
  }
  return true;
}

/// One try to solve frame f from elsewhere: unwound (IkOptions::unwind), there or some frames ahead
/// from where it is followed back, or strewn about the frame before, always the same way.
bool IkClipSolver::try_elsewhere(std::int64_t f, std::size_t i, std::span<DualQuaternion> other,
                                 IkReport& report) {
  std::ranges::copy(pose(f - 1), other.begin());
  const std::int64_t ahead = i < kAhead.size() ? std::min(kAhead[i], frames_ - 1 - f) : 0;
  IkReport tried;
  if (i < kAhead.size()) {
    if (i > 0 && ahead == 0) return false;
    tried = solver_.solve(targets(f + ahead), other);
  } else {
    strew(kStrewnWidth, i, other);
    solver_.resume(other, other);
    tried = solver_.follow(targets(f), other);
  }
  report.relinearisations += tried.relinearisations;
  report.tree_passes += tried.tree_passes;
  return tried.reached && follow_to(f, ahead, 0, other);
}

/// Solutions of frame f away from the one that following found: first those that last for some
/// frames, the nearest first.
void IkClipSolver::look_elsewhere(std::int64_t f, IkReport& report) {
  others_.clear();
  std::size_t lasting = 0;
  for (std::size_t i = 0; i < kTries && lasting < kEnough; ++i) {
    if (i >= kTriesIfSome && lasting > 0) break;
    const auto other = elsewhere(i);
    if (!try_elsewhere(f, i, other, report)) continue;
    std::ranges::copy(other, between_.begin());
    const bool lasts = follow_to(f, 0, std::min(kLasting, frames_ - 1 - f), between_);
    lasting += lasts;
    others_.push_back({!lasts, largest_turn(pose(f), other), i});
  }
  std::ranges::sort(others_);
}

/// Finds another solution of frame f and a way to it, a smooth one if there is one. False: there is
/// no solution.
bool IkClipSolver::mend(std::int64_t f, IkReport& report) {
  look_elsewhere(f, report);
  const auto other = row(back_, 0, joints_);
  bool joined = false;
  for (const double bend : {kSmoothBend, std::numeric_limits<double>::infinity()}) {
    way_bend_ = bend;
    for (std::size_t i = 0; i < others_.size() && !joined; ++i) {
      std::ranges::copy(elsewhere(others_[i].start), other.begin());
      joined =
          (jumped_ < 0 && join(f, other)) || join_earlier(f, jumped_ < 0 ? 1 : f - jumped_ + 1);
    }
  }
  report.reached = !others_.empty();
  if (report.reached) {
    ++mended_;
    jumps_ += !joined;
    const auto nearest = elsewhere(others_.front().start);
    std::ranges::copy(joined ? other : nearest, pose(f).begin());
    jumped_ = -1;
  }
  solver_.resume(pose(f - 1), pose(f));
  return report.reached;
}

/// Leads the frames before f over to its other solution, as short as is smooth.
bool IkClipSolver::join(std::int64_t f, std::span<const DualQuaternion> other) {
  std::int64_t n = std::clamp(
      static_cast<std::int64_t>(std::sqrt(6.0 * largest_turn(pose(f), other) / kMostBend)),
      kShortest, kLongest);
  for (int i = 0; i < kLonger; ++i, n *= 2) {
    const std::int64_t count = std::min({n, f - 1, kLongest});
    if (count < 1) return false;
    const std::int64_t led = lead_over(f, other, count);
    if (led == count) return true;
    if (led < kShortest || count < n) return false;  // a longer one begins the same way
  }
  return false;
}

/// Leads `count` frames before f over to `other`. Fewer than that: there a frame lost its targets
/// or the way bends more than it may, and nothing has changed.
std::int64_t IkClipSolver::lead_over(std::int64_t f, std::span<const DualQuaternion> other,
                                     std::int64_t count) {
  std::span<const DualQuaternion> after = other, next;
  for (std::int64_t k = 1; k <= count; ++k) {
    const auto way = row(way_, k - 1, joints_);
    const double w = ease(double(count + 1 - k) / double(count + 1));
    for (std::int32_t i = 0; i < joints_; ++i) {
      way[i] = moved(pose(f - k)[i], pose(f)[i], other[i], w);
    }
    solver_.resume(way, way);
    credit_ -= 1.0;
    if (!solver_.follow(targets(f - k), way).reached) return k - 1;
    if (k > 1 && bend(way, after, next) > way_bend_) return k - 1;
    next = after;
    after = way;
  }
  if (bend(pose(f - count - 1), after, next) > way_bend_) return count - 1;
  for (std::int64_t k = 1; k <= count; ++k) {
    std::ranges::copy(row(way_, k - 1, joints_), pose(f - k).begin());
  }
  mark_rough(f - count, f);
  return count;
}

/// Follows the solution in back_[0] to earlier frames, until it meets the one that is there (not
/// before `least` frames); how many it reached.
std::int64_t IkClipSolver::follow_back(std::int64_t f, std::int64_t least) {
  const std::int64_t most = std::min(f, kFarthestBack - 1);
  solver_.resume(row(back_, 0, joints_), row(back_, 0, joints_));
  for (std::int64_t k = 1; k <= most; ++k) {
    const auto back = row(back_, k, joints_);
    credit_ -= 1.0;
    if (!solver_.follow(targets(f - k), back).reached) return k - 1;
    if (k >= least && largest_turn(pose(f - k), back) < kMerged) return k;
  }
  return most;
}

/// Joins at least so many frames before f, where both solutions are near each other.
bool IkClipSolver::join_earlier(std::int64_t f, std::int64_t least) {
  const std::int64_t count = follow_back(f, least);
  std::vector<std::pair<double, std::int64_t>> places;
  double before = std::numeric_limits<double>::infinity();
  for (std::int64_t k = 1; k <= count; ++k) {
    const double apart = largest_turn(pose(f - k), row(back_, k, joints_));
    const double after = k == count ? std::numeric_limits<double>::infinity()
                                    : largest_turn(pose(f - k - 1), row(back_, k + 1, joints_));
    if (k >= least && apart <= after && (apart <= before || k == least))
      places.emplace_back(apart, k);
    before = apart;
  }
  std::ranges::sort(places);
  if (places.size() > kJoints) places.resize(kJoints);
  for (const auto& [apart, k] : places) {
    if (!join(f - k, row(back_, k, joints_))) continue;
    for (std::int64_t i = 1; i <= k; ++i)
      std::ranges::copy(row(back_, i, joints_), pose(f - i).begin());
    mark_rough(f - k, f);
    return true;
  }
  return false;
}

void IkClipSolver::mark_rough(std::int64_t first, std::int64_t last) {
  rough_first_ = rough_ < 0 ? first : std::min(first, rough_first_);
  rough_ = std::max(rough_, last);
}

double IkClipSolver::kink(std::int64_t f) const { return bend(pose(f - 2), pose(f - 1), pose(f)); }

/// Bends much more than it did shortly before: no part of a fast motion.
bool IkClipSolver::sharp(std::int64_t f) const {
  const double bent = kink(f);
  return bent > kKink &&
         bent > kSharp * worst_kink(std::max<std::int64_t>(f - 2 * kBefore, 2), f - kBefore);
}

double IkClipSolver::worst_kink(std::int64_t first, std::int64_t last) const {
  double most = 0.0;
  for (std::int64_t f = first; f <= last; ++f) most = std::max(most, kink(f));
  return most;
}

/// Brings a frame to where its neighbours, `stride` away, would have it, as far as its targets
/// leave that open: the cubic through four of them.
void IkClipSolver::smooth(std::int64_t f, std::int64_t h) {
  for (std::int32_t i = 0; i < joints_; ++i) {
    const DualQuaternion &a = pose(f - h)[i], &b = pose(f + h)[i];
    const DualQuaternion &c = pose(f - 2 * h)[i], &d = pose(f + 2 * h)[i];
    const DualQuaternion near = moved(a, a, b, 0.5), far = moved(c, c, d, 0.5);
    between_[i] = moved(near, far, near, 1.0 / 3.0);
  }
  solver_.resume(between_, between_);
  credit_ -= 1.0;
  if (solver_.follow(targets(f), between_).reached) std::ranges::copy(between_, pose(f).begin());
}

/// Once what follows is calm too, smooths what was marked, one stretch after the other.
void IkClipSolver::smooth_rough(std::int64_t f) {
  if (rough_ < 0 || jumped_ >= 0 || (f < rough_ + kSpread && f + 1 < frames_)) return;
  const std::int64_t end = std::min(f, rough_ + 2);
  bool some = false;
  for (std::int64_t i = std::max<std::int64_t>(rough_first_, 2); i <= end; ++i) {
    if (!sharp(i)) continue;
    const std::int64_t first = i;
    std::int64_t last = i;
    while (++i <= std::min(end, last + kSpread)) {
      if (sharp(i)) last = i;
    }
    smooth_stretch(std::max<std::int64_t>(first - kSpread, 1), std::min(f - 2, last + kSpread), f);
    some = true;
  }
  rough_ = -1;
  if (some) solver_.resume(pose(f - 1), pose(f));
}

/// Frames up to `now` have answers; those after `last` stay.
void IkClipSolver::smooth_stretch(std::int64_t first, std::int64_t last, std::int64_t now) {
  if (last - first >= static_cast<std::int64_t>(way_.size()) / joints_) return;
  const std::int64_t felt = std::min(now, last + 2);
  const double before = worst_kink(first + 1, felt);
  for (std::int64_t i = first; i <= last; ++i) {
    std::ranges::copy(pose(i), row(way_, i - first, joints_).begin());
  }
  for (std::size_t k = 0; k < kStrides.size(); ++k) {
    const std::int64_t stride = kStrides[k];
    if (k == kStrides.size() / 2 && worst_kink(first + 1, felt) < kKink) break;
    for (std::int64_t i = first; i <= last; ++i) {
      if (i - 2 * stride >= 0 && i + 2 * stride <= now) smooth(i, stride);
    }
  }
  const double after = worst_kink(first + 1, felt);
  if (after < before) return;
  for (std::int64_t i = first; i <= last; ++i) {
    std::ranges::copy(row(way_, i - first, joints_), pose(i).begin());
  }
}

}  // namespace limber
