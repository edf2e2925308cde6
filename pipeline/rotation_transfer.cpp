#include "pipeline/rotation_transfer.h"

#include <algorithm>
#include <cmath>

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

/// The share of a source chain that each joint of a target chain takes: joint k of m sits at k/m
/// of the chain's length, and takes the rotation interpolated there; both ends agree.
Quaterniond along_chain(std::span<const Quaterniond> since, std::size_t k, std::size_t m) {
  const double position = double(k) * double(since.size() - 1) / double(m);
  const auto below = std::min(static_cast<std::size_t>(position + 1e-9), since.size() - 1);
  const auto above = std::min(below + 1, since.size() - 1);
  const double t = std::clamp(position - double(below), 0.0, 1.0);
  return since[below].slerp(t, since[above]);
}

/// Where the bones of trunk's top, neck and head sit along the way from the shoulder girdle to the
/// head joint: the middle of each bone, 0 at the girdle, 1 at the head joint. Files split that way
/// at very different heights, so joints are matched by length, not by count.
std::vector<double> neck_places(const Figure& figure, const Calibration& calibration) {
  std::vector<std::int32_t> joints{figure.spine.empty() ? figure.at(Role::hips)
                                                        : figure.spine.back()};
  joints.insert(joints.end(), figure.neck.begin(), figure.neck.end());
  if (figure.has(Role::head)) joints.push_back(figure.at(Role::head));
  std::vector<double> at(joints.size(), 0.0);
  for (std::size_t i = 1; i < joints.size(); ++i) {
    at[i] =
        at[i - 1] + (calibration.position(joints[i]) - calibration.position(joints[i - 1])).norm();
  }
  const double length = std::max(at.back(), 1e-6);
  std::vector<double> middle;
  for (std::size_t i = 0; i < at.size(); ++i) {
    const double next = i + 1 < at.size() ? at[i + 1] : at[i] + 0.5 * length;
    middle.push_back(0.5 * (at[i] + next) / length);
  }
  return middle;
}

/// The rotation at `place`, interpolated between bones whose middles lie at `places`.
Quaterniond at_place(std::span<const Quaterniond> since, std::span<const double> places,
                     double place) {
  std::size_t i = 0;
  while (i + 2 < places.size() && places[i + 1] <= place) ++i;
  if (places.size() < 2) return since[0];
  const double gap = places[i + 1] - places[i];
  const double t = gap > 1e-9 ? std::clamp((place - places[i]) / gap, 0.0, 1.0) : 1.0;
  return since[i].slerp(t, since[i + 1]);
}

}  // namespace

RotationTransfer::RotationTransfer(const SourceMotion& source, const Target& target,
                                   FingerMode fingers)
    : source_(source),
      target_(target),
      fingers_(fingers),
      roles_(roles_by_joint(target.figure, target.character.skeleton.size())),
      carried_(target.character.skeleton.parents.size(), kNoJoint) {
  find_carried();
  if (source.figure->is_body() && target.figure.is_body()) {
    source_neck_ = neck_places(*source.figure, *source.calibration);
    target_neck_ = neck_places(target.figure, target.calibration);
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
  trunk(model, since);
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

void RotationTransfer::trunk(std::span<const DualQuaternion> model,
                             std::span<Quaterniond> since) const {
  const Figure& from = *source_.figure;
  const Figure& to = target_.figure;
  if (!from.is_body() || !to.is_body()) return;
  const auto turn = [&](std::int32_t j) { return since_t_pose(*source_.calibration, j, model[j]); };
  std::vector<Quaterniond> spine{turn(from.at(Role::hips))};
  for (const std::int32_t j : from.spine) spine.push_back(turn(j));
  for (std::size_t k = 0; k < to.spine.size(); ++k) {
    since[to.spine[k]] = along_chain(spine, k + 1, to.spine.size());
  }
  std::vector<Quaterniond> neck{spine.back()};
  for (const std::int32_t j : from.neck) neck.push_back(turn(j));
  if (from.has(Role::head)) neck.push_back(turn(from.at(Role::head)));
  for (std::size_t k = 0; k < to.neck.size(); ++k) {
    since[to.neck[k]] = at_place(neck, source_neck_, target_neck_[k + 1]);
  }
  if (to.has(Role::head)) since[to.at(Role::head)] = neck.back();
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

/// Joints without a role that both skeletons have under one name (twist joints, props, jaws).
void RotationTransfer::find_carried() {
  const Skeleton& from = source_.character->skeleton;
  const Skeleton& to = target_.character.skeleton;
  const auto source_roles = roles_by_joint(*source_.figure, from.size());
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
