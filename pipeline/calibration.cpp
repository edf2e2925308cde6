#include "pipeline/calibration.h"

#include <algorithm>
#include <cmath>

#include "pipeline/foot_reference.h"
#include "pipeline/reference_pose.h"

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kSplayedDeg = 5.0;         // legs of a reference stand apart from here on
constexpr double kClearlyFlatterDeg = 3.0;  // a reading of the soles wins by at least this

Quaterniond smallest_rotation(const Vector3d& from, const Vector3d& to) {
  return from.norm() < 1e-9 ? Quaterniond::Identity() : Quaterniond::FromTwoVectors(from, to);
}

/// Where the bone of a joint with a role ends: the next role's joint, else any child, else a guess.
class Bones {
 public:
  Bones(const Figure& figure, const std::vector<DualQuaternion>& model)
      : figure_(figure), model_(model), children_(model.size()) {
    for (const std::int32_t j : figure.order) {
      if (figure.parents[j] != kNoJoint) children_[figure.parents[j]].push_back(j);
    }
  }

  /// World vector along the bone in the reference pose; zero where nothing tells.
  Vector3d along(Role role) const {
    const std::int32_t j = figure_.at(role);
    if (const auto next = next_role(role)) return p(figure_.at(*next)) - p(j);
    if (is_hand(role)) return p_mean_knuckles(role) - p(j);
    return longest_child(j);
  }

  Vector3d longest_child(std::int32_t j) const {
    Vector3d best = Vector3d::Zero();
    for (const std::int32_t c : children_[j]) {
      const Vector3d v = p(c) - p(j);
      if (v.norm() > best.norm()) best = v;
    }
    return best;
  }

  Vector3d p(std::int32_t j) const { return model_[j].translation(); }

 private:
  static bool is_hand(Role role) { return role == Role::leftHand || role == Role::rightHand; }

  std::optional<Role> next_role(Role role) const {
    const std::string_view name = name_of(role);
    if (is_hand(role) || role == Role::head || name.ends_with("Distal") || name.ends_with("Toes")) {
      return std::nullopt;
    }
    if (is_finger(role) || side_of(role) != Side::middle) {
      const Role next = role_at(index_of(role) + 1);
      if (figure_.has(next) && parent_of(next) == role) return next;
    }
    return std::nullopt;
  }

  Vector3d p_mean_knuckles(Role hand) const {
    Vector3d sum = Vector3d::Zero();
    int n = 0;
    for (const Role knuckle : kLeftKnuckles) {
      const std::int32_t j = figure_.at(on_side(knuckle, side_of(hand)));
      if (j != kNoJoint) sum += p(j), ++n;
    }
    if (n > 0) return sum / n;
    return p(figure_.at(hand)) + longest_child(figure_.at(hand));
  }

  const Figure& figure_;
  const std::vector<DualQuaternion>& model_;
  std::vector<std::vector<std::int32_t>> children_;
};

/// The rotation that takes a reference palm to a T-pose palm: wrist to middle knuckle along +-X,
/// the index finger's side forward.
std::optional<Quaterniond> palm_correction(const Figure& figure, const Bones& bones, Side side) {
  if (!figure.has_fingers(side)) return std::nullopt;
  const auto at = [&](Role left) { return figure.at(on_side(left, side)); };
  const std::int32_t last = at(Role::leftLittleProximal) != kNoJoint ? at(Role::leftLittleProximal)
                                                                     : at(Role::leftRingProximal);
  const Vector3d distal =
      (bones.p(at(Role::leftMiddleProximal)) - bones.p(at(Role::leftHand))).normalized();
  Vector3d radial = bones.p(at(Role::leftIndexProximal)) - bones.p(last);
  radial -= radial.dot(distal) * distal;
  if (radial.norm() < 1e-6) return std::nullopt;
  radial.normalize();
  Eigen::Matrix3d reference, t_pose;
  reference << distal, radial, distal.cross(radial);
  const Vector3d x = side == Side::left ? Vector3d::UnitX() : Vector3d(-Vector3d::UnitX());
  t_pose << x, Vector3d::UnitZ(), x.cross(Vector3d::UnitZ());
  return Quaterniond(Eigen::Matrix3d(t_pose * reference.transpose())).normalized();
}

/// World rotation from the reference to the T-pose, per joint.
class Corrections {
 public:
  Corrections(const Figure& figure, const Bones& bones, const Quaterniond& front)
      : figure_(figure), bones_(bones), front_(front) {}

  Quaterniond of(std::optional<Role> role, const Quaterniond& inherited) {
    if (!role) return inherited;
    if (side_of(*role) == Side::middle || *role == Role::leftEye || *role == Role::rightEye) {
      return front_;
    }
    const Side side = side_of(*role);
    const Role left = side == Side::right ? mirrored(*role) : *role;
    const Vector3d out = side == Side::left ? Vector3d::UnitX() : Vector3d(-Vector3d::UnitX());
    switch (left) {
      case Role::leftShoulder:
        return inherited;
      case Role::leftUpperLeg:
      case Role::leftLowerLeg:
        return turned(*role, inherited, -Vector3d::UnitY());
      case Role::leftFoot:
        return square_feet_ ? toes_forward(*role, inherited) : flat_foot(*role);
      case Role::leftToes:
        return inherited;
      case Role::leftHand:
        if (const auto palm = palm_correction(figure_, bones_, side)) return *palm;
        return turned(*role, inherited, out);
      default:
        break;
    }
    if (is_thumb(*role)) return thumb(*role, inherited, out);
    return turned(*role, inherited, out);
  }

  /// Soles may be flat in the reference, or square to legs that stand apart in it (CMU). The
  /// reading under which they lie flatter where the clip stands is right.
  void read_feet(const Character& character, const std::vector<DualQuaternion>& reference,
                 const Clip& clip) {
    double flat_deg = 0.0, square_deg = 0.0, splay_deg = 0.0;
    for (const Side side : {Side::left, Side::right}) {
      const Role foot = on_side(Role::leftFoot, side);
      if (!figure_.has(foot) || !figure_.has(on_side(Role::leftLowerLeg, side))) return;
      const Quaterniond thigh = of(on_side(Role::leftUpperLeg, side), front_);
      const Quaterniond shin = of(on_side(Role::leftLowerLeg, side), thigh);
      splay_deg = std::max(splay_deg, front_.angularDistance(shin) * 180.0 / M_PI);
      const auto tilt = [&](const Quaterniond& correction) {
        return stance_tilt_deg(character.skeleton, clip, figure_.at(foot),
                               correction * reference[figure_.at(foot)].rotation());
      };
      flat_deg += 0.5 * tilt(flat_foot(foot));
      square_deg += 0.5 * tilt(toes_forward(foot, shin));
    }
    sum_deg_ = 0.0, turns_ = 0;
    square_feet_ = splay_deg > kSplayedDeg && square_deg + kClearlyFlatterDeg < flat_deg;
  }

  double mean_turn_deg() const { return turns_ == 0 ? 0.0 : sum_deg_ / turns_; }

 private:
  Quaterniond turned(Role role, const Quaterniond& inherited, const Vector3d& direction) {
    const Vector3d now = inherited * bones_.along(role);
    if (now.norm() < 1e-6) return inherited;
    sum_deg_ += degrees_between(now, direction);
    ++turns_;
    return smallest_rotation(now, direction) * inherited;
  }

  /// Thumbs rest in as many ways as there are files, so theirs is an axis of their own: straight,
  /// in the plane of the palm, between the fingers and forward. Seen from a palm that is known, the
  /// same turn then points every thumb the same way. It is no measure of the reference.
  Quaterniond thumb(Role role, const Quaterniond& inherited, const Vector3d& out) const {
    const Vector3d now = inherited * bones_.along(role);
    if (now.norm() < 1e-6 || !figure_.has_fingers(side_of(role))) return inherited;
    return smallest_rotation(now, (out + Vector3d::UnitZ()).normalized()) * inherited;
  }

  /// Feet keep their pitch (the reference stands on flat soles) and point forward.
  Quaterniond flat_foot(Role foot) const { return toes_forward(foot, front_); }

  /// The foot turned as `correction` turns it, and about +Y so that it points forward.
  Quaterniond toes_forward(Role foot, const Quaterniond& correction) const {
    Vector3d toes = correction * bones_.along(foot);
    toes.y() = 0.0;
    if (toes.norm() < 1e-3 || toes.normalized().z() < 0.2) return correction;
    return yaw_to_front(toes) * correction;
  }

  const Figure& figure_;
  const Bones& bones_;
  Quaterniond front_;
  bool square_feet_ = false;
  double sum_deg_ = 0.0;
  int turns_ = 0;
};

/// Lowest point of the feet in the T-pose: the mesh where there is one, else the lowest joint.
double sole_height(const Character& character, const Figure& figure,
                   const std::vector<DualQuaternion>& model) {
  std::vector<std::uint8_t> in_foot(model.size(), 0);
  double lowest = 1e9;
  const auto roles = roles_by_joint(figure, character.skeleton.size());
  for (const std::int32_t j : figure.order) {
    const bool foot = roles[j] && (*roles[j] == Role::leftFoot || *roles[j] == Role::rightFoot);
    const bool under = figure.parents[j] != kNoJoint && in_foot[figure.parents[j]] != 0;
    in_foot[j] = foot || under;
    if (in_foot[j]) lowest = std::min(lowest, model[j].translation().y());
  }
  bool from_mesh = false;
  double sole = 1e9;
  for (const Mesh& mesh : character.meshes) {
    std::vector<Eigen::Vector3f> posed(mesh.positions.size());
    skin_positions(mesh, model, posed);
    for (std::size_t v = 0; v < posed.size(); ++v) {
      float weight = 0.0F;
      for (std::uint32_t i = mesh.influence_begin[v]; i < mesh.influence_begin[v + 1]; ++i) {
        const Influence& influence = mesh.influences[i];
        if (in_foot[mesh.skin[influence.skin_joint].joint]) weight += influence.weight;
      }
      if (weight > 0.5F) sole = std::min(sole, double(posed[v].y())), from_mesh = true;
    }
  }
  return from_mesh ? sole : lowest;
}

void measure(const Character& character, const Figure& figure, Calibration& calibration) {
  const auto distance = [&](Role a, Role b) {
    return figure.has(a) && figure.has(b)
               ? (calibration.position(figure.at(a)) - calibration.position(figure.at(b))).norm()
               : 0.0;
  };
  int legs = 0;
  for (const Side side : {Side::left, Side::right}) {
    const auto on = [&](Role role) { return on_side(role, side); };
    if (figure.has(on(Role::leftLowerLeg)) && figure.has(on(Role::leftFoot))) {
      calibration.leg_length += distance(on(Role::leftUpperLeg), on(Role::leftLowerLeg)) +
                                distance(on(Role::leftLowerLeg), on(Role::leftFoot));
      ++legs;
    }
    const double hand = distance(on(Role::leftHand), on(Role::leftMiddleProximal));
    calibration.hand_length = std::max(calibration.hand_length, hand);
  }
  calibration.leg_length /= std::max(1, legs);
  double top = -1e9;
  for (const DualQuaternion& q : calibration.model_from_joint) {
    top = std::max(top, q.translation().y());
  }
  if (figure.has(Role::leftFoot) && figure.has(Role::rightFoot)) {
    calibration.sole = sole_height(character, figure, calibration.model_from_joint);
    const double ankles = 0.5 * (calibration.position(figure.at(Role::leftFoot)).y() +
                                 calibration.position(figure.at(Role::rightFoot)).y());
    calibration.ankle_height = ankles - calibration.sole;
  }
  calibration.height = top - calibration.sole;
}

}  // namespace

double size_ratio(const Figure& source_figure, const Calibration& source,
                  const Figure& target_figure, const Calibration& target) {
  double source_sum = 0.0, target_sum = 0.0;
  for (const Side side : {Side::left, Side::right}) {
    for (const Role left : {Role::leftUpperLeg, Role::leftLowerLeg}) {
      const Role a = on_side(left, side), b = role_at(index_of(a) + 1);
      if (!source_figure.has(a) || !source_figure.has(b) || !target_figure.has(a) ||
          !target_figure.has(b)) {
        continue;
      }
      source_sum +=
          (source.position(source_figure.at(a)) - source.position(source_figure.at(b))).norm();
      target_sum +=
          (target.position(target_figure.at(a)) - target.position(target_figure.at(b))).norm();
    }
  }
  if (source_sum > 0.0 && target_sum > 0.0) return target_sum / source_sum;
  return source.height > 0.0 && target.height > 0.0 ? target.height / source.height : 1.0;
}

Result<Calibration> calibrate(const Character& character, const Figure& figure,
                              const ReferenceChoice& choice,
                              std::span<const DualQuaternion> reference_pose, const Clip* clip) {
  auto chosen = choose_reference(character, figure, choice, reference_pose, clip);
  if (!chosen) return chosen.error();

  const Bones bones(figure, chosen->model);
  Quaterniond front = Quaterniond::Identity();
  if (figure.is_body()) front = yaw_to_front(ReferenceView(figure, chosen->model).forward());
  // Hip line and shoulder line are level and square in the T-pose, whatever way the file's own
  // pelvis and chest lean or turn: figures whose lines agree face the same way.
  const auto levelled = [&](Role right, Role left) {
    if (!figure.is_body() || !figure.has(right) || !figure.has(left)) return front;
    const Vector3d line = ReferenceView(figure, chosen->model).bone(right, left);
    return Quaterniond(smallest_rotation(front * line, Vector3d::UnitX()) * front);
  };
  const Quaterniond level_hips = levelled(Role::rightUpperLeg, Role::leftUpperLeg);
  const Quaterniond level_chest = levelled(Role::rightUpperArm, Role::leftUpperArm);
  Corrections corrections(figure, bones, front);
  if (figure.is_body() && clip != nullptr && chosen->name != "motion") {
    corrections.read_feet(character, chosen->model, *clip);
  }
  const auto roles = roles_by_joint(figure, character.skeleton.size());
  const std::size_t n = figure.order.size();
  std::vector<Quaterniond> correction(n, front);
  Calibration out;
  out.reference = chosen->name;
  out.model_from_joint.resize(n);
  out.tip.resize(n, Vector3d::Zero());
  for (const std::int32_t j : figure.order) {
    const std::int32_t parent = figure.parents[j];
    const DualQuaternion& reference = chosen->model[j];
    const bool trunk =
        std::find(figure.spine.begin(), figure.spine.end(), j) != figure.spine.end() ||
        std::find(figure.neck.begin(), figure.neck.end(), j) != figure.neck.end();
    const Quaterniond inherited = parent == kNoJoint ? front : correction[parent];
    const bool pelvis =
        std::find(figure.pelvis.begin(), figure.pelvis.end(), j) != figure.pelvis.end();
    const bool chest = !figure.spine.empty() && j == figure.spine.back();
    correction[j] = pelvis  ? level_hips
                    : chest ? level_chest
                    : trunk ? front
                            : corrections.of(roles[j], inherited);
    const Vector3d p = parent == kNoJoint
                           ? Vector3d(front * reference.translation())
                           : Vector3d(out.model_from_joint[parent].translation() +
                                      correction[parent] * (reference.translation() -
                                                            chosen->model[parent].translation()));
    out.model_from_joint[j] = DualQuaternion::from_rotation_translation(
        (correction[j] * reference.rotation()).normalized(), p);
    const Vector3d bone = roles[j] ? bones.along(*roles[j]) : bones.longest_child(j);
    out.tip[j] = reference.rotation().conjugate() * bone;
  }
  out.residual_deg = corrections.mean_turn_deg();
  measure(character, figure, out);
  return out;
}

}  // namespace limber
