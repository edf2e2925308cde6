#include "pipeline/finger_shape.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "pipeline/limit_approach.h"

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr int kFingers = 5;  // thumb, index, middle, ring, little

// Distances between the ends of bones, wrist to middle knuckle = 1. They lie inside the flesh, up
// to a tenth of the palm apart where fingertips touch.
constexpr double kTouching = 0.1;
constexpr double kApart = 0.25;
constexpr double kHeldS = 0.1;  // what is shorter is no touch but fingers on their way

// A radian of a finger joint costs as much as 10 mm of a fingertip: shape yields to a touch, but no
// finger folds up for one that its length does not allow.
constexpr double kShapeWeight = 0.1;
constexpr double kTouches = 1e-6;  // m; nothing to do below

/// 1 for tips that touch, 0 for tips apart, smooth between.
double closeness(double distance) {
  const double t = std::clamp((kApart - distance) / (kApart - kTouching), 0.0, 1.0);
  return t * t * (3.0 - 2.0 * t);
}

/// What of a weight over the clip lasts for `held` frames (the greatest lower bound over a window
/// of that many that holds the frame), eased in and out over as many.
std::vector<double> lasting(const std::vector<double>& weight, std::int64_t held) {
  const auto frames = static_cast<std::int64_t>(weight.size());
  std::vector<double> out(weight.size(), 0.0), eased(weight.size(), 0.0);
  for (std::int64_t begin = 0; begin + held <= frames; ++begin) {
    const double least = *std::min_element(weight.begin() + begin, weight.begin() + begin + held);
    for (std::int64_t f = begin; f < begin + held; ++f) out[f] = std::max(out[f], least);
  }
  for (std::int64_t f = 0; f < frames; ++f) {
    const std::int64_t half = held / 2;
    for (std::int64_t k = f - half; k <= f + half; ++k) {
      eased[f] += out[std::clamp<std::int64_t>(k, 0, frames - 1)] / double(2 * half + 1);
    }
  }
  return eased;
}

Role joint_of_finger(Side side, int finger, int k) {
  return on_side(role_at(index_of(Role::leftThumbMetacarpal) + 3 * finger + k), side);
}

/// The end of a finger: a point in the space of its last joint.
struct Fingertip {
  std::int32_t joint = kNoJoint;
  Vector3d point = Vector3d::Zero();
};

/// Files without end joints leave out where the last bone ends: about four fifths of the one
/// before.
Fingertip fingertip(const Figure& figure, const Calibration& calibration, Side side, int finger) {
  const std::int32_t last = figure.at(joint_of_finger(side, finger, 2));
  const std::int32_t before = figure.at(joint_of_finger(side, finger, 1));
  if (last == kNoJoint || before == kNoJoint) return {};
  if (calibration.tip[last].norm() > 1e-6) return {last, calibration.tip[last]};
  const Vector3d bone = calibration.position(last) - calibration.position(before);
  return {last, calibration.model_from_joint[last].rotation().conjugate() * (0.8 * bone)};
}

/// One hand of the target: the rows that hang on it, as a rig of their own whose palm is fixed.
class Hand {
 public:
  Hand(const SourceMotion& source, const Target& target, EffectorTrack& track, Side side,
       std::span<const std::int32_t> row_of)
      : source_(source), target_(target), track_(track), side_(side) {
    const std::int32_t palm = target.figure.at(on_side(Role::leftHand, side));
    std::vector<std::int32_t> own(target.rig.joints.size(), kNoJoint);
    add_row(row_of[palm], kNoJoint, own);
    rig_.joints[0].type = JointType::fixed;
    for (std::int32_t i = row_of[palm] + 1; i < target.rig.size(); ++i) {
      const std::int32_t parent = target.rig.joints[i].parent;
      if (parent != kNoJoint && own[parent] != kNoJoint) add_row(i, own[parent], own);
    }
    for (int k = 0; k < kFingers; ++k) {
      source_tip_[k] = fingertip(*source.figure, *source.calibration, side, k);
      target_tip_[k] = fingertip(target.figure, target.calibration, side, k);
      if (target_tip_[k].joint != kNoJoint)
        target_tip_[k].joint = own[row_of[target_tip_[k].joint]];
    }
  }

  void settle_wrist() {
    const RigJoint& wrist = target_.rig.joints[rows_[0]];
    std::vector<Quaterniond> turns;
    for (std::int64_t f = 0; f < track_.frames; ++f) {
      turns.push_back(wrist.rest.conjugate() * local(f, 0).rotation());
    }
    bend_into_limits(wrist, bone(0), turns);
    for (std::int64_t f = 0; f < track_.frames; ++f) set_rotation(f, 0, wrist.rest * turns[f]);
  }

  void bend() {
    std::vector<Quaterniond> turns(static_cast<std::size_t>(track_.frames));
    for (std::size_t i = 1; i < rows_.size(); ++i) {
      const RigJoint& row = rig_.joints[i];
      if (row.type == JointType::fixed) continue;
      for (std::int64_t f = 0; f < track_.frames; ++f) {
        turns[std::size_t(f)] = row.rest.conjugate() * local(f, i).rotation();
      }
      bend_into_limits(row, bone(i), turns);
      for (std::int64_t f = 0; f < track_.frames; ++f) {
        set_rotation(f, i, row.rest * turns[std::size_t(f)]);
      }
    }
  }

  Result<void> pinch() {
    if (target_tip_[0].joint == kNoJoint || source_tip_[0].joint == kNoJoint) return {};
    if (source_.calibration->hand_length <= 0.0 || target_.calibration.hand_length <= 0.0)
      return {};
    if (!find_touches()) return {};
    add_effectors();
    auto solver = IkSolver::create(rig_, {.stop_at_tolerance = false});
    if (!solver) return solver.error();
    Pose pose(rows_.size()), model(rows_.size());
    std::vector<EffectorTarget> targets(rig_.effectors.size());
    for (std::int64_t f = 0; f < track_.frames; ++f) {
      for (std::size_t i = 0; i < rows_.size(); ++i) pose[i] = local(f, i);
      pose[0] = DualQuaternion::identity();
      model_from_rows(rig_, pose, model);
      if (!aim_tips(std::size_t(f), model, targets)) continue;
      solver->forget();
      solver->solve(targets, pose);
      for (std::size_t i = 1; i < rows_.size(); ++i) set_rotation(f, i, pose[i].rotation());
    }
    return {};
  }

 private:
  void add_row(std::int32_t row, std::int32_t parent, std::vector<std::int32_t>& own) {
    own[row] = rig_.size();
    rows_.push_back(row);
    rig_.joints.push_back(target_.rig.joints[row]);
    RigJoint& added = rig_.joints.back();
    added.parent = parent;
    if (parent != kNoJoint) return;
    added.offset.setZero();
    added.rest.setIdentity();
  }

  DualQuaternion& local(std::int64_t f, std::size_t i) const {
    return track_.guess[std::size_t(f) * target_.rig.joints.size() + std::size_t(rows_[i])];
  }
  void set_rotation(std::int64_t f, std::size_t i, const Quaterniond& rotation) const {
    DualQuaternion& q = local(f, i);
    q = DualQuaternion::from_rotation_translation(rotation.normalized(), q.translation());
  }

  /// The way a bone points; a last bone without an end goes on as the one before.
  Vector3d bone(std::size_t i) const {
    const Vector3d& tip = target_.calibration.tip[target_.joint_of_row[rows_[i]]];
    if (tip.norm() > 1e-6) return tip.normalized();
    const RigJoint& row = rig_.joints[i];
    if (row.offset.norm() < 1e-6) return Vector3d::UnitX();
    return row.rest.conjugate() * row.offset.normalized();
  }

  void add_effectors() {
    for (const Fingertip& tip : target_tip_) {
      if (tip.joint == kNoJoint) continue;
      RigEffector effector;
      effector.joint = tip.joint;
      effector.kind = EffectorKind::position;
      effector.offset = tip.point;
      rig_.effectors.push_back(effector);
    }
    for (std::int32_t i = 1; i < rig_.size(); ++i) {
      if (rig_.joints[i].type == JointType::fixed) continue;
      RigEffector effector;
      effector.joint = i;
      effector.kind = EffectorKind::orientation;
      effector.weight_rot = kShapeWeight;
      rig_.effectors.push_back(effector);
    }
  }

  /// From the thumb's tip to a finger's in the source, carried to the target's palm and size.
  Vector3d thumb_to(int finger, std::span<const DualQuaternion> source_model) const {
    const Fingertip &thumb = source_tip_[0], &tip = source_tip_[finger];
    const Vector3d way = source_model[tip.joint].transform_point(tip.point) -
                         source_model[thumb.joint].transform_point(thumb.point);
    const Role hand = on_side(Role::leftHand, side_);
    const std::int32_t from = source_.figure->at(hand), to = target_.figure.at(hand);
    const Vector3d in_t_pose =
        since_t_pose(*source_.calibration, from, source_model[from]).conjugate() * way;
    return target_.calibration.model_from_joint[to].rotation().conjugate() *
           (target_.world_from_t_pose * in_t_pose) * target_.calibration.hand_length /
           source_.calibration->hand_length;
  }

  /// Which tips touch the thumb's, when, and how they lie; false where none does.
  bool find_touches() {
    std::vector<DualQuaternion> model(source_.character->skeleton.parents.size());
    for (std::int64_t f = 0; f < track_.frames; ++f) {
      model_from_local(source_.character->skeleton, source_.clip->frame(f), model);
      for (int k = 1; k < kFingers; ++k) {
        if (source_tip_[k].joint == kNoJoint || target_tip_[k].joint == kNoJoint) continue;
        way_[k].push_back(thumb_to(k, model));
        near_[k].push_back(closeness(way_[k].back().norm() / target_.calibration.hand_length));
      }
    }
    const auto held = std::max<std::int64_t>(1, std::llround(kHeldS * source_.clip->rate_hz));
    bool any = false;
    for (std::vector<double>& near : near_) {
      near = lasting(near, held);
      any = any || std::any_of(near.begin(), near.end(), [](double w) { return w > 0.0; });
    }
    return any;
  }

  /// Fills the targets; false where no tips touch in this frame, or all do as they are. Thumb and
  /// finger go half the way each; a thumb that meets several fingers goes to their middle.
  bool aim_tips(std::size_t f, std::span<const DualQuaternion> model,
                std::span<EffectorTarget> targets) const {
    std::array<Vector3d, kFingers> at;
    for (int k = 0; k < kFingers; ++k) {
      const Fingertip& tip = target_tip_[k];
      at[k] =
          tip.joint == kNoJoint ? Vector3d::Zero() : model[tip.joint].transform_point(tip.point);
    }
    Vector3d pull = Vector3d::Zero();
    double weight = 0.0, farthest = 0.0;
    for (int k = 1; k < kFingers; ++k) {
      if (near_[k].empty()) continue;
      const Vector3d miss = near_[k][f] * (at[k] - at[0] - way_[k][f]);
      farthest = std::max(farthest, miss.norm());
      pull += miss;
      weight += near_[k][f];
    }
    if (farthest < kTouches) return false;
    const Vector3d thumb = at[0] + 0.5 * pull / std::max(1.0, weight);
    std::size_t e = 0;
    for (int k = 0; k < kFingers; ++k) {
      if (target_tip_[k].joint == kNoJoint) continue;
      Vector3d p = k == 0 ? thumb : at[k];
      if (!near_[k].empty()) p += near_[k][f] * (thumb + way_[k][f] - at[k]);
      targets[e++].pose = DualQuaternion::from_rotation_translation(Quaterniond::Identity(), p);
    }
    for (; e < targets.size(); ++e) targets[e].pose = model[rig_.effectors[e].joint];
    return true;
  }

  const SourceMotion& source_;
  const Target& target_;
  EffectorTrack& track_;
  Side side_;
  Rig rig_;                         // row 0 is the palm
  std::vector<std::int32_t> rows_;  // of the target's rig
  std::array<Fingertip, kFingers> source_tip_, target_tip_;
  std::array<std::vector<Vector3d>, kFingers> way_;  // [finger][frame] thumb's tip to finger's
  std::array<std::vector<double>, kFingers> near_;   // [finger][frame] 1: they touch
};

}  // namespace

Result<void> shape_fingers(const SourceMotion& source, const Target& target, EffectorTrack& track) {
  std::vector<std::int32_t> row_of(target.character.skeleton.parents.size(), kNoJoint);
  for (std::size_t i = 0; i < target.joint_of_row.size(); ++i) {
    row_of[target.joint_of_row[i]] = static_cast<std::int32_t>(i);
  }
  for (const Side side : {Side::left, Side::right}) {
    const Role palm = on_side(Role::leftHand, side);
    if (!target.figure.has_fingers(side) || !target.figure.has(palm)) continue;
    Hand hand(source, target, track, side, row_of);
    if (target.figure.is_hand()) hand.settle_wrist();
    hand.bend();
    if (!source.figure->has_fingers(side) || !source.figure->has(palm)) continue;
    if (auto r = hand.pinch(); !r) return r;
  }
  return {};
}

}  // namespace limber
