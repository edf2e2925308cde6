// Bodies of other proportions carry the source's hands into their own hips. Here they are kept out.
//
// Both figures are capsules (body_capsules.cpp). For a pair of parts let g(t) be the gap in the
// solved clip and a(t) = min(scaled gap of the source, 0) - kFleshGivesM the least that is asked
// for: hands that touch go on touching, and only where the source is deeper itself may the target
// be. What lacks is v = a - g; below 0 it is room to spare.
//
// Of limbs that run through each other the nearest way out turns over within a frame or two, and a
// row that began to press at v > 0 would move the arm at once. So neither is used as it is. The
// direction n is the one in which the source, which is not inside, has the arm's part from the
// other, averaged around the frame, in the pelvis' space. A row asks for
//   n . (a - b) >= what it is + s
// of the points a and b where the axes were nearest, s the smooth cover of v (smooth_cover.h).
// Pairs with room to spare have rows too: s < 0 says how far others may push them. So no row
// appears or goes while it presses.
//
// Each frame is a projection: the nearest pose to the solved one, in the measure of the effectors'
// cost, that keeps the rows and the limits. That is the constrained solve itself as far as
// Gauss-Newton sees it, expanded about the solve without rows: the goals are where that has left
// the effectors. Arms give way before the trunk and the legs do. A straight arm that is pushed has
// two nearest poses, its elbow bent to either side, and frames must not choose each for itself:
// they take few and damped steps of the linear problem, whose answer is one and changes smoothly.
// Last, the changes (turns from the solved pose to this one) are averaged over some frames. What
// then lacks is added in further rounds.
#include "pipeline/self_contacts.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "pipeline/body_capsules.h"
#include "pipeline/smooth_cover.h"
#include "solver/ik_solver.h"
#include "solver/swing_twist.h"

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

// Half windows, s.
constexpr double kDirectionS = 0.3;  // directions and nearest points
constexpr double kCoverS = 0.02;     // onsets of pushes
constexpr double kChangeS = 0.1;     // changes of poses
constexpr double kArch = 4.0;        // m/s^2: no push bends down by more
constexpr double kFar = 0.15;        // m: pairs with more room than that have no row
constexpr double kSettled = 2e-4;    // m: a lack that counts as none
constexpr double kNothing = 1e-6;    // m: a push that does
constexpr int kRounds = 16;
constexpr double kFurther = 1.4;   // times what lacks, after the first round,
constexpr double kFarthest = 3.5;  // at most this many times what lacked in all: where the way out
                                   // leads past the part, more would only fling the arm
constexpr int kSteps = 2;          // of the linear problem, per frame and round,
constexpr double kDamping = 0.01;  // and their damping
constexpr double kFirm = 30.0;     // weight of what is no arm's: trunk and legs stand,
constexpr double kShoulder = 3.0;  // and shoulders nearly do
constexpr double kStiff = 4.0;     // weight of how hands are turned: they come along

bool some_lack(const std::vector<double>& lack) {
  return *std::ranges::max_element(lack) > kSettled;
}

/// How much a role's joint weighs more than in the solve: arms give way first.
double firmness(const std::string& role) {
  const auto known = role_named(role);
  if (!known) return kFirm;
  const Role left = side_of(*known) == Side::right ? mirrored(*known) : *known;
  if (left == Role::leftShoulder) return kShoulder;
  return left >= Role::leftUpperArm && left <= Role::leftLittleDistal ? 1.0 : kFirm;
}

bool is_hand(const std::string& role) {
  const auto known = role_named(role);
  return known && (*known == Role::leftHand || *known == Role::rightHand);
}

/// One pair of parts over the clip.
struct PairPlan {
  std::vector<double> allowed;       ///< [frame] least gap, m
  std::vector<PartGap> base;         ///< [frame] in the clip without rows; joints are rows
  std::vector<Vector3d> way, point;  ///< [frame] out of b, pelvis' space; of a, in its joint's
  std::vector<double> push;          ///< [frame] m, over all rounds; below 0: room to spare
  std::vector<double> lacked;        ///< [frame] m, the most in any round, smooth

  bool has_row(std::int64_t frame) const {
    return push[frame] > -kFar && way[frame].squaredNorm() > 0.25;
  }
};

class Separator {
 public:
  Separator(const SourceMotion& source, const Target& target, const Rig& rig,
            const EffectorTrack& track, Clip& clip)
      : source_(source),
        target_(target),
        track_(track),
        clip_(clip),
        solved_(clip),
        pushed_(clip),
        rig_(rig),
        frames_(clip.frames()),
        rows_(rig.joints.size()) {}

  Result<SelfContactFigures> run() {
    if (!place_capsules() || !measure_source()) return figures_;
    measure_base();
    find_lack();
    figures_.measured = true;
    figures_.before_m = depth_;
    figures_.pressed.assign(std::size_t(frames_), 0);
    if (some_lack(lack_)) {
      if (auto r = push_apart(); !r) return r.error();
    }
    figures_.left_m = depth_;
    return figures_;
  }

 private:
  /// The target's capsules on the rig's rows; false where there are no pairs of them.
  bool place_capsules() {
    capsules_ = body_capsules(target_.figure, target_.calibration);
    for (PartCapsule& c : capsules_) {
      c.joint = row_of(c.joint);
      c.end_joint = row_of(c.end_joint);
      for (std::int32_t& j : c.trunk) j = j == kNoJoint ? kNoJoint : row_of(j);
    }
    rig_.collisions.clear();
    for (const PartPair& pair : part_pairs()) {
      for (const PartCapsule& a : capsules_) {
        for (const PartCapsule& b : capsules_) {
          if (a.part != pair.a || b.part != pair.b) continue;
          rig_.collisions.push_back({a.joint, b.joint});
          if (b.end_joint != b.joint) rig_.collisions.push_back({a.joint, b.end_joint});
        }
      }
    }
    for (RigEffector& effector : rig_.effectors) {
      if (is_hand(rig_.joints[effector.joint].role)) effector.weight_rot *= kStiff;
    }
    return !rig_.collisions.empty();
  }

  std::int32_t row_of(std::int32_t joint) const {
    const auto row = std::ranges::find(target_.joint_of_row, joint);
    return static_cast<std::int32_t>(row - target_.joint_of_row.begin());
  }

  std::int64_t frames_of(double seconds) const {
    return std::max<std::int64_t>(1, std::lround(seconds * clip_.rate_hz));
  }

  /// The least gaps and the ways out; false where there is no body.
  bool measure_source() {
    const auto capsules = body_capsules(*source_.figure, *source_.calibration);
    if (capsules.empty()) return false;
    plans_.resize(part_pairs().size());
    const double scale = girth_scale(target_.figure, target_.calibration) /
                         girth_scale(*source_.figure, *source_.calibration);
    const std::int32_t hips = source_.figure->at(Role::hips);
    std::vector<DualQuaternion> model(source_.character->skeleton.parents.size());
    std::vector<PartGap> gaps(plans_.size());
    for (std::int64_t f = 0; f < frames_; ++f) {
      model_from_local(source_.character->skeleton, source_.clip->frame(f), model);
      part_gaps(capsules, model, gaps);
      const Quaterniond turned = since_t_pose(*source_.calibration, hips, model[hips]);
      for (std::size_t k = 0; k < plans_.size(); ++k) {
        plans_[k].allowed.push_back(std::min(scale * gaps[k].gap, 0.0) - kFleshGivesM);
        plans_[k].way.push_back(turned.conjugate() *
                                (gaps[k].on_a - gaps[k].on_b).stableNormalized());
      }
    }
    return true;
  }

  /// Gaps and nearest points of the clip without rows; what is known of the rows by then.
  void measure_base() {
    std::vector<DualQuaternion> model(rows_);
    std::vector<PartGap> gaps(plans_.size());
    for (std::int64_t f = 0; f < frames_; ++f) {
      model_from_rows(rig_, solved_.frame(f), model);
      part_gaps(capsules_, model, gaps);
      for (std::size_t k = 0; k < plans_.size(); ++k) {
        const PartGap& gap = gaps[k];
        PairPlan& plan = plans_[k];
        const bool there = gap.joint_a != kNoJoint;
        plan.base.push_back(gap);
        plan.push.push_back(std::max(plan.allowed[f] - gap.gap, -kFar));
        plan.point.push_back(there ? model[gap.joint_a].conjugate().transform_point(gap.on_a)
                                   : gap.on_a);
      }
    }
    const std::vector<double> window = smooth_window(frames_of(kDirectionS));
    for (PairPlan& plan : plans_) {
      plan.way = smooth_mean<Vector3d>(plan.way, window);
      plan.point = smooth_mean<Vector3d>(plan.point, window);
      plan.push = plan.lacked = cover(plan.push);
    }
  }

  std::vector<double> cover(const std::vector<double>& lack) const {
    return smooth_cover(lack, frames_of(kCoverS), kArch / (clip_.rate_hz * clip_.rate_hz));
  }

  /// What the clip as it is lacks: of each pair, and the most of all.
  void find_lack() {
    lack_.assign(std::size_t(frames_), 0.0);
    depth_ = lack_;
    lack_of_.assign(plans_.size(), lack_);
    std::vector<DualQuaternion> model(rows_);
    std::vector<PartGap> gaps(plans_.size());
    for (std::int64_t f = 0; f < frames_; ++f) {
      model_from_rows(rig_, clip_.frame(f), model);
      part_gaps(capsules_, model, gaps);
      for (std::size_t k = 0; k < plans_.size(); ++k) {
        lack_of_[k][f] = std::max(0.0, plans_[k].allowed[f] - gaps[k].gap);
        lack_[f] = std::max(lack_[f], lack_of_[k][f]);
        depth_[f] = std::max(depth_[f], plans_[k].allowed[f] + kFleshGivesM - gaps[k].gap);
      }
    }
  }

  Result<void> push_apart() {
    IkOptions options;
    options.stop_at_tolerance = false;
    options.separations = static_cast<int>(plans_.size());
    options.measure_residual = false;
    options.max_relinearisations = kSteps;
    options.damping = kDamping;
    auto solver = IkSolver::create(rig_, options);
    if (!solver) return solver.error();
    std::vector<std::uint8_t> due(std::size_t(frames_), 0);
    for (const PairPlan& plan : plans_) {
      for (std::int64_t f = 0; f < frames_; ++f) due[f] |= plan.has_row(f) && plan.push[f] > 0.0;
    }
    for (int round = 0; round < kRounds && some_lack(lack_); ++round) {
      if (round > 0) due = push_further();
      for (std::int64_t f = 0; f < frames_; ++f) {
        if (due[f] != 0) solve(*solver, f);
      }
      smooth_changes(due);
      find_lack();
    }
    return {};
  }

  /// Adds what still lacks; the frames that it adds to.
  std::vector<std::uint8_t> push_further() {
    std::vector<std::uint8_t> due(std::size_t(frames_), 0);
    for (std::size_t k = 0; k < plans_.size(); ++k) {
      if (!some_lack(lack_of_[k])) continue;
      const std::vector<double> more = cover(lack_of_[k]);
      for (std::int64_t f = 0; f < frames_; ++f) {
        PairPlan& plan = plans_[k];
        plan.lacked[f] = std::max(plan.lacked[f], more[f]);
        plan.push[f] =
            std::min(plan.push[f] + kFurther * more[f], std::max(0.0, kFarthest * plan.lacked[f]));
        due[f] |= more[f] > kNothing;
      }
    }
    return due;
  }

  /// One frame, onwards from where the last round left it.
  void solve(IkSolver& solver, std::int64_t frame) {
    std::vector<DualQuaternion> model(rows_);
    model_from_rows(rig_, solved_.frame(frame), model);
    solver.keep_apart(separations(frame, model));
    solver.forget();
    solver.solve(goals(frame, model), pushed_.frame(frame));
  }

  std::vector<Separation> separations(std::int64_t frame,
                                      std::span<const DualQuaternion> model) const {
    const std::int32_t hips = target_.figure.at(Role::hips);
    const Quaterniond turned = since_t_pose(target_.calibration, hips, model[row_of(hips)]);
    std::vector<Separation> out;
    for (const PairPlan& plan : plans_) {
      if (!plan.has_row(frame)) continue;
      const PartGap& base = plan.base[frame];
      Separation apart;
      apart.joint_a = base.joint_a;
      apart.joint_b = base.joint_b;
      apart.point_a = plan.point[frame];
      apart.point_b = model[base.joint_b].conjugate().transform_point(base.on_b);
      apart.normal = turned * plan.way[frame].normalized();
      const Vector3d a = model[base.joint_a].transform_point(apart.point_a);
      apart.least = apart.normal.dot(a - base.on_b) + plan.push[frame];
      out.push_back(apart);
    }
    return out;
  }

  /// Where the effectors are in the clip without rows.
  std::vector<EffectorTarget> goals(std::int64_t frame,
                                    std::span<const DualQuaternion> model) const {
    std::vector<EffectorTarget> out(track_.at(frame).begin(), track_.at(frame).end());
    for (std::size_t e = 0; e < out.size(); ++e) {
      const RigEffector& effector = rig_.effectors[e];
      const DualQuaternion& joint = model[effector.joint];
      out[e].pose = DualQuaternion::from_rotation_translation(
          joint.rotation(), joint.transform_point(effector.offset));
      out[e].weight *= firmness(rig_.joints[effector.joint].role);
    }
    return out;
  }

  /// Puts the smooth mean of the changes on the solved clip, wherever one that is new is near.
  void smooth_changes(const std::vector<std::uint8_t>& due) {
    const std::vector<double> window = smooth_window(frames_of(kChangeS));
    const auto reach = static_cast<std::int64_t>(window.size()) / 2;
    std::vector<std::uint8_t> near(std::size_t(frames_), 0);
    for (std::int64_t f = 0; f < frames_; ++f) {
      if (due[f] == 0) continue;
      const std::int64_t first = std::max<std::int64_t>(f - reach, 0);
      std::fill(near.begin() + first, near.begin() + std::min(f + reach, frames_ - 1) + 1, 1);
    }
    for (std::int64_t f = 0; f < frames_; ++f) figures_.pressed[f] |= near[f];
    for (std::size_t i = 0; i < rows_; ++i) smooth_row(i, near, window);
  }

  void smooth_row(std::size_t row, const std::vector<std::uint8_t>& near,
                  std::span<const double> window) {
    std::vector<Vector3d> turn(std::size_t(frames_), Vector3d::Zero()), move(turn);
    bool moved = false;
    for (std::int64_t f = 0; f < frames_; ++f) {
      const DualQuaternion &from = solved_.frame(f)[row], &to = pushed_.frame(f)[row];
      if (from.real.coeffs() == to.real.coeffs() && from.dual.coeffs() == to.dual.coeffs()) {
        continue;
      }
      turn[f] = rotation_log(from.rotation().conjugate() * to.rotation());
      move[f] = to.translation() - from.translation();
      moved = true;
    }
    if (!moved) return;
    turn = smooth_mean<Vector3d>(turn, window);
    move = smooth_mean<Vector3d>(move, window);
    for (std::int64_t f = 0; f < frames_; ++f) {
      if (near[f] == 0) continue;
      const DualQuaternion& from = solved_.frame(f)[row];
      clip_.frame(f)[row] = DualQuaternion::from_rotation_translation(
          (from.rotation() * rotation_exp(turn[f])).normalized(), from.translation() + move[f]);
      project_joint(rig_, static_cast<std::int32_t>(row), clip_.frame(f));
    }
  }

  const SourceMotion& source_;
  const Target& target_;
  const EffectorTrack& track_;
  Clip& clip_;
  const Clip solved_;  // without rows
  Clip pushed_;        // with them, changes not smoothed yet
  Rig rig_;
  std::int64_t frames_;
  std::size_t rows_;
  std::vector<PartCapsule> capsules_;  // their joints are rows
  std::vector<PairPlan> plans_;        // [part_pairs()]
  std::vector<double> lack_;           // [frame] m
  std::vector<double> depth_;          // [frame] m, beyond the source's
  std::vector<std::vector<double>> lack_of_;
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
  return Separator(source, target, rig, track, clip).run();
}

}  // namespace limber
