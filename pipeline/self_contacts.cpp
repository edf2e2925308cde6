// Bodies of other proportions carry the source's hands into their own hips. Here they are kept out.
//
// Both figures are capsules (body_capsules.cpp). For a pair of parts let g(t) be the gap in the
// solved clip and a(t) = min(scaled gap of the source, 0) the least that is asked for: hands that
// touch go on touching, and only where the source is deeper itself may the target be. What lacks is
// v = max(0, a - g).
//
// Of limbs that run through each other the nearest way out turns over within a frame or two, and a
// row that began to press at v > 0 would move the arm at once. So neither is used as it is. The
// direction n is the one in which the source, which is not inside, has the arm's part from the
// other, averaged by the lack around the frame, in the pelvis' space. The distance is
//   s = w * max over a window of v,
// w an average over the same window by smooth weights: s >= v, because each value that is averaged
// over has v's own place in its window, and s rises from 0 and returns to it smoothly. A row then
// asks for  n . (a - b) >= what it is + s  of the points a and b where the axes were nearest. What
// lacks after that is added in further rounds.
//
// Each frame is a projection: the nearest pose to the solved one, in the measure of the effectors'
// cost, that keeps the rows and the limits. That is the constrained solve itself as far as
// Gauss-Newton sees it, expanded about the solve without rows: the goals are where that has left
// the effectors, so a frame in which nothing presses is that very frame. Arms give way before the
// trunk and the legs do.
#include "pipeline/self_contacts.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "pipeline/body_capsules.h"
#include "solver/ik_solver.h"

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kEaseS = 0.15;    // half a window
constexpr double kSettled = 1e-4;  // m: a lack that counts as none
constexpr double kNothing = 1e-6;  // m: a push that does
constexpr int kRounds = 16;
constexpr double kFirm = 30.0;  // weight of what is no arm's: trunk and legs stand
constexpr double kStiff = 4.0;  // weight of how hands and fingers are turned: they come along

bool some_lack(const std::vector<double>& lack) {
  return *std::ranges::max_element(lack) > kSettled;
}

/// [k] Weights of a smooth average over -reach .. reach, sum 1.
std::vector<double> window(std::int64_t reach) {
  std::vector<double> out;
  for (std::int64_t k = -reach; k <= reach; ++k) {
    out.push_back((1.0 + std::cos(M_PI * double(k) / double(reach + 1))) / double(2 * reach + 2));
  }
  return out;
}

/// [frame] A smooth function that is at least v and 0 where v is 0 all around.
std::vector<double> smooth_cover(const std::vector<double>& v, std::int64_t reach) {
  const auto last = static_cast<std::int64_t>(v.size()) - 1;
  const std::vector<double> weight = window(reach);
  std::vector<double> highest(v.size()), out(v.size(), 0.0);
  for (std::int64_t f = 0; f <= last; ++f) {
    const auto from = v.begin() + std::max<std::int64_t>(f - reach, 0);
    highest[f] = *std::max_element(from, v.begin() + std::min(f + reach, last) + 1);
  }
  for (std::int64_t f = 0; f <= last; ++f) {
    for (std::int64_t k = -reach; k <= reach; ++k) {
      out[f] += weight[k + reach] * highest[std::clamp<std::int64_t>(f + k, 0, last)];
    }
  }
  return out;
}

/// [frame] The mean of vectors around, each as heavy as its weight.
std::vector<Vector3d> weighted_mean(const std::vector<Vector3d>& x, const std::vector<double>& w,
                                    std::int64_t reach) {
  const auto last = static_cast<std::int64_t>(x.size()) - 1;
  const std::vector<double> near = window(reach);
  std::vector<Vector3d> out(x.size(), Vector3d::Zero());
  for (std::int64_t f = 0; f <= last; ++f) {
    double sum = 0.0;
    for (std::int64_t k = std::max(-reach, -f); k <= std::min(reach, last - f); ++k) {
      out[f] += near[k + reach] * w[f + k] * x[f + k];
      sum += near[k + reach] * w[f + k];
    }
    if (sum > 0.0) out[f] /= sum;
  }
  return out;
}

/// One pair of parts over the clip.
struct PairPlan {
  std::vector<double> allowed;        ///< [frame] least gap, m
  std::vector<Vector3d> way;          ///< [frame] out of b in the source, pelvis' space
  std::vector<PartGap> base;          ///< [frame] in the clip without rows; joints are rows
  std::vector<Vector3d> point;        ///< [frame] base.on_a in its joint's space
  std::vector<double> lacked, least;  ///< [frame] m, over all rounds: lack and push
  std::vector<Vector3d> mean_way, mean_point;  ///< [frame]
  bool pushes = false;
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
        rig_(rig),
        frames_(clip.frames()),
        rows_(rig.joints.size()),
        reach_(std::lround(kEaseS * clip.rate_hz)),
        plans_(part_pairs().size()) {}

  Result<SelfContactFigures> run() {
    if (!place_capsules() || !measure_source()) return figures_;
    measure_base();
    find_lack();
    figures_.measured = true;
    figures_.before_m = lack_;
    figures_.pressed.assign(std::size_t(frames_), 0);
    if (some_lack(lack_)) {
      auto solver = make_solver();
      if (!solver) return solver.error();
      for (int round = 0; round < kRounds && some_lack(lack_); ++round) {
        push_further();
        for (std::int64_t f = 0; f < frames_; ++f) {
          if (changed_[f] != 0) solve(*solver, f);
        }
        find_lack();
      }
    }
    figures_.left_m = lack_;
    return figures_;
  }

 private:
  /// The target's capsules on the rig's rows; false where there are no pairs of them.
  bool place_capsules() {
    capsules_ = body_capsules(target_.figure, target_.calibration);
    rig_.collisions.clear();
    for (RigEffector& effector : rig_.effectors) {
      if (is_hand(rig_.joints[effector.joint].role)) effector.weight_rot *= kStiff;
    }
    for (PartCapsule& c : capsules_) {
      const auto row = std::ranges::find(target_.joint_of_row, c.joint);
      c.joint = static_cast<std::int32_t>(row - target_.joint_of_row.begin());
    }
    for (const PartPair& pair : part_pairs()) {
      for (const PartCapsule& a : capsules_) {
        for (const PartCapsule& b : capsules_) {
          if (a.part == pair.a && b.part == pair.b) rig_.collisions.push_back({a.joint, b.joint});
        }
      }
    }
    return !rig_.collisions.empty();
  }

  /// The least gaps and the ways out; false where there is no body.
  bool measure_source() {
    const auto capsules = body_capsules(*source_.figure, *source_.calibration);
    if (capsules.empty()) return false;
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
        plans_[k].allowed.push_back(std::min(scale * gaps[k].gap, 0.0));
        plans_[k].way.push_back(turned.conjugate() *
                                (gaps[k].on_a - gaps[k].on_b).stableNormalized());
      }
    }
    return true;
  }

  void measure_base() {
    std::vector<DualQuaternion> model(rows_);
    std::vector<PartGap> gaps(plans_.size());
    for (std::int64_t f = 0; f < frames_; ++f) {
      model_from_rows(rig_, solved_.frame(f), model);
      part_gaps(capsules_, model, gaps);
      for (std::size_t k = 0; k < plans_.size(); ++k) {
        const PartGap& gap = gaps[k];
        plans_[k].base.push_back(gap);
        plans_[k].point.push_back(gap.joint_a == kNoJoint
                                      ? Vector3d(Vector3d::Zero())
                                      : model[gap.joint_a].conjugate().transform_point(gap.on_a));
      }
    }
    for (PairPlan& plan : plans_) {
      plan.lacked.assign(std::size_t(frames_), 0.0);
      plan.least = plan.lacked;
    }
  }

  /// What the clip as it is lacks: of each pair, and the most of all.
  void find_lack() {
    lack_.assign(std::size_t(frames_), 0.0);
    lack_of_.assign(plans_.size(), lack_);
    std::vector<DualQuaternion> model(rows_);
    std::vector<PartGap> gaps(plans_.size());
    for (std::int64_t f = 0; f < frames_; ++f) {
      model_from_rows(rig_, clip_.frame(f), model);
      part_gaps(capsules_, model, gaps);
      for (std::size_t k = 0; k < plans_.size(); ++k) {
        lack_of_[k][f] = std::max(0.0, plans_[k].allowed[f] - gaps[k].gap);
        lack_[f] = std::max(lack_[f], lack_of_[k][f]);
      }
    }
  }

  void push_further() {
    changed_.assign(std::size_t(frames_), 0);
    for (std::size_t k = 0; k < plans_.size(); ++k) {
      PairPlan& plan = plans_[k];
      const std::vector<double>& lack = lack_of_[k];
      if (!some_lack(lack)) continue;
      plan.pushes = true;
      const std::vector<double> more = smooth_cover(lack, reach_);
      for (std::int64_t f = 0; f < frames_; ++f) {
        plan.lacked[f] += lack[f];
        plan.least[f] += more[f];
        if (more[f] > kNothing) figures_.pressed[f] = changed_[f] = 1;
      }
      plan.mean_way = weighted_mean(plan.way, plan.lacked, 2 * reach_);
      plan.mean_point = weighted_mean(plan.point, plan.lacked, 2 * reach_);
    }
  }

  Result<IkSolver> make_solver() {
    IkOptions options;
    options.stop_at_tolerance = false;
    options.separations = static_cast<int>(plans_.size());
    options.measure_residual = false;
    return IkSolver::create(rig_, options);
  }

  /// One frame of the clip, anew from where the last round left it.
  void solve(IkSolver& solver, std::int64_t frame) {
    std::vector<DualQuaternion> model(rows_);
    model_from_rows(rig_, solved_.frame(frame), model);
    const std::vector<Separation> apart = separations(frame, model);
    if (apart.empty()) return;
    solver.keep_apart(apart);
    solver.forget();
    solver.solve(goals(frame, model), clip_.frame(frame));
  }

  std::vector<Separation> separations(std::int64_t frame,
                                      std::span<const DualQuaternion> model) const {
    const std::int32_t hips = target_.figure.at(Role::hips);
    const auto row = std::ranges::find(target_.joint_of_row, hips) - target_.joint_of_row.begin();
    const Quaterniond turned = since_t_pose(target_.calibration, hips, model[row]);
    std::vector<Separation> out;
    for (const PairPlan& plan : plans_) {
      if (!plan.pushes || plan.least[frame] <= kNothing) continue;
      const PartGap& base = plan.base[frame];
      Separation apart;
      apart.joint_a = base.joint_a;
      apart.joint_b = base.joint_b;
      apart.point_a = plan.mean_point[frame];
      apart.point_b = model[base.joint_b].conjugate().transform_point(base.on_b);
      apart.normal = (turned * plan.mean_way[frame]).stableNormalized();
      if (!(apart.normal.squaredNorm() > 0.5)) continue;  // the source lacks the part
      const Vector3d a = model[base.joint_a].transform_point(apart.point_a);
      apart.least = apart.normal.dot(a - base.on_b) + plan.least[frame];
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
      if (!is_arm(rig_.joints[effector.joint].role)) out[e].weight *= kFirm;
    }
    return out;
  }

  static bool is_arm(const std::string& role) {
    const auto known = role_named(role);
    if (!known) return false;
    const Role left = side_of(*known) == Side::right ? mirrored(*known) : *known;
    return left >= Role::leftShoulder && left <= Role::leftLittleDistal;
  }

  static bool is_hand(const std::string& role) {
    const auto known = role_named(role);
    return known && (*known == Role::leftHand || *known == Role::rightHand || is_finger(*known));
  }

  const SourceMotion& source_;
  const Target& target_;
  const EffectorTrack& track_;
  Clip& clip_;
  const Clip solved_;  // without rows
  Rig rig_;
  std::int64_t frames_;
  std::size_t rows_;
  std::int64_t reach_;                 // frames
  std::vector<PartCapsule> capsules_;  // their joints are rows
  std::vector<PairPlan> plans_;        // [part_pairs()]
  std::vector<double> lack_;           // [frame] m
  std::vector<std::vector<double>> lack_of_;
  std::vector<std::uint8_t> changed_;  // [frame] in this round
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
