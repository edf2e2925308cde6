#include "pipeline/effectors.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>

#include "pipeline/finger_shape.h"
#include "pipeline/foot_contacts.h"
#include "pipeline/rotation_transfer.h"
#include "validation/contact_detection.h"

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kAsBonesPoint = 0.6;  // of a foot's place; the rest is the leg's reach
constexpr double kSwings = 0.1;        // weight of a foot in the air, where its leg's shape is seen

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

  Result<EffectorTrack> run() {
    choose_effectors();
    track_.frames = source_.clip->frames();
    measure_source();
    const std::size_t rows = target_.joint_of_row.size();
    track_.targets.resize(std::size_t(track_.frames) * track_.effectors.size());
    track_.guess.resize(std::size_t(track_.frames) * rows);
    std::vector<DualQuaternion> model(source_.character->skeleton.parents.size());
    std::vector<Quaterniond> since(row_of_.size());
    begin_feet();
    for (std::int64_t f = 0; f < track_.frames; ++f) {
      model_from_local(source_.character->skeleton, source_.clip->frame(f), model);
      transfer_.frame(model, since);
      make_guess(f, model, since);
      place_feet(f, model, since);
    }
    plant_feet();
    track_.unbent = track_.guess;
    if (auto r = shape_fingers(source_, target_, track_); !r) return r.error();
    for (std::int64_t f = 0; f < track_.frames; ++f) {
      model_from_local(source_.character->skeleton, source_.clip->frame(f), model);
      transfer_.frame(model, since);
      make_targets(f, model, since);
    }
    return std::move(track_);
  }

 private:
  enum class Aim : std::uint8_t { root, rotation, hand, foot, toes, guessed };
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

  /// Weights are relative: planted feet and the pelvis come first, then the shape of
  /// limbs and trunk, then where the hands and the feet in the air are: limbs of other proportions
  /// cannot have both, and a bone that points elsewhere shows more than a hand that is a little
  /// off. An orientation weight of one makes a radian cost as much as 0.1 m.
  void choose_effectors() {
    const Figure& to = target_.figure;
    const std::int32_t root = to.is_body() ? to.at(Role::hips) : to.root();
    const bool moves = target_.rig.joints[row_of_[to.root()]].type == JointType::free;
    add(root, moves ? EffectorKind::pose : EffectorKind::orientation,
        moves ? Aim::root : Aim::guessed, 3.0, 10.0, true);
    if (to.is_body()) {
      // The pelvis is held between the hip joints, wherever the file put its root.
      track_.effectors.back().offset =
          target_.calibration.model_from_joint[root].conjugate().transform_point(
              hip_centre(target_.calibration.model_from_joint, to));
      // Held by little, lower joints would let the hands pull the trunk over.
      const double share = 8.0 / double(std::max<std::size_t>(1, to.spine.size()));
      for (const std::int32_t j : to.spine) {
        const bool top = j == to.spine.back();
        add(j, EffectorKind::orientation, Aim::rotation, 0.0, top ? 6.0 : share, top);
      }
      for (const std::int32_t j : to.neck) {
        add(j, EffectorKind::orientation, Aim::rotation, 0.0, 0.3, false);
      }
      if (to.has(Role::head)) {
        add(to.at(Role::head), EffectorKind::orientation, Aim::rotation, 0.0, 1.0, true);
      }
    }
    for (const Side side : {Side::left, Side::right}) {
      if (to.is_body()) {
        choose_limbs(side);
      } else {
        choose_fingers(side);
      }
    }
    // Nothing else holds a joint that follows its namesake: it would drift with its children's
    // wishes.
    for (const std::int32_t j : to.order) {
      if (transfer_.carried(j) == kNoJoint || hangs_on_finger(j)) continue;
      add(j, EffectorKind::orientation, Aim::guessed, 0.0, 1.0, false);
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
      add(on(Role::leftShoulder), EffectorKind::orientation, Aim::rotation, 0.0, 1.5, false);
    }
    bone(on(Role::leftUpperArm), 4.0, 0.1);
    bone(on(Role::leftLowerArm), 4.0, 0.1);
    if (on(Role::leftHand) != kNoJoint) {
      add(on(Role::leftHand), EffectorKind::pose, Aim::hand, 0.9, 0.7, true, side);
    }
    bone(on(Role::leftUpperLeg), 5.5, 0.1);
    bone(on(Role::leftLowerLeg), 5.5, 0.1);
    if (on(Role::leftFoot) != kNoJoint) {
      add(on(Role::leftFoot), EffectorKind::pose, Aim::foot, 5.0, 3.0, true, side);
    }
    if (on(Role::leftToes) != kNoJoint) {
      add(on(Role::leftToes), EffectorKind::orientation, Aim::toes, 0.0, 0.3, false, side);
    }
  }

  bool hangs_on_finger(std::int32_t joint) const {
    for (std::int32_t j = joint; j != kNoJoint; j = target_.figure.parents[j]) {
      for (int r = kFirstLeft; r < kRoleCount; ++r) {
        if (is_finger(role_at(r)) && target_.figure.at(role_at(r)) == j) return true;
      }
    }
    return false;
  }

  /// A hand alone. A body's fingers have no effectors: they keep the shape that the guess gives
  /// them in the palm, wherever the arm brings it, and never pull at the arm.
  void choose_fingers(Side side) {
    for (int k = index_of(Role::leftThumbMetacarpal); k <= index_of(Role::leftLittleDistal); ++k) {
      const std::int32_t j = target_.figure.at(on_side(role_at(k), side));
      if (j == kNoJoint || target_.rig.joints[row_of_[j]].type == JointType::fixed) continue;
      add(j, EffectorKind::orientation, Aim::guessed, 0.0, 0.3, false);
    }
  }

  std::span<DualQuaternion> guess(std::int64_t f) {
    const std::size_t rows = target_.joint_of_row.size();
    return {track_.guess.data() + std::size_t(f) * rows, rows};
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
    placement_.scale = size_ratio(*source_.figure, from, target_.figure, target_.calibration);
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
                                       : hip_centre(model, *source_.figure).y() -
                                             to.leg_length / placement_.scale);
    }
    placement_.stand_source = standing_height(lower);
    if (is_own_skeleton()) placement_.stand_target = placement_.stand_source;
    track_.scale = placement_.scale;
    track_.ground_offset = placement_.stand_source - from.ankle_height;
    track_.floor_y = placement_.stand_target - to.ankle_height;
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

  bool has_feet() const { return !left_foot_.ankle.empty(); }

  /// Both figures are bodies with both feet.
  bool plans_feet() const {
    const auto has_both = [](const Figure& figure) {
      return figure.has(Role::leftFoot) && figure.has(Role::rightFoot);
    };
    return body() && has_both(*source_.figure) && has_both(target_.figure);
  }

  void begin_feet() {
    if (!plans_feet()) return;
    for (const Side side : {Side::left, Side::right}) {
      FootPath& path = side == Side::left ? left_foot_ : right_foot_;
      path = make_foot(target_, side);
      path.rate_hz = source_.clip->rate_hz;
      path.speed_scale = from_height() / 1.75;
      path.floor_y = track_.floor_y;
    }
  }

  void place_feet(std::int64_t f, std::span<const DualQuaternion> model,
                  std::span<const Quaterniond> since) {
    if (!plans_feet()) return;
    std::vector<DualQuaternion> guessed(target_.joint_of_row.size());
    model_from_rows(target_.rig, guess(f), guessed);
    place_foot(Side::left, model, since, guessed, left_foot_);
    place_foot(Side::right, model, since, guessed, right_foot_);
  }

  /// The source's foot, placed in the target's world. Reach in the leg's own measure, from where
  /// the target's hip joint is: a wide pelvis stands with its feet as far apart as its legs hang,
  /// and legs of unequal length both reach the floor. Where thigh and shank share a leg otherwise
  /// than the source's, bones that point as the source's bring the foot elsewhere: it goes between
  /// the two.
  void place_foot(Side side, std::span<const DualQuaternion> model,
                  std::span<const Quaterniond> since, std::span<const DualQuaternion> guessed,
                  FootPath& path) const {
    const Figure& from = *source_.figure;
    const Figure& figure = target_.figure;
    const Calibration& to = target_.calibration;
    const Role foot = on_side(Role::leftFoot, side), toes = on_side(Role::leftToes, side);
    const Role thigh = on_side(Role::leftUpperLeg, side);
    const Vector3d hip_offset =
        to.position(figure.at(thigh)) - hip_centre(to.model_from_joint, figure);
    const double leg_scale =
        leg_length(to, figure, side) / std::max(1e-6, leg_length(*source_.calibration, from, side));
    Placement place = placement_;
    place.centre = hip_centre(model, from);
    const Vector3d ankle = model[from.at(foot)].translation();
    path.source_ankle.push_back(ankle);
    path.source_toe.push_back(from.has(toes) ? model[from.at(toes)].translation() : ankle);
    const Vector3d hip = place(place.centre) + since[figure.at(Role::hips)] * hip_offset;
    const Vector3d reached = hip + leg_scale * (ankle - model[from.at(thigh)].translation());
    const Vector3d pointed = guessed[row_of_[figure.at(foot)]].translation();
    path.ankle.push_back(reached + kAsBonesPoint * (pointed - reached));
    path.foot_turn.push_back(since[figure.at(foot)]);
    path.toes_turn.push_back(figure.has(toes) ? since[figure.at(toes)] : path.foot_turn.back());
  }

  /// Pins the feet, over the whole clip, before any frame is solved.
  void plant_feet() {
    if (!has_feet()) return;
    if (options_.contacts) {
      const double ankles =
          floor_level(std::array{left_foot_.source_ankle, right_foot_.source_ankle});
      const double toes = floor_level(std::array{left_foot_.source_toe, right_foot_.source_toe});
      plant(left_foot_, ankles, toes);
      plant(right_foot_, ankles, toes);
    }
    track_.left_contact = left_foot_.contact;
    track_.right_contact = right_foot_.contact;
  }

  double from_height() const { return std::max(0.3, source_.calibration->height); }

  void make_guess(std::int64_t f, std::span<const DualQuaternion> model,
                  std::span<const Quaterniond> since) {
    const std::size_t rows = target_.joint_of_row.size();
    const std::span<DualQuaternion> guess = this->guess(f);
    std::vector<Quaterniond> world(rows);
    for (std::size_t i = 0; i < rows; ++i) {
      const RigJoint& row = target_.rig.joints[i];
      const std::int32_t j = target_.joint_of_row[i];
      const Quaterniond parent =
          row.parent == kNoJoint ? Quaterniond::Identity() : world[row.parent];
      Quaterniond local = row.rest;
      const std::int32_t twin = transfer_.carried(j);
      const bool pelvis = std::ranges::count(target_.figure.pelvis, j) != 0;
      if (twin != kNoJoint && !pelvis) {
        local = carried_local(f, twin, j);
      } else if (twin != kNoJoint || row.type != JointType::fixed) {
        local = (parent.conjugate() * since[j] * target_.calibration.model_from_joint[j].rotation())
                    .normalized();
      }
      world[i] = parent * local;
      guess[i] = DualQuaternion::from_rotation_translation(local, row.offset);
    }
    place_root(guess, model, since);
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

  /// Moves the root so that the pelvis (or the hand) comes to where it is to be.
  void place_root(std::span<DualQuaternion> guess, std::span<const DualQuaternion> model,
                  std::span<const Quaterniond> since) {
    const Figure& figure = target_.figure;
    const std::int32_t root_row = row_of_[figure.root()];
    const RigJoint& row = target_.rig.joints[root_row];
    if (row.type != JointType::free) return;
    std::int32_t placed = figure.root();
    Vector3d p_world;
    if (body()) {
      placement_.centre = hip_centre(model, *source_.figure);
      const Calibration& to = target_.calibration;
      const Vector3d centre_t = hip_centre(to.model_from_joint, figure);
      placed = figure.at(Role::hips);
      p_world = placement_(placement_.centre) - since[placed] * (centre_t - to.position(placed));
    } else {
      const Role hand = on_side(Role::leftHand, figure.hand_side());
      p_world = placement_.scale * model[source_.figure->at(hand)].translation();
    }
    const auto world_of = [&](std::int32_t i) {
      DualQuaternion world = DualQuaternion::identity();
      for (; i != kNoJoint; i = target_.rig.joints[i].parent) world = guess[i] * world;
      return world;
    };
    const Vector3d step = p_world - world_of(row_of_[placed]).translation();
    const Quaterniond parent_from_world = world_of(row.parent).rotation().conjugate();
    guess[root_row] = DualQuaternion::from_rotation_translation(
        guess[root_row].rotation(), guess[root_row].translation() + parent_from_world * step);
  }

  void make_targets(std::int64_t f, std::span<const DualQuaternion> model,
                    std::span<const Quaterniond> since) {
    const std::size_t rows = target_.joint_of_row.size();
    std::vector<DualQuaternion> world(rows);
    model_from_rows(target_.rig, guess(f), world);
    for (std::size_t e = 0; e < plans_.size(); ++e) {
      const Plan& plan = plans_[e];
      EffectorTarget& target = track_.targets[std::size_t(f) * plans_.size() + e];
      const DualQuaternion& guessed = world[row_of_[plan.joint]];
      const FootPath& foot = plan.side == Side::left ? left_foot_ : right_foot_;
      Quaterniond turn = since[plan.joint];
      Vector3d p = guessed.transform_point(track_.effectors[e].offset);
      target.weight = 1.0;
      if (plan.aim == Aim::hand && body()) p = hand_position(plan.side, model, world);
      if (plan.aim == Aim::toes && has_feet()) turn = foot.toes_turn[f];
      if (plan.aim == Aim::foot && has_feet()) {
        turn = foot.foot_turn[f];
        p = foot.ankle[f];
        if (!foot.hold.empty()) target.weight = kSwings + (1.0 - kSwings) * foot.hold[f];
      }
      const Quaterniond rotation =
          plan.aim == Aim::guessed
              ? guessed.rotation()
              : turn * target_.calibration.model_from_joint[plan.joint].rotation();
      target.pose = DualQuaternion::from_rotation_translation(rotation.normalized(), p);
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
  FootPath left_foot_, right_foot_;
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
    const Side side = to.hand_side();
    if (!from.has(on_side(Role::leftHand, side)) || !from.has_fingers(side)) {
      return differ("the source has no fingers on the target's side",
                    "choose a hand of the other side, or a clip with fingers");
    }
  }
  return Extraction(source, target, options).run();
}

}  // namespace limber
