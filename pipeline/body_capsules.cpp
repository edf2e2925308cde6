// Bodies as capsules.
//
// Widths of people go with their height: in units of g, the geometric mean of the stature that the
// chains of bones give and the one that the legs give (a leg, hip to ankle, is 0.485 of a stature;
// R. Drillis, R. Contini, Body Segment Parameters, 1966), a torso has a radius of 0.070, a head
// 0.050, a thigh 0.045, a forearm 0.022, a hand 0.018.
#include "pipeline/body_capsules.h"

#include <algorithm>
#include <cmath>

#include "solver/capsule_contacts.h"

namespace limber {
namespace {

using Eigen::Vector3d;

constexpr double kLegOfStature = 0.485;
constexpr double kHeadAndSoles = 1.19;                  // stature over ankle to hip to head joint
constexpr double kTorsoBegin = 0.10, kTorsoEnd = 0.85;  // of hips to shoulders
constexpr double kHeadBegin = 0.03, kHeadEnd = 0.075;   // of the scale, above the head joint
constexpr double kForearmBegin = 0.35;                  // of elbow to wrist: folded arms meet there
constexpr double kHandLength = 0.055;                   // of the scale
constexpr std::array<double, kBodyPartCount> kRadius = {0.070, 0.050, 0.045, 0.045,
                                                        0.022, 0.022, 0.018, 0.018};

constexpr std::array<PartPair, 20> kPairs = {{
    {BodyPart::leftForearm, BodyPart::torso},        {BodyPart::leftForearm, BodyPart::head},
    {BodyPart::leftForearm, BodyPart::leftThigh},    {BodyPart::leftForearm, BodyPart::rightThigh},
    {BodyPart::leftHand, BodyPart::torso},           {BodyPart::leftHand, BodyPart::head},
    {BodyPart::leftHand, BodyPart::leftThigh},       {BodyPart::leftHand, BodyPart::rightThigh},
    {BodyPart::rightForearm, BodyPart::torso},       {BodyPart::rightForearm, BodyPart::head},
    {BodyPart::rightForearm, BodyPart::leftThigh},   {BodyPart::rightForearm, BodyPart::rightThigh},
    {BodyPart::rightHand, BodyPart::torso},          {BodyPart::rightHand, BodyPart::head},
    {BodyPart::rightHand, BodyPart::leftThigh},      {BodyPart::rightHand, BodyPart::rightThigh},
    {BodyPart::leftForearm, BodyPart::rightForearm}, {BodyPart::leftForearm, BodyPart::rightHand},
    {BodyPart::leftHand, BodyPart::rightForearm},    {BodyPart::leftHand, BodyPart::rightHand},
}};

/// The axis of a trunk, straight however the spine bends: figures whose spines have different
/// joints are measured alike.
Capsule trunk_line(const std::array<std::int32_t, 4>& trunk,
                   std::span<const DualQuaternion> model_from_joint) {
  const auto middle = [&](std::size_t i) {
    return Vector3d(0.5 * (model_from_joint[trunk[i]].translation() +
                           model_from_joint[trunk[i + 1]].translation()));
  };
  const Vector3d hips = middle(0), along = middle(2) - hips;
  return {hips + kTorsoBegin * along, hips + kTorsoEnd * along};
}

/// The capsules of one figure, built in its T-pose.
class Body {
 public:
  Body(const Figure& figure, const Calibration& calibration)
      : figure_(figure), calibration_(calibration), scale_(girth_scale(figure, calibration)) {}

  std::vector<PartCapsule> run() {
    add_torso();
    if (figure_.has(Role::head)) {
      const std::int32_t head = figure_.at(Role::head);
      const Vector3d up = scale_ * Vector3d::UnitY();
      add(BodyPart::head, head, position(head) + kHeadBegin * up, position(head) + kHeadEnd * up);
    }
    for (const Side side : {Side::left, Side::right}) add_limbs(side);
    return std::move(out_);
  }

 private:
  Vector3d position(std::int32_t joint) const { return calibration_.position(joint); }
  /// From and to in the T-pose's space.
  void add(BodyPart part, std::int32_t joint, const Vector3d& from, std::int32_t end_joint,
           const Vector3d& to) {
    const auto in = [&](std::int32_t j, const Vector3d& p) {
      return calibration_.model_from_joint[j].conjugate().transform_point(p);
    };
    out_.push_back(
        {part,
         joint,
         end_joint,
         {in(joint, from), in(end_joint, to), scale_ * kRadius[static_cast<std::size_t>(part)]}});
  }
  void add(BodyPart part, std::int32_t joint, const Vector3d& from, const Vector3d& to) {
    add(part, joint, from, joint, to);
  }

  void add_torso() {
    const std::array roles = {Role::leftUpperLeg, Role::rightUpperLeg, Role::leftUpperArm,
                              Role::rightUpperArm};
    if (!figure_.has(roles[2]) || !figure_.has(roles[3])) return;
    const std::int32_t hips = figure_.at(Role::hips);
    const std::int32_t chest = figure_.spine.empty() ? hips : figure_.spine.back();
    std::array<std::int32_t, 4> trunk;
    std::ranges::transform(roles, trunk.begin(), [&](Role role) { return figure_.at(role); });
    const Capsule line = trunk_line(trunk, calibration_.model_from_joint);
    add(BodyPart::torso, hips, line.from, chest, line.to);
    out_.back().trunk = trunk;
  }

  void add_limbs(Side side) {
    const bool left = side == Side::left;
    const auto on = [&](Role role) { return figure_.at(on_side(role, side)); };
    const std::int32_t hip = on(Role::leftUpperLeg), knee = on(Role::leftLowerLeg);
    if (hip != kNoJoint && knee != kNoJoint) {
      add(left ? BodyPart::leftThigh : BodyPart::rightThigh, hip, position(hip), position(knee));
    }
    const std::int32_t elbow = on(Role::leftLowerArm), wrist = on(Role::leftHand);
    if (elbow == kNoJoint || wrist == kNoJoint) return;
    const Vector3d lower = position(wrist) - position(elbow);
    add(left ? BodyPart::leftForearm : BodyPart::rightForearm, elbow,
        position(elbow) + kForearmBegin * lower, position(wrist));
    // A hand whose bone ends nowhere goes on as the forearm does.
    Vector3d ahead = calibration_.model_from_joint[wrist].rotation() * calibration_.tip[wrist];
    const bool pointless = ahead.norm() < 1e-6;
    if (pointless) ahead = lower;
    add(left ? BodyPart::leftHand : BodyPart::rightHand, pointless ? elbow : wrist, position(wrist),
        position(wrist) + kHandLength * scale_ * ahead.stableNormalized());
  }

  const Figure& figure_;
  const Calibration& calibration_;
  double scale_;
  std::vector<PartCapsule> out_;
};

}  // namespace

Capsule PartCapsule::placed(std::span<const DualQuaternion> model_from_joint) const {
  if (trunk[0] != kNoJoint) {
    const Capsule line = trunk_line(trunk, model_from_joint);
    return {line.from, line.to, capsule.radius};
  }
  return {model_from_joint[joint].transform_point(capsule.from),
          model_from_joint[end_joint].transform_point(capsule.to), capsule.radius};
}

std::span<const PartPair> part_pairs() { return kPairs; }

double girth_scale(const Figure& figure, const Calibration& calibration) {
  if (!figure.is_body()) return calibration.height;
  // From between the hip joints: what moves as the hips may have its joint on the floor.
  Vector3d below = 0.5 * (calibration.position(figure.at(Role::leftUpperLeg)) +
                          calibration.position(figure.at(Role::rightUpperLeg)));
  double trunk = 0.0;
  const auto climb = [&](std::int32_t joint) {
    if (joint == kNoJoint) return;
    trunk += (calibration.position(joint) - below).norm();
    below = calibration.position(joint);
  };
  for (const std::int32_t joint : figure.spine) climb(joint);
  for (const std::int32_t joint : figure.neck) climb(joint);
  climb(figure.at(Role::head));
  const double leg = calibration.leg_length;
  if (!(leg > 0.0) || !(trunk > 0.0)) return calibration.height;
  return std::sqrt(kHeadAndSoles * (leg + trunk) * leg / kLegOfStature);
}

std::vector<PartCapsule> body_capsules(const Figure& figure, const Calibration& calibration) {
  if (!figure.is_body()) return {};
  return Body(figure, calibration).run();
}

void part_gaps(std::span<const PartCapsule> capsules,
               std::span<const DualQuaternion> model_from_joint, std::span<PartGap> gaps) {
  std::ranges::fill(gaps, PartGap{});
  std::array<std::int32_t, kBodyPartCount> capsule_of;
  std::array<Capsule, kBodyPartCount> placed;
  capsule_of.fill(kNoJoint);
  for (std::size_t i = 0; i < capsules.size(); ++i) {
    const auto part = static_cast<std::size_t>(capsules[i].part);
    capsule_of[part] = static_cast<std::int32_t>(i);
    placed[part] = capsules[i].placed(model_from_joint);
  }
  const auto carrier = [&](std::size_t part, const Vector3d& p) {
    const PartCapsule& c = capsules[capsule_of[part]];
    const bool ends = (p - placed[part].to).norm() < (p - placed[part].from).norm();
    return ends ? c.end_joint : c.joint;
  };
  for (std::size_t k = 0; k < kPairs.size(); ++k) {
    const auto a = static_cast<std::size_t>(kPairs[k].a), b = static_cast<std::size_t>(kPairs[k].b);
    if (capsule_of[a] == kNoJoint || capsule_of[b] == kNoJoint) continue;
    const CapsuleGap gap = capsule_gap(placed[a], placed[b]);
    gaps[k] = {gap.gap, carrier(a, gap.on_a), carrier(b, gap.on_b), gap.on_a, gap.on_b};
  }
}

}  // namespace limber
