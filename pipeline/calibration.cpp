#include "pipeline/calibration.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "pipeline/foot_reference.h"

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kGoodReferenceDeg = 25.0;  // a rest pose this close to a T-pose is one
constexpr double kSplayedDeg = 5.0;         // legs of a reference stand apart from here on
constexpr double kClearlyFlatterDeg = 3.0;  // a reading of the soles wins by at least this
constexpr double kPoorReferenceDeg = 45.0;  // beyond it, no pose of the file stands upright

double degrees_between(const Vector3d& a, const Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b)) * 180.0 / M_PI;
}

Quaterniond smallest_rotation(const Vector3d& from, const Vector3d& to) {
  return from.norm() < 1e-9 ? Quaterniond::Identity() : Quaterniond::FromTwoVectors(from, to);
}

struct Reference {
  std::string name;
  std::vector<DualQuaternion> model;
  double cost = 0.0;
};

/// The reference pose seen along the figure's own hierarchy.
class ReferenceView {
 public:
  ReferenceView(const Figure& figure, const std::vector<DualQuaternion>& model)
      : figure_(figure), model_(model) {}

  bool has(Role role) const { return figure_.has(role); }
  Vector3d p(Role role) const { return model_[figure_.at(role)].translation(); }
  Vector3d bone(Role from, Role to) const { return p(to) - p(from); }

  /// The figure's left, horizontal: from hips and shoulders.
  Vector3d left() const {
    Vector3d v = bone(Role::rightUpperLeg, Role::leftUpperLeg).normalized();
    if (has(Role::leftUpperArm) && has(Role::rightUpperArm)) {
      v += bone(Role::rightUpperArm, Role::leftUpperArm).normalized();
    }
    v.y() = 0.0;
    return v.norm() < 1e-9 ? Vector3d::UnitX() : Vector3d(v.normalized());
  }
  Vector3d forward() const { return left().cross(Vector3d::UnitY()); }

 private:
  const Figure& figure_;
  const std::vector<DualQuaternion>& model_;
};

/// How far a pose is from standing upright with straight legs (degrees, weighted mean). Arms may
/// hang or be raised.
double upright_cost(const Figure& figure, const std::vector<DualQuaternion>& model) {
  const ReferenceView view(figure, model);
  double sum = 0.0, weight = 0.0;
  const auto add = [&](double w, double angle) { sum += w * angle, weight += w; };
  const Vector3d hips = 0.5 * (view.p(Role::leftUpperLeg) + view.p(Role::rightUpperLeg));
  const Vector3d up = Vector3d::UnitY(), left = view.left();
  if (view.has(Role::leftUpperArm) && view.has(Role::rightUpperArm)) {
    const Vector3d shoulders = 0.5 * (view.p(Role::leftUpperArm) + view.p(Role::rightUpperArm));
    add(3.0, degrees_between(shoulders - hips, up));
  }
  if (view.has(Role::head)) add(2.0, degrees_between(view.p(Role::head) - hips, up));
  for (const Side side : {Side::left, Side::right}) {
    const auto on = [&](Role role) { return on_side(role, side); };
    const Vector3d out = side == Side::left ? left : Vector3d(-left);
    const Role thigh = on(Role::leftUpperLeg), shin = on(Role::leftLowerLeg),
               foot = on(Role::leftFoot);
    if (view.has(shin)) add(1.5, degrees_between(view.bone(thigh, shin), -up));
    if (view.has(shin) && view.has(foot)) add(1.5, degrees_between(view.bone(shin, foot), -up));
    const Role arm = on(Role::leftUpperArm), fore = on(Role::leftLowerArm),
               hand = on(Role::leftHand);
    if (!view.has(arm) || !view.has(fore) || !view.has(hand)) continue;
    const Vector3d upper = view.bone(arm, fore), lower = view.bone(fore, hand);
    add(0.3, degrees_between(upper, out));
    add(1.0, degrees_between(upper, lower));
    const Vector3d front = left.cross(up);
    add(1.0, std::abs(90.0 - degrees_between(upper, front)));
  }
  return weight > 0.0 ? sum / weight : 180.0;
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
        return front_;
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

  /// Corrections of feet that are known better than from the reference.
  void set_planted(std::map<Role, Quaterniond> planted) { planted_ = std::move(planted); }

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
  Quaterniond flat_foot(Role foot) const {
    if (const auto planted = planted_.find(foot); planted != planted_.end()) return planted->second;
    return toes_forward(foot, front_);
  }

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
  std::map<Role, Quaterniond> planted_;
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

/// World positions with the reference's rotations and the rest pose's bone vectors.
std::vector<DualQuaternion> with_rest_bones(const Character& character,
                                            const std::vector<DualQuaternion>& rotations) {
  const Skeleton& skeleton = character.skeleton;
  std::vector<DualQuaternion> model(rotations.size());
  for (std::int32_t j = 0; j < skeleton.size(); ++j) {
    const std::int32_t parent = skeleton.parents[j];
    const Vector3d t = skeleton.rest_parent_from_joint[j].translation();
    const Vector3d p = parent == kNoJoint ? t : model[parent].transform_point(t);
    model[j] = DualQuaternion::from_rotation_translation(rotations[j].rotation(), p);
  }
  return model;
}

std::vector<Reference> candidates(const Character& character, const Figure& figure,
                                  const ReferenceChoice& choice,
                                  std::span<const DualQuaternion> reference_pose,
                                  const Clip* clip) {
  const Skeleton& skeleton = character.skeleton;
  std::vector<Reference> out;
  const auto add = [&](std::string name, std::vector<DualQuaternion> model) {
    const double cost = figure.is_body() ? upright_cost(figure, model) : 0.0;
    out.push_back({std::move(name), std::move(model), cost});
  };
  const auto add_local = [&](std::string name, std::span<const DualQuaternion> local) {
    std::vector<DualQuaternion> model(local.size());
    model_from_local(skeleton, local, model);
    add(std::move(name), std::move(model));
  };
  using Kind = ReferenceChoice::Kind;
  const bool any = choice.kind == Kind::automatic;
  if (any || choice.kind == Kind::rest) add_local("rest", skeleton.rest_parent_from_joint);
  if ((any || choice.kind == Kind::bind) && !character.bind_model_from_joint.empty()) {
    add("bind", with_rest_bones(character, character.bind_model_from_joint));
  }
  if (any && !reference_pose.empty()) add_local("reference-frame", reference_pose);
  if (clip != nullptr && choice.kind == Kind::frame && choice.frame_index < clip->frames()) {
    add_local(fmt::format("frame:{}", choice.frame_index), clip->frame(choice.frame_index));
  }
  const bool need_motion =
      choice.kind == Kind::motion ||
      (any && figure.is_body() && std::none_of(out.begin(), out.end(), [](const Reference& r) {
         return r.cost < kGoodReferenceDeg;
       }));
  if (clip != nullptr && need_motion) {
    const std::int64_t step = std::max<std::int64_t>(1, clip->frames() / 400);
    std::int64_t best = 0;
    double best_cost = 1e9;
    std::vector<DualQuaternion> model(skeleton.parents.size());
    for (std::int64_t f = 0; f < clip->frames(); f += step) {
      model_from_local(skeleton, clip->frame(f), model);
      const double cost = figure.is_body() ? upright_cost(figure, model) : 0.0;
      if (cost < best_cost) best_cost = cost, best = f;
    }
    add_local("motion", clip->frame(best));
  }
  return out;
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
  std::vector<Reference> references = candidates(character, figure, choice, reference_pose, clip);
  if (references.empty()) {
    return Error{.code = "calibration-failed",
                 .message = "the file has no such reference pose",
                 .hint = "choose --reference rest, frame:N or motion"};
  }
  // The first good one wins; among poor ones the least bad.
  auto chosen = std::find_if(references.begin(), references.end(),
                             [](const Reference& r) { return r.cost < kGoodReferenceDeg; });
  if (chosen == references.end()) {
    chosen =
        std::min_element(references.begin(), references.end(),
                         [](const Reference& a, const Reference& b) { return a.cost < b.cost; });
  }
  if (chosen->cost > kPoorReferenceDeg) {
    return Error{
        .code = "calibration-failed",
        .message = fmt::format("no pose of the file stands upright (best: {}, {:.0f} degrees "
                               "off on average)",
                               chosen->name, chosen->cost),
        .hint = "name a frame that stands upright with --reference frame:N"};
  }

  const Bones bones(figure, chosen->model);
  Quaterniond front = Quaterniond::Identity();
  if (figure.is_body()) front = yaw_to_front(ReferenceView(figure, chosen->model).forward());
  // The hip line is level and square in the T-pose, whatever way the file's own pelvis leans or
  // turns below its shoulders: figures whose hip lines agree face the same way.
  Quaterniond level = front;
  if (figure.is_body()) {
    const Vector3d hip_line =
        ReferenceView(figure, chosen->model).bone(Role::rightUpperLeg, Role::leftUpperLeg);
    level = smallest_rotation(front * hip_line, Vector3d::UnitX()) * front;
  }
  Corrections corrections(figure, bones, front);
  if (figure.is_body() && clip != nullptr && chosen->name == "motion") {
    corrections.set_planted(planted_feet(character, figure, chosen->model, *clip));
  } else if (figure.is_body() && clip != nullptr) {
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
    correction[j] = j == figure.root() && figure.is_body() ? level
                    : trunk                                ? front
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
