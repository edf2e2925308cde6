#include "pipeline/effectors.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>

#include "pipeline/foot_contacts.h"
#include "validation/contact_detection.h"

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

/// World rotation since the T-pose that each target joint is to have, one frame at a time.
class RotationTransfer {
 public:
  RotationTransfer(const SourceMotion& source, const Target& target, FingerMode fingers)
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

  /// `since[joint]` for every target joint that has a role or is part of the trunk.
  void frame(std::span<const DualQuaternion> model, std::span<Quaterniond> since) const {
    const Figure& from = *source_.figure;
    const Figure& to = target_.figure;
    const auto turn = [&](std::int32_t j) {
      return since_t_pose(*source_.calibration, j, model[j]);
    };
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

  /// The source joint whose local rotation an unmapped target joint copies, or kNoJoint.
  std::int32_t carried(std::int32_t target_joint) const { return carried_[target_joint]; }

 private:
  std::optional<Role> nearest_source_parent(Role role) const {
    for (auto p = parent_of(role); p; p = parent_of(*p)) {
      if (source_.figure->has(*p)) return p;
    }
    return std::nullopt;
  }

  /// A relaxed hand: each joint flexed a little against the one before, thumb left alone.
  Quaterniond absent_finger(Role role) const {
    if (fingers_ == FingerMode::rest || is_thumb(role)) return Quaterniond::Identity();
    const double flexion = name_of(role).ends_with("Intermediate") ? 0.5 : 0.3;
    const double sign = side_of(role) == Side::left ? -1.0 : 1.0;
    return Quaterniond(Eigen::AngleAxisd(sign * flexion, Vector3d::UnitZ()));
  }

  void trunk(std::span<const DualQuaternion> model, std::span<Quaterniond> since) const {
    const Figure& from = *source_.figure;
    const Figure& to = target_.figure;
    if (!from.is_body() || !to.is_body()) return;
    const auto turn = [&](std::int32_t j) {
      return since_t_pose(*source_.calibration, j, model[j]);
    };
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
  void settle_hand(std::span<const DualQuaternion> model, std::span<Quaterniond> since) const {
    const std::int32_t hand = target_.figure.root();
    const auto row = std::find(target_.joint_of_row.begin(), target_.joint_of_row.end(), hand);
    if (target_.rig.joints[row - target_.joint_of_row.begin()].type == JointType::free) return;
    const Side side = target_.figure.has(Role::rightHand) ? Side::right : Side::left;
    const std::int32_t forearm = source_.figure->at(on_side(Role::leftLowerArm, side));
    const Quaterniond against =
        forearm == kNoJoint
            ? Quaterniond::Identity()
            : since_t_pose(*source_.calibration, forearm, model[forearm]).conjugate();
    const Quaterniond& w = target_.world_from_t_pose;
    for (Quaterniond& q : since) q = w * against * q * w.conjugate();
  }

  /// Joints without a role that both skeletons have under one name (twist joints, props, jaws).
  void find_carried() {
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

  const SourceMotion& source_;
  const Target& target_;
  FingerMode fingers_;
  std::vector<std::optional<Role>> roles_;
  std::vector<std::int32_t> carried_;
  std::vector<double> source_neck_, target_neck_;
};

/// Places a source's points in the target's world: limbs scale with the leg (or the hand), the root
/// path as RootMode says, and the height at which the source's ankles stand becomes the height of
/// the target's ankles above their soles.
struct Placement {
  double scale = 1.0;
  double path_scale = 1.0;             // horizontal; 0 in place
  double stand_source = 0.0;           // y of the source's standing ankle
  double stand_target = 0.0;           // y of the target's
  Vector3d centre = Vector3d::Zero();  // this frame's hip centre, source

  Vector3d operator()(const Vector3d& p) const {
    const Vector3d out = path_scale * centre + scale * (p - centre);
    return {out.x(), scale * (p.y() - stand_source) + stand_target, out.z()};
  }
};

/// Height at which ankles stand: a low percentile over the clip of the lower ankle, so that a few
/// frames below the floor do not count.
double standing_height(const std::vector<double>& lower_ankle) {
  std::vector<double> sorted = lower_ankle;
  const auto k = static_cast<std::ptrdiff_t>(0.05 * double(sorted.size() - 1));
  std::nth_element(sorted.begin(), sorted.begin() + k, sorted.end());
  return sorted[k];
}

/// Builds effectors and their targets for one source and one target.
class Extraction {
 public:
  Extraction(const SourceMotion& source, const Target& target, const EffectorOptions& options)
      : source_(source),
        target_(target),
        options_(options),
        transfer_(source, target, options.fingers),
        row_of_(target.character.skeleton.parents.size(), kNoJoint) {
    for (std::size_t i = 0; i < target.joint_of_row.size(); ++i) {
      row_of_[target.joint_of_row[i]] = static_cast<std::int32_t>(i);
    }
  }

  EffectorTrack run() {
    choose_effectors();
    track_.frames = source_.clip->frames();
    measure_source();
    const std::size_t rows = target_.joint_of_row.size();
    track_.targets.resize(std::size_t(track_.frames) * track_.effectors.size());
    track_.guess.resize(std::size_t(track_.frames) * rows);
    plan_feet();
    std::vector<DualQuaternion> model(source_.character->skeleton.parents.size());
    std::vector<Quaterniond> since(row_of_.size());
    for (std::int64_t f = 0; f < track_.frames; ++f) {
      model_from_local(source_.character->skeleton, source_.clip->frame(f), model);
      transfer_.frame(model, since);
      make_guess(f, model, since);
      make_targets(f, model, since);
    }
    return std::move(track_);
  }

 private:
  enum class Aim : std::uint8_t { root, rotation, hand, foot, carried };
  struct Plan {
    Aim aim;
    std::int32_t joint;
    Side side = Side::middle;
  };

  bool body() const { return source_.figure->is_body() && target_.figure.is_body(); }

  void add(std::int32_t joint, EffectorKind kind, Aim aim, double weight_pos, double weight_rot,
           bool strong, Side side = Side::middle) {
    const std::int32_t row = row_of_[joint];
    RigEffector effector;
    effector.name = target_.character.skeleton.names[joint];
    effector.joint = row;
    effector.kind = kind;
    effector.weight_pos = weight_pos;
    effector.weight_rot = weight_rot;
    effector.strong = strong;
    if (kind == EffectorKind::direction) {
      effector.axis = target_.calibration.tip[joint].normalized();
      effector.name += ".direction";
    } else if (kind == EffectorKind::orientation) {
      effector.name += ".orientation";
    }
    track_.effectors.push_back(effector);
    plans_.push_back({aim, joint, side});
  }

  /// Weights are relative: the root and planted feet come first, then hands, then the shape of
  /// limbs and trunk. An orientation weight of one makes a radian cost as much as 0.1 m.
  void choose_effectors() {
    const Figure& to = target_.figure;
    const std::int32_t root = to.root();
    const bool moves = target_.rig.joints[row_of_[root]].type == JointType::free;
    add(root, moves ? EffectorKind::pose : EffectorKind::orientation, Aim::root, 0.5, 2.0, true);
    if (to.is_body()) {
      // The pelvis is held between the hip joints, wherever the file put its root.
      track_.effectors.back().offset =
          target_.calibration.model_from_joint[root].conjugate().transform_point(
              hip_centre(target_.calibration.model_from_joint, to));
      const double share = 0.5 / std::max<std::size_t>(1, to.spine.size());
      for (const std::int32_t j : to.spine) {
        const bool top = j == to.spine.back();
        add(j, EffectorKind::orientation, Aim::rotation, 0.0, top ? 2.0 : share, top);
      }
      for (const std::int32_t j : to.neck) {
        add(j, EffectorKind::orientation, Aim::rotation, 0.0, 0.3, false);
      }
      if (to.has(Role::head)) {
        add(to.at(Role::head), EffectorKind::orientation, Aim::rotation, 0.0, 1.0, true);
      }
    }
    for (const Side side : {Side::left, Side::right}) {
      if (to.is_body()) choose_limbs(side);
      choose_fingers(side);
    }
    // Nothing else holds a joint that follows its namesake: it would drift with its children's
    // wishes.
    for (const std::int32_t j : to.order) {
      if (transfer_.carried(j) == kNoJoint) continue;
      add(j, EffectorKind::orientation, Aim::carried, 0.0, 1.0, false);
    }
  }

  void choose_limbs(Side side) {
    const Figure& to = target_.figure;
    const auto on = [&](Role left) { return to.at(on_side(left, side)); };
    const auto bone = [&](std::int32_t j, double direction, double twist) {
      if (j == kNoJoint) return;
      if (target_.calibration.tip[j].norm() > 1e-6) {
        add(j, EffectorKind::direction, Aim::rotation, 0.0, direction, false);
      }
      add(j, EffectorKind::orientation, Aim::rotation, 0.0, twist, false);
    };
    if (on(Role::leftShoulder) != kNoJoint) {
      add(on(Role::leftShoulder), EffectorKind::orientation, Aim::rotation, 0.0, 0.5, false);
    }
    bone(on(Role::leftUpperArm), 2.0, 0.1);
    bone(on(Role::leftLowerArm), 2.0, 0.1);
    if (on(Role::leftHand) != kNoJoint) {
      add(on(Role::leftHand), EffectorKind::pose, Aim::hand, 0.5, 0.7, true, side);
    }
    bone(on(Role::leftUpperLeg), 1.5, 0.1);
    bone(on(Role::leftLowerLeg), 1.5, 0.1);
    if (on(Role::leftFoot) != kNoJoint) {
      add(on(Role::leftFoot), EffectorKind::pose, Aim::foot, 2.0, 2.0, true, side);
    }
    if (on(Role::leftToes) != kNoJoint) {
      add(on(Role::leftToes), EffectorKind::orientation, Aim::rotation, 0.0, 0.3, false);
    }
  }

  void choose_fingers(Side side) {
    for (int k = index_of(Role::leftThumbMetacarpal); k <= index_of(Role::leftLittleDistal); ++k) {
      const std::int32_t j = target_.figure.at(on_side(role_at(k), side));
      if (j == kNoJoint || target_.rig.joints[row_of_[j]].type == JointType::fixed) continue;
      add(j, EffectorKind::orientation, Aim::rotation, 0.0, 0.3, false);
    }
  }

  static Vector3d hip_centre(std::span<const DualQuaternion> model, const Figure& figure) {
    return 0.5 * (model[figure.at(Role::leftUpperLeg)].translation() +
                  model[figure.at(Role::rightUpperLeg)].translation());
  }

  /// Hip to ankle of the straight leg; the mean of both where a leg lacks a joint.
  static double leg_length(const Calibration& calibration, const Figure& figure, Side side) {
    const std::int32_t hip = figure.at(on_side(Role::leftUpperLeg, side));
    const std::int32_t ankle = figure.at(on_side(Role::leftFoot, side));
    if (hip == kNoJoint || ankle == kNoJoint) return calibration.leg_length;
    return (calibration.position(hip) - calibration.position(ankle)).norm();
  }

  void measure_source() {
    const Calibration& from = *source_.calibration;
    const Calibration& to = target_.calibration;
    if (!body()) {
      placement_.scale =
          from.hand_length > 0.0 && to.hand_length > 0.0 ? to.hand_length / from.hand_length : 1.0;
      placement_.path_scale = placement_.scale;
      track_.scale = placement_.scale;
      return;
    }
    placement_.scale = from.leg_length > 0.0 ? to.leg_length / from.leg_length : 1.0;
    placement_.path_scale = options_.root == RootMode::scale  ? placement_.scale
                            : options_.root == RootMode::keep ? 1.0
                                                              : 0.0;
    placement_.stand_target = to.ankle_height;
    std::vector<DualQuaternion> model(source_.character->skeleton.parents.size());
    std::vector<double> lower;
    for (std::int64_t f = 0; f < track_.frames; ++f) {
      model_from_local(source_.character->skeleton, source_.clip->frame(f), model);
      double y = std::numeric_limits<double>::infinity();
      for (const Side side : {Side::left, Side::right}) {
        const std::int32_t ankle = source_.figure->at(on_side(Role::leftFoot, side));
        if (ankle == kNoJoint) continue;
        const double longer = leg_length(from, *source_.figure, side) - from.leg_length;
        y = std::min(y, model[ankle].translation().y() + longer);
      }
      lower.push_back(std::isfinite(y) ? y
                                       : hip_centre(model, *source_.figure).y() - from.leg_length);
    }
    placement_.stand_source = standing_height(lower);
    if (is_own_skeleton()) placement_.stand_target = placement_.stand_source;
    track_.scale = placement_.scale;
    track_.ground_offset = placement_.stand_source - from.ankle_height;
  }

  /// The very same skeleton keeps its own ground: nothing is to change.
  bool is_own_skeleton() const {
    const Skeleton& a = source_.character->skeleton;
    const Skeleton& b = target_.character.skeleton;
    if (a.names != b.names || a.parents != b.parents) return false;
    for (std::int32_t j = 0; j < a.size(); ++j) {
      const DualQuaternion d =
          a.rest_parent_from_joint[j].conjugate() * b.rest_parent_from_joint[j];
      if (d.translation().norm() > 1e-6 || std::abs(d.real.w()) < 1.0 - 1e-9) return false;
    }
    return true;
  }

  /// Where each foot is to be, over the whole clip, before any frame is solved.
  void plan_feet() {
    if (!body()) return;
    FootPath left = make_foot_path(Side::left), right = make_foot_path(Side::right);
    if (left.ankle.empty() || right.ankle.empty()) return;
    if (options_.contacts) {
      const double ankles = floor_level(std::array{left.source_ankle, right.source_ankle});
      const double toes = floor_level(std::array{left.source_toe, right.source_toe});
      plant(left, ankles, toes);
      plant(right, ankles, toes);
    }
    left_foot_ = std::move(left.ankle);
    right_foot_ = std::move(right.ankle);
    track_.left_contact = std::move(left.contact);
    track_.right_contact = std::move(right.contact);
  }

  /// The source's foot over the clip, placed in the target's world; empty where either lacks it.
  FootPath make_foot_path(Side side) const {
    const Figure& from = *source_.figure;
    const Role foot = on_side(Role::leftFoot, side), toes = on_side(Role::leftToes, side);
    if (!from.has(foot) || !target_.figure.has(foot)) return {};
    FootPath path = make_foot(target_, side);
    path.rate_hz = source_.clip->rate_hz;
    path.speed_scale = from_height() / 1.75;
    // Reach in the leg's own measure, from where the target's hip joint is: a wide pelvis stands
    // with its feet as far apart as its legs hang, and legs of unequal length both reach the floor.
    const Role thigh = on_side(Role::leftUpperLeg, side);
    const Calibration& to = target_.calibration;
    const Vector3d hip_offset =
        to.position(target_.figure.at(thigh)) - hip_centre(to.model_from_joint, target_.figure);
    const double leg_scale = leg_length(to, target_.figure, side) /
                             std::max(1e-6, leg_length(*source_.calibration, from, side));
    std::vector<DualQuaternion> model(source_.character->skeleton.parents.size());
    std::vector<Quaterniond> since(row_of_.size());
    for (std::int64_t f = 0; f < track_.frames; ++f) {
      model_from_local(source_.character->skeleton, source_.clip->frame(f), model);
      transfer_.frame(model, since);
      Placement place = placement_;
      place.centre = hip_centre(model, *source_.figure);
      const Vector3d ankle = model[from.at(foot)].translation();
      path.source_ankle.push_back(ankle);
      path.source_toe.push_back(from.has(toes) ? model[from.at(toes)].translation() : ankle);
      const Vector3d hip = place(place.centre) + since[target_.figure.at(Role::hips)] * hip_offset;
      path.ankle.push_back(hip + leg_scale * (ankle - model[from.at(thigh)].translation()));
      path.foot_turn.push_back(since[target_.figure.at(foot)]);
      path.toes_turn.push_back(target_.figure.has(toes) ? since[target_.figure.at(toes)]
                                                        : path.foot_turn.back());
    }
    return path;
  }

  double from_height() const { return std::max(0.3, source_.calibration->height); }

  void make_guess(std::int64_t f, std::span<const DualQuaternion> model,
                  std::span<const Quaterniond> since) {
    const std::size_t rows = target_.joint_of_row.size();
    std::span<DualQuaternion> guess(track_.guess.data() + f * std::int64_t(rows), rows);
    std::vector<Quaterniond> world(rows);
    const std::int32_t root_row = row_of_[target_.figure.root()];
    for (std::size_t i = 0; i < rows; ++i) {
      const RigJoint& row = target_.rig.joints[i];
      const std::int32_t j = target_.joint_of_row[i];
      const Quaterniond parent =
          row.parent == kNoJoint ? Quaterniond::Identity() : world[row.parent];
      Quaterniond local = row.rest;
      if (const std::int32_t twin = transfer_.carried(j); twin != kNoJoint) {
        local = carried_local(f, twin, j);
      } else if (row.type != JointType::fixed) {
        local = (parent.conjugate() * since[j] * target_.calibration.model_from_joint[j].rotation())
                    .normalized();
      }
      world[i] = parent * local;
      guess[i] = DualQuaternion::from_rotation_translation(local, row.offset);
    }
    place_root(guess, root_row, model, since);
  }

  /// An unmapped joint turns against its own T-pose as its namesake does.
  Quaterniond carried_local(std::int64_t f, std::int32_t twin, std::int32_t j) const {
    const Skeleton& skeleton = source_.character->skeleton;
    const Calibration& from = *source_.calibration;
    const std::int32_t parent = skeleton.parents[twin];
    const Quaterniond t_pose = from.model_from_joint[parent].rotation().conjugate() *
                               from.model_from_joint[twin].rotation();
    const Quaterniond turn = t_pose.conjugate() * source_.clip->frame(f)[twin].rotation();
    return (target_.rig.joints[row_of_[j]].rest * turn).normalized();
  }

  void place_root(std::span<DualQuaternion> guess, std::int32_t root_row,
                  std::span<const DualQuaternion> model, std::span<const Quaterniond> since) {
    const RigJoint& row = target_.rig.joints[root_row];
    if (row.type != JointType::free) return;
    Vector3d p_world;
    if (body()) {
      placement_.centre = hip_centre(model, *source_.figure);
      const Calibration& to = target_.calibration;
      const Vector3d centre_t = hip_centre(to.model_from_joint, target_.figure);
      const std::int32_t hips = target_.figure.at(Role::hips);
      p_world = placement_(placement_.centre) - since[hips] * (centre_t - to.position(hips));
    } else {
      p_world = placement_.scale * model[source_.figure->root()].translation();
    }
    DualQuaternion world = DualQuaternion::identity();
    for (std::int32_t i = row.parent; i != kNoJoint; i = target_.rig.joints[i].parent) {
      world = guess[i] * world;
    }
    guess[root_row] = DualQuaternion::from_rotation_translation(
        guess[root_row].rotation(), world.conjugate().transform_point(p_world));
  }

  void make_targets(std::int64_t f, std::span<const DualQuaternion> model,
                    std::span<const Quaterniond> since) {
    const std::size_t rows = target_.joint_of_row.size();
    std::vector<DualQuaternion> world(rows);
    for (std::size_t i = 0; i < rows; ++i) {
      const DualQuaternion& local = track_.guess[std::size_t(f) * rows + i];
      const std::int32_t parent = target_.rig.joints[i].parent;
      world[i] = parent == kNoJoint ? local : world[parent] * local;
    }
    for (std::size_t e = 0; e < plans_.size(); ++e) {
      const Plan& plan = plans_[e];
      EffectorTarget& target = track_.targets[std::size_t(f) * plans_.size() + e];
      const DualQuaternion& guessed = world[row_of_[plan.joint]];
      const Quaterniond rotation =
          plan.aim == Aim::carried
              ? guessed.rotation()
              : since[plan.joint] * target_.calibration.model_from_joint[plan.joint].rotation();
      Vector3d p = guessed.transform_point(track_.effectors[e].offset);
      if (plan.aim == Aim::hand && body()) p = hand_position(plan.side, model, world);
      if (plan.aim == Aim::foot && body()) {
        const auto& foot = plan.side == Side::left ? left_foot_ : right_foot_;
        if (!foot.empty()) p = foot[f];
      }
      target.pose = DualQuaternion::from_rotation_translation(rotation.normalized(), p);
      target.weight = 1.0;
    }
  }

  /// Reach in the limb's own measure: shoulder to wrist, scaled by this arm's length.
  Vector3d hand_position(Side side, std::span<const DualQuaternion> model,
                         std::span<const DualQuaternion> world) const {
    const Figure& from = *source_.figure;
    const Role hand = on_side(Role::leftHand, side), arm = on_side(Role::leftUpperArm, side);
    const Vector3d reached = world[row_of_[target_.figure.at(hand)]].translation();
    if (!from.has(hand) || !from.has(arm) || !target_.figure.has(arm)) return reached;
    const auto reach = [&](const Calibration& c, const Figure& figure) {
      return (c.position(figure.at(hand)) - c.position(figure.at(arm))).norm();
    };
    const double ratio = reach(target_.calibration, target_.figure) /
                         std::max(1e-6, reach(*source_.calibration, from));
    return world[row_of_[target_.figure.at(arm)]].translation() +
           ratio * (model[from.at(hand)].translation() - model[from.at(arm)].translation());
  }

  const SourceMotion& source_;
  const Target& target_;
  const EffectorOptions& options_;
  RotationTransfer transfer_;
  std::vector<std::int32_t> row_of_;
  std::vector<Plan> plans_;
  Placement placement_;
  std::vector<Vector3d> left_foot_, right_foot_;
  EffectorTrack track_;
};

}  // namespace

Result<EffectorTrack> extract_effectors(const SourceMotion& source, const Target& target,
                                        const EffectorOptions& options) {
  const Figure& from = *source.figure;
  const Figure& to = target.figure;
  const auto differ = [](std::string message, std::string hint) {
    return Error{
        .code = "map-figures-differ", .message = std::move(message), .hint = std::move(hint)};
  };
  if (to.is_body() && !from.is_body()) {
    return differ("the source is a hand alone, the target a whole body",
                  "retarget onto a hand, or name the body's joints in a map file");
  }
  if (to.is_hand()) {
    const Side side = to.has(Role::rightHand) ? Side::right : Side::left;
    if (!from.has(on_side(Role::leftHand, side)) || !from.has_fingers(side)) {
      return differ("the source has no fingers on the target's side",
                    "choose a hand of the other side, or a clip with fingers");
    }
  }
  return Extraction(source, target, options).run();
}

}  // namespace limber
