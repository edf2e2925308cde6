#include "pipeline/reference_pose.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "pipeline/motion_reference.h"

namespace limber {
namespace {

using Eigen::Vector3d;

constexpr double kGoodReferenceDeg = 25.0;  // a rest pose this close to a T-pose is one
constexpr double kTPoseDeg = 12.0;          // each limb this close: somebody stands in the T-pose
constexpr double kPoorReferenceDeg = 45.0;  // beyond it, no pose of the file stands upright

/// How far a pose is from standing upright with straight legs (degrees, weighted mean). Arms may
/// hang or be raised.
double upright_cost(const Figure& figure, const std::vector<DualQuaternion>& model) {
  const ReferenceView view(figure, model);
  double sum = 0.0, weight = 0.0;
  const auto add = [&](double w, double angle) { sum += w * angle, weight += w; };
  const Vector3d hips = 0.5 * (view.p(Role::leftUpperLeg) + view.p(Role::rightUpperLeg));
  const Vector3d up = Vector3d::UnitY(), left = view.left();
  if (view.has(Role::leftUpperArm) && view.has(Role::rightUpperArm)) {
    add(3.0, degrees_between(view.trunk(), up));
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

/// Each arm and leg and the trunk lie as in the T-pose.
bool stands_in_t_pose(const Figure& figure, const std::vector<DualQuaternion>& model) {
  const ReferenceView view(figure, model);
  const auto lies = [&](Role upper, const Vector3d& direction) {
    const Role middle = role_at(index_of(upper) + 1), end = role_at(index_of(upper) + 2);
    return view.has(upper) && view.has(middle) && view.has(end) &&
           degrees_between(view.bone(upper, middle), direction) < kTPoseDeg &&
           degrees_between(view.bone(middle, end), direction) < kTPoseDeg;
  };
  const Vector3d left = view.left(), up = Vector3d::UnitY();
  return degrees_between(view.trunk(), up) < kTPoseDeg && lies(Role::leftUpperArm, left) &&
         lies(Role::rightUpperArm, -left) && lies(Role::leftUpperLeg, -up) &&
         lies(Role::rightUpperLeg, -up);
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

std::vector<ReferencePose> candidates(const Character& character, const Figure& figure,
                                      const ReferenceChoice& choice,
                                      std::span<const DualQuaternion> reference_pose,
                                      const Clip* clip) {
  const Skeleton& skeleton = character.skeleton;
  std::vector<ReferencePose> out;
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
      (any && figure.is_body() && std::none_of(out.begin(), out.end(), [](const ReferencePose& r) {
         return r.cost_deg < kGoodReferenceDeg;
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
    ReferencePose& chosen = out.back();
    if (figure.is_body() && !stands_in_t_pose(figure, chosen.model)) {
      chosen.model = motion_reference(character, figure, *clip, best);
    }
  }
  return out;
}

}  // namespace

double degrees_between(const Vector3d& a, const Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b)) * 180.0 / M_PI;
}

Result<ReferencePose> choose_reference(const Character& character, const Figure& figure,
                                       const ReferenceChoice& choice,
                                       std::span<const DualQuaternion> reference_pose,
                                       const Clip* clip) {
  std::vector<ReferencePose> references =
      candidates(character, figure, choice, reference_pose, clip);
  if (references.empty()) {
    return Error{.code = "calibration-failed",
                 .message = "the file has no such reference pose",
                 .hint = "choose --reference rest, frame:N or motion"};
  }
  // The first good one wins; among poor ones the least bad.
  auto chosen = std::find_if(references.begin(), references.end(),
                             [](const ReferencePose& r) { return r.cost_deg < kGoodReferenceDeg; });
  if (chosen == references.end()) {
    chosen = std::min_element(
        references.begin(), references.end(),
        [](const ReferencePose& a, const ReferencePose& b) { return a.cost_deg < b.cost_deg; });
  }
  if (chosen->cost_deg > kPoorReferenceDeg) {
    return Error{
        .code = "calibration-failed",
        .message = fmt::format("no pose of the file stands upright (best: {}, {:.0f} degrees "
                               "off on average)",
                               chosen->name, chosen->cost_deg),
        .hint = "name a frame that stands upright with --reference frame:N"};
  }
  return std::move(*chosen);
}

}  // namespace limber
