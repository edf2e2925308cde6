#include "pipeline/rotation_transfer.h"

#include <algorithm>
#include <cmath>

namespace limber {

using Eigen::Quaterniond;
using Eigen::Vector3d;

RotationTransfer::RotationTransfer(const SourceMotion& source, const Target& target,
                                   FingerMode fingers)
    : source_(source),
      target_(target),
      fingers_(fingers),
      roles_(roles_by_joint(target.figure, target.character.skeleton.size())),
      carried_(target.character.skeleton.parents.size(), kNoJoint) {
  find_carried();
  if (source.figure->is_body() && target.figure.is_body()) {
    trunk_.emplace(*source.figure, *source.calibration, target.figure, target.calibration);
  }
}

void RotationTransfer::frame(std::span<const DualQuaternion> model,
                             std::span<Quaterniond> since) const {
  const Figure& from = *source_.figure;
  const Figure& to = target_.figure;
  const auto turn = [&](std::int32_t j) { return since_t_pose(*source_.calibration, j, model[j]); };
  for (const std::int32_t j : to.order) {
    const std::int32_t parent = to.parents[j];
    since[j] = parent == kNoJoint ? Quaterniond::Identity() : since[parent];
    if (!roles_[j]) continue;
    const Role role = *roles_[j];
    if (from.has(role)) {
      since[j] = turn(from.at(role));
    } else if (is_finger(role)) {
      since[j] = since[parent] * absent_finger(role);
    } else if (const auto up = nearest_source_parent(role)) {
      since[j] = turn(from.at(*up));
    }
  }
  if (trunk_) {
    trunk_->frame(model, since);
    turn_pelvis(model, since);
  }
  if (target_.figure.is_hand()) settle_hand(model, since);
}

std::optional<Role> RotationTransfer::nearest_source_parent(Role role) const {
  for (auto p = parent_of(role); p; p = parent_of(*p)) {
    if (source_.figure->has(*p)) return p;
  }
  return std::nullopt;
}

/// A relaxed hand: each joint flexed a little against the one before, thumb left alone.
Quaterniond RotationTransfer::absent_finger(Role role) const {
  if (fingers_ == FingerMode::rest || is_thumb(role)) return Quaterniond::Identity();
  const double flexion = name_of(role).ends_with("Intermediate") ? 0.5 : 0.3;
  const double sign = side_of(role) == Side::left ? -1.0 : 1.0;
  return Quaterniond(Eigen::AngleAxisd(sign * flexion, Vector3d::UnitZ()));
}

/// Joints within the pelvis turn as one, or as their namesakes do.
void RotationTransfer::turn_pelvis(std::span<const DualQuaternion> model,
                                   std::span<Quaterniond> since) const {
  const Figure& from = *source_.figure;
  const Figure& to = target_.figure;
  const bool twins = carried_[to.at(Role::hips)] != kNoJoint;
  for (std::size_t k = 0; k < to.pelvis.size(); ++k) {
    const std::int32_t j = twins ? from.pelvis[k] : from.at(Role::hips);
    since[to.pelvis[k]] = since_t_pose(*source_.calibration, j, model[j]);
  }
}

/// A hand on a forearm that stays: turns against the source's forearm, seen from the target's own
/// rest orientation.
void RotationTransfer::settle_hand(std::span<const DualQuaternion> model,
                                   std::span<Quaterniond> since) const {
  const std::int32_t hand = target_.figure.root();
  const auto row = std::find(target_.joint_of_row.begin(), target_.joint_of_row.end(), hand);
  if (target_.rig.joints[row - target_.joint_of_row.begin()].type == JointType::free) return;
  const Side side = target_.figure.hand_side();
  const std::int32_t forearm = source_.figure->at(on_side(Role::leftLowerArm, side));
  const Quaterniond against =
      forearm == kNoJoint ? Quaterniond::Identity()
                          : since_t_pose(*source_.calibration, forearm, model[forearm]).conjugate();
  const Quaterniond& w = target_.world_from_t_pose;
  for (Quaterniond& q : since) q = w * against * q * w.conjugate();
}

/// Joints that both skeletons have under one name: those within a pelvis, and those without a role
/// (twist joints, props, jaws).
void RotationTransfer::find_carried() {
  const Skeleton& from = source_.character->skeleton;
  const Skeleton& to = target_.character.skeleton;
  const auto source_roles = roles_by_joint(*source_.figure, from.size());
  const auto& to_pelvis = target_.figure.pelvis;
  const auto& from_pelvis = source_.figure->pelvis;
  const bool twins = std::ranges::equal(
      to_pelvis, from_pelvis,
      [&](std::int32_t a, std::int32_t b) { return to.names[a] == from.names[b]; });
  for (std::size_t k = 1; twins && k < to_pelvis.size(); ++k)
    carried_[to_pelvis[k]] = from_pelvis[k];
  for (std::int32_t j = 0; j < to.size(); ++j) {
    if (roles_[j]) continue;
    const std::int32_t twin = from.find(to.names[j]);
    if (twin == kNoJoint || source_roles[twin]) continue;
    const std::int32_t a = to.parents[j], b = from.parents[twin];
    if (a == kNoJoint || b == kNoJoint || to.names[a] != from.names[b]) continue;
    carried_[j] = twin;
  }
}

}  // namespace limber
