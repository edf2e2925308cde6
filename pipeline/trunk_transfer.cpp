#include "pipeline/trunk_transfer.h"

#include <algorithm>
#include <cmath>

namespace limber {
namespace {

using Eigen::Matrix3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr int kLeanSteps = 3;         // a step leaves a few per cent of the angle
constexpr double kMaxLeanGain = 3.0;  // short lower spines bend no more than this per step

bool has_shoulders(const Figure& figure) {
  return figure.has(Role::leftUpperArm) && figure.has(Role::rightUpperArm);
}

/// Left, up and forward of a trunk: up from between the hip joints to between the shoulders, left
/// by the lines through both.
template <class Position>
Matrix3d trunk_axes(const Figure& figure, const Position& p) {
  const Vector3d left_hip = p(figure.at(Role::leftUpperLeg));
  const Vector3d right_hip = p(figure.at(Role::rightUpperLeg));
  const Vector3d left_arm = p(figure.at(Role::leftUpperArm));
  const Vector3d right_arm = p(figure.at(Role::rightUpperArm));
  const Vector3d up = (left_arm + right_arm - left_hip - right_hip).normalized();
  const Vector3d lines = (left_hip - right_hip).normalized() + (left_arm - right_arm).normalized();
  const Vector3d left = (lines - lines.dot(up) * up).normalized();
  Matrix3d axes;
  axes << left, up, left.cross(up);
  return axes;
}

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

TrunkTransfer::TrunkTransfer(const Figure& from, const Calibration& from_t_pose, const Figure& to,
                             const Calibration& to_t_pose)
    : from_(from),
      to_(to),
      from_t_pose_(from_t_pose),
      to_t_pose_(to_t_pose),
      source_neck_(neck_places(from, from_t_pose)),
      target_neck_(neck_places(to, to_t_pose)) {
  if (to.spine.empty() || !has_shoulders(from) || !has_shoulders(to)) return;
  list_bones();
  source_axes_ = trunk_axes(from, [&](std::int32_t j) { return from_t_pose.position(j); });
  target_axis_ = trunk_axes(to, [&](std::int32_t j) { return to_t_pose.position(j); }).col(1);
}

/// Joints that do not turn on their own (helpers) belong to the next one towards the hips.
void TrunkTransfer::list_bones() {
  const std::int32_t hips = to_.at(Role::hips);
  const auto turns = [&](std::int32_t j) {
    return j == hips || j == to_.at(Role::leftShoulder) || j == to_.at(Role::rightShoulder) ||
           std::ranges::count(to_.spine, j) != 0 || std::ranges::count(to_.neck, j) != 0;
  };
  const Vector3d hip_joints = to_t_pose_.position(to_.at(Role::leftUpperLeg)) +
                              to_t_pose_.position(to_.at(Role::rightUpperLeg));
  bones_.push_back({hips, to_t_pose_.position(hips) - 0.5 * hip_joints});
  for (const Role arm : {Role::leftUpperArm, Role::rightUpperArm}) {
    std::int32_t end = to_.at(arm);
    for (std::int32_t j = to_.parents[end]; j != kNoJoint; j = to_.parents[j]) {
      if (!turns(j)) continue;
      bones_.push_back({j, 0.5 * (to_t_pose_.position(end) - to_t_pose_.position(j))});
      if (j == hips) break;
      end = j;
    }
  }
}

void TrunkTransfer::frame(std::span<const DualQuaternion> model,
                          std::span<Quaterniond> since) const {
  const auto turn = [&](std::int32_t j) { return since_t_pose(from_t_pose_, j, model[j]); };
  std::vector<Quaterniond> spine{turn(from_.at(Role::hips))};
  for (const std::int32_t j : from_.spine) spine.push_back(turn(j));
  for (std::size_t k = 0; k < to_.spine.size(); ++k) {
    since[to_.spine[k]] = along_chain(spine, k + 1, to_.spine.size());
  }
  std::vector<Quaterniond> neck{spine.back()};
  for (const std::int32_t j : from_.neck) neck.push_back(turn(j));
  if (from_.has(Role::head)) neck.push_back(turn(from_.at(Role::head)));
  for (std::size_t k = 0; k < to_.neck.size(); ++k) {
    since[to_.neck[k]] = at_place(neck, source_neck_, target_neck_[k + 1]);
  }
  if (to_.has(Role::head)) since[to_.at(Role::head)] = neck.back();
  if (bones_.empty()) return;
  const Matrix3d axes = trunk_axes(from_, [&](std::int32_t j) { return model[j].translation(); });
  lean(axes * source_axes_.transpose() * target_axis_, since);
}

/// Copied rotations alone let a trunk of other segment lengths lean otherwise: the lower spine (the
/// whole of a spine with one joint) is bent until the shoulders lie in the wanted direction. Bones
/// above keep their rotations, so the bend is larger than the angle that is missing.
void TrunkTransfer::lean(const Vector3d& wanted, std::span<Quaterniond> since) const {
  const std::size_t lower = std::max<std::size_t>(1, to_.spine.size() - 1);
  const std::span<const std::int32_t> bent(to_.spine.data(), lower);
  for (int step = 0; step < kLeanSteps; ++step) {
    Vector3d way = Vector3d::Zero(), bent_way = Vector3d::Zero();
    for (const Bone& bone : bones_) {
      const Vector3d span = since[bone.joint] * bone.span;
      way += span;
      if (std::ranges::count(bent, bone.joint) != 0) bent_way += span;
    }
    const double share = bent_way.dot(way) / way.squaredNorm();
    const double gain = std::min(kMaxLeanGain, 1.0 / std::max(share, 1e-3));
    Eigen::AngleAxisd turn(Quaterniond::FromTwoVectors(way, wanted));
    turn.angle() *= gain;
    for (const std::int32_t j : bent) since[j] = (turn * since[j]).normalized();
  }
}

}  // namespace limber
