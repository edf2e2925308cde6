// One frame tells the T-pose only where somebody stands in it. What never changes tells more: the
// axis that an elbow or a knee bends about is fixed in the bone above it and in the bone below,
// whatever the pose; a foot that stands is level. Pelvis and head have no such mark: how they are
// held on average while the trunk is upright is the best guess. Spines are drawn nearly straight
// in T-poses, which is not how people stand, so their bones' directions are set.
#include "pipeline/motion_reference.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <map>
#include <span>

#include "pipeline/foot_reference.h"
#include "pipeline/reference_pose.h"

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr std::int64_t kMostFrames = 1000;  // looked at, evenly over the clip
constexpr double kUprightDeg = 12.0;        // frames in which the trunk leans further count little
constexpr double kBentSine = 0.3;           // from this bend on, the plane of a limb is known
constexpr double kEnoughFrames = 5.0;       // so bent, or the axis is not believed ...
constexpr double kSameAxis = 0.95;          // ... nor where the axes' mean is shorter than this
constexpr double kStanceShare = 0.15;       // of the frames: those in which the foot is lowest
// How T-poses are drawn: medians over 30 files that have one; from hips to shoulders and along
// bones, + forward. The share that the bones' leans have in the guess is the best over these files.
constexpr double kTrunkLeanDeg = -5.0, kSpineLeanDeg = -3.0, kNeckLeanDeg = 4.0, kHeadLeanDeg = 0.0;
constexpr double kStraightens = 0.7;
constexpr double kNoBoneDeg = 35.0;  // a head's child that lies elsewhere is not where it ends

/// Weighted mean of rotations: the eigenvector of the sum of outer products (Markley, Cheng,
/// Crassidis and Oshman, Averaging Quaternions, 2007, eq. 12-13). q and -q are the same to it.
class RotationMean {
 public:
  void add(const Quaterniond& q, double weight) {
    sum_ += weight * q.coeffs() * q.coeffs().transpose();
  }
  Quaterniond mean() const {
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> solver(sum_);
    return Quaterniond(Eigen::Vector4d(solver.eigenvectors().col(3))).normalized();
  }

 private:
  Eigen::Matrix4d sum_ = Eigen::Matrix4d::Zero();
};

/// A limb of two bones, how it lies in the T-pose, and the axis it was seen to bend about.
struct Limb {
  std::int32_t upper, middle, end;
  Vector3d bone;   ///< along both bones
  Vector3d hinge;  ///< flexion turns about it by the right-hand rule
  double frames = 0.0, seen = 0.0;
  Vector3d in_upper = Vector3d::Zero(), in_middle = Vector3d::Zero();

  void see(std::span<const DualQuaternion> model) {
    const Vector3d elbow = model[middle].translation();
    const Vector3d axis = (elbow - model[upper].translation())
                              .normalized()
                              .cross((model[end].translation() - elbow).normalized());
    if (!(axis.norm() > kBentSine)) return;
    frames += 1.0;
    seen += axis.norm();
    in_upper += model[upper].rotation().conjugate() * axis;
    in_middle += model[middle].rotation().conjugate() * axis;
  }
  bool is_known() const {
    return frames >= kEnoughFrames && in_upper.norm() > kSameAxis * seen &&
           in_middle.norm() > kSameAxis * seen;
  }
};

std::vector<Limb> limbs_of(const Figure& figure) {
  std::vector<Limb> out;
  for (const Side side : {Side::left, Side::right}) {
    const double left = side == Side::left ? 1.0 : -1.0;
    const auto add = [&](Role left_role, const Vector3d& bone, const Vector3d& hinge) {
      const int upper = index_of(on_side(left_role, side));
      const Limb limb{figure.joint[upper], figure.joint[upper + 1], figure.joint[upper + 2], bone,
                      hinge};
      if (std::min({limb.upper, limb.middle, limb.end}) != kNoJoint) out.push_back(limb);
    };
    add(Role::leftUpperArm, left * Vector3d::UnitX(), -left * Vector3d::UnitY());
    add(Role::leftUpperLeg, -Vector3d::UnitY(), Vector3d::UnitX());
  }
  return out;
}

Vector3d leaning(double forward_deg) {
  const double angle = forward_deg * M_PI / 180.0;
  return {0.0, std::cos(angle), std::sin(angle)};
}

/// Rotation whose first two axes are `along` and, as far as it is square to it, `about`.
Quaterniond with_axes(const Vector3d& along, const Vector3d& about) {
  Eigen::Matrix3d out;
  out.col(0) = along.normalized();
  out.col(1) = (about - about.dot(out.col(0)) * out.col(0)).normalized();
  out.col(2) = out.col(0).cross(out.col(1));
  return Quaterniond(out);
}

/// How a foot was turned, its toes brought to the front, and how high it was.
struct SeenFoot {
  double height = 0.0;
  Quaterniond rotation;
};

Quaterniond standing_mean(std::vector<SeenFoot> seen) {
  std::ranges::sort(seen, {}, &SeenFoot::height);
  const auto standing = static_cast<std::size_t>(std::ceil(kStanceShare * double(seen.size())));
  RotationMean out;
  for (std::size_t i = 0; i < standing; ++i) out.add(seen[i].rotation, 1.0);
  return out.mean();
}

class MotionReference {
 public:
  MotionReference(const Skeleton& skeleton, const Figure& figure)
      : skeleton_(skeleton),
        figure_(figure),
        limbs_(limbs_of(figure)),
        mean_(figure.order.size()),
        in_trunk_(figure.order.size(), 0),
        model_(figure.order.size()) {
    stack_ = figure.spine;
    stack_.insert(stack_.end(), figure.neck.begin(), figure.neck.end());
    if (figure.has(Role::head)) stack_.push_back(figure.at(Role::head));
    for (const std::int32_t j : stack_) in_trunk_[j] = 1;
    for (const std::int32_t j : figure.pelvis) in_trunk_[j] = 1;
  }

  void see(std::span<const DualQuaternion> frame) {
    model_from_local(skeleton_, frame, model_);
    const ReferenceView view(figure_, model_);
    const Quaterniond to_front = yaw_to_front(view.forward());
    const double lean = degrees_between(view.trunk(), Vector3d::UnitY()) / kUprightDeg;
    const double weight = std::exp(-lean * lean) + 1e-6;
    trunk_ += weight * (to_front * view.trunk());
    for (const std::int32_t j : figure_.order) {
      const Quaterniond seen_from =
          hangs(j) ? model_[figure_.parents[j]].rotation().conjugate() : to_front;
      mean_[j].add(seen_from * model_[j].rotation(), weight);
    }
    for (Limb& limb : limbs_) limb.see(model_);
    for (const Side side : {Side::left, Side::right}) see_foot(side, to_front);
  }

  /// The neutral pose, with the offsets between joints of a frame.
  std::vector<DualQuaternion> pose(std::span<const DualQuaternion> frame) {
    model_from_local(skeleton_, frame, model_);
    std::vector<DualQuaternion> out(model_.size());
    for (const std::int32_t j : figure_.order) {
      const std::int32_t parent = figure_.parents[j];
      const Quaterniond mean =
          hangs(j) ? out[parent].rotation() * mean_[j].mean() : mean_[j].mean();
      const Vector3d at = parent == kNoJoint ? model_[j].translation()
                                             : out[parent].transform_point(in_space_of(parent, j));
      out[j] = DualQuaternion::from_rotation_translation(neutral(j, mean).normalized(), at);
    }
    return out;
  }

 private:
  /// What is no trunk goes with its parent.
  bool hangs(std::int32_t j) const { return in_trunk_[j] == 0 && figure_.parents[j] != kNoJoint; }

  Vector3d in_space_of(std::int32_t joint, std::int32_t other) const {
    return model_[joint].rotation().conjugate() *
           (model_[other].translation() - model_[joint].translation());
  }

  std::int32_t only_child(std::int32_t joint) const {
    std::int32_t out = kNoJoint;
    for (const std::int32_t j : figure_.order) {
      if (figure_.parents[j] != joint) continue;
      if (out != kNoJoint) return kNoJoint;
      out = j;
    }
    return out;
  }

  void see_foot(Side side, const Quaterniond& to_front) {
    const std::int32_t foot = figure_.at(on_side(Role::leftFoot, side));
    if (foot == kNoJoint) return;
    std::int32_t toes = figure_.at(on_side(Role::leftToes, side));
    if (toes == kNoJoint) toes = only_child(foot);
    const DualQuaternion& ankle = model_[foot];
    SeenFoot seen{ankle.translation().y(), to_front * ankle.rotation()};
    if (toes != kNoJoint) {
      const Vector3d toe = model_[toes].translation();
      seen = {0.5 * (ankle.translation().y() + toe.y()),
              yaw_to_front(toe - ankle.translation()) * ankle.rotation()};
    }
    feet_[foot].push_back(seen);
  }

  /// A joint's rotation in the neutral pose, where more than its mean is known.
  Quaterniond neutral(std::int32_t j, const Quaterniond& mean) const {
    if (std::ranges::count(figure_.pelvis, j) > 0) {
      return Quaterniond::FromTwoVectors(trunk_, Vector3d::UnitY()) * mean;
    }
    if (const auto foot = feet_.find(j); foot != feet_.end()) return standing_mean(foot->second);
    for (const Limb& limb : limbs_) {
      if ((j != limb.upper && j != limb.middle) || !limb.is_known()) continue;
      const bool upper = j == limb.upper;
      const Vector3d along = in_space_of(j, upper ? limb.middle : limb.end);
      return with_axes(limb.bone, limb.hinge) *
             with_axes(along, upper ? limb.in_upper : limb.in_middle).conjugate();
    }
    const auto level = std::ranges::find(stack_, j);
    return level == stack_.end() ? mean : straightened(level - stack_.begin(), mean);
  }

  /// A joint of spine, neck or head: between how it is held while the trunk leans as in T-poses,
  /// and its bone where T-poses have it.
  Quaterniond straightened(std::ptrdiff_t level, const Quaterniond& mean) const {
    const std::int32_t j = stack_[level];
    const Quaterniond held = Quaterniond::FromTwoVectors(trunk_, leaning(kTrunkLeanDeg)) * mean;
    const bool last = level + 1 == std::ssize(stack_);
    const std::int32_t next = last ? only_child(j) : stack_[level + 1];
    if (next == kNoJoint) return mean;
    const Vector3d bone = in_space_of(j, next);
    const Vector3d up = leaning(level < std::ssize(figure_.spine) ? kSpineLeanDeg
                                : j == figure_.at(Role::head)     ? kHeadLeanDeg
                                                                  : kNeckLeanDeg);
    if (bone.norm() < 1e-3 || (last && degrees_between(held * bone, up) > kNoBoneDeg)) return held;
    return held.slerp(kStraightens, Quaterniond::FromTwoVectors(held * bone, up) * held);
  }

  const Skeleton& skeleton_;
  const Figure& figure_;
  std::vector<Limb> limbs_;
  std::vector<RotationMean> mean_;      // [joint], from the parent or from facing +Z
  std::vector<std::uint8_t> in_trunk_;  // [joint]
  std::vector<std::int32_t> stack_;     // spine, neck and head
  std::map<std::int32_t, std::vector<SeenFoot>> feet_;
  Vector3d trunk_ = Vector3d::Zero();  // mean, from hips to shoulders
  std::vector<DualQuaternion> model_;  // of the frame that is looked at
};

}  // namespace

std::vector<DualQuaternion> motion_reference(const Character& character, const Figure& figure,
                                             const Clip& clip, std::int64_t like) {
  MotionReference reference(character.skeleton, figure);
  const std::int64_t step = std::max<std::int64_t>(1, clip.frames() / kMostFrames);
  for (std::int64_t f = 0; f < clip.frames(); f += step) reference.see(clip.frame(f));
  return reference.pose(clip.frame(like));
}

}  // namespace limber
