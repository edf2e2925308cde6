// Laws of hips and trunk from one body to another.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "pipeline/rotation_transfer.h"
#include "pipeline/trunk_transfer.h"
#include "tests/pipeline/body.h"

namespace limber {
namespace {

using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;
using limber_test::Body;

constexpr double kDeg = M_PI / 180.0;

/// A body whose legs hang below its first spine joint, as those of 3ds Max Biped do.
Body legs_on_spine() {
  Body body;
  Skeleton& skeleton = body.character.skeleton;
  std::vector<DualQuaternion> model(skeleton.parents.size());
  model_from_local(skeleton, skeleton.rest_parent_from_joint, model);
  const std::int32_t spine = body.figure.at(Role::spine);
  for (const Role thigh : {Role::leftUpperLeg, Role::rightUpperLeg}) {
    const std::int32_t j = body.figure.at(thigh);
    EXPECT_LT(spine, j) << "parents come first";
    skeleton.parents[j] = spine;
    skeleton.rest_parent_from_joint[j] = model[spine].conjugate() * model[j];
  }
  auto figure = identify_figure(body.character);
  EXPECT_TRUE(figure);
  body.figure = std::move(*figure);
  return body;
}

TEST(Figure, HipsAreTheJointThatCarriesBothThighs) {
  const Body plain;
  const std::int32_t named = plain.figure.at(Role::hips), spine = plain.figure.at(Role::spine);
  EXPECT_EQ(plain.figure.pelvis, std::vector<std::int32_t>{named});
  const Body biped = legs_on_spine();
  EXPECT_EQ(biped.figure.at(Role::hips), spine);
  EXPECT_EQ(biped.figure.pelvis, (std::vector<std::int32_t>{named, spine}));
  EXPECT_EQ(biped.figure.root(), named) << "the body's place stays where the file has it";
  EXPECT_EQ(std::ranges::count(biped.figure.spine, spine), 0);
}

/// A target with a body's own rig, which nothing limits.
Target target_of(const Body& body) {
  Target target;
  target.character = body.character;
  target.figure = body.figure;
  target.calibration = body.calibrated();
  target.rig = limited_rig(body.character, body.figure, target.calibration, false);
  for (const RigJoint& row : target.rig.joints) {
    target.joint_of_row.push_back(body.character.skeleton.find(row.name));
  }
  return target;
}

/// Rotations since the T-pose of a target for one pose of a source, given by local turns.
struct Transfer {
  Body from;
  Target to;
  std::vector<DualQuaternion> source;  // model from joint
  std::vector<Quaterniond> since;

  Transfer(Body source_body, const Body& target_body)
      : from(std::move(source_body)), to(target_of(target_body)) {}

  void run(const std::map<Role, Quaterniond>& turns) {
    const Skeleton& skeleton = from.character.skeleton;
    const Calibration calibration = from.calibrated();
    Pose pose(skeleton.rest_parent_from_joint);
    for (const auto& [role, turn] : turns) {
      DualQuaternion& q = pose[from.figure.at(role)];
      q = DualQuaternion::from_rotation_translation(q.rotation() * turn, q.translation());
    }
    source.resize(pose.size());
    model_from_local(skeleton, pose, source);
    Clip clip;
    clip.rate_hz = 30.0;
    clip.joints = skeleton.size();
    clip.parent_from_joint = pose;
    since.resize(to.character.skeleton.parents.size());
    const SourceMotion motion{&from.character, &from.figure, &calibration, &clip};
    RotationTransfer(motion, to, FingerMode::rest).frame(source, since);
  }
};

TEST(RotationTransfer, ThePelvisTurnsAsTheSourcesThighsAreCarried) {
  const Quaterniond turn(AngleAxisd(20.0 * kDeg, Vector3d::UnitY()));
  Transfer from_biped(legs_on_spine(), Body());
  from_biped.run({{Role::hips, turn}});  // its role is the joint that carries the thighs
  const std::int32_t hips = from_biped.to.figure.at(Role::hips);
  EXPECT_NEAR(from_biped.since[hips].angularDistance(turn), 0.0, 1e-7);

  Transfer to_biped(Body(), legs_on_spine());
  to_biped.run({{Role::hips, turn}});
  for (const std::int32_t j : to_biped.to.figure.pelvis) {
    EXPECT_NEAR(to_biped.since[j].angularDistance(turn), 0.0, 1e-7);
  }
}

/// Between the hip joints to between the shoulders, of a pose in model space.
Vector3d trunk_of(const Figure& figure, std::span<const DualQuaternion> model) {
  const auto p = [&](Role role) { return model[figure.at(role)].translation(); };
  return (p(Role::leftUpperArm) + p(Role::rightUpperArm) - p(Role::leftUpperLeg) -
          p(Role::rightUpperLeg))
      .normalized();
}

TEST(RotationTransfer, TrunksOfOtherSegmentLengthsLeanAlike) {
  Body long_waist;
  Skeleton& skeleton = long_waist.character.skeleton;
  const auto stretch = [&](Role role, double factor) {
    DualQuaternion& q = skeleton.rest_parent_from_joint[long_waist.figure.at(role)];
    q = DualQuaternion::from_rotation_translation(q.rotation(), factor * q.translation());
  };
  stretch(Role::chest, 2.0);
  stretch(Role::upperChest, 0.5);
  Transfer transfer(Body(), long_waist);
  transfer.run({{Role::spine, Quaterniond(AngleAxisd(30.0 * kDeg, Vector3d::UnitX()))},
                {Role::upperChest, Quaterniond(AngleAxisd(-25.0 * kDeg, Vector3d::UnitX()))}});
  // The target's joints turned as the transfer says.
  const Target& to = transfer.to;
  std::vector<DualQuaternion> posed(to.calibration.model_from_joint);
  for (const std::int32_t j : to.figure.order) {
    const std::int32_t parent = to.figure.parents[j];
    if (parent == kNoJoint) continue;
    const Vector3d bone = to.calibration.position(j) - to.calibration.position(parent);
    posed[j] = DualQuaternion::from_rotation_translation(
        transfer.since[j] * to.calibration.model_from_joint[j].rotation(),
        posed[parent].translation() + transfer.since[parent] * bone);
  }
  const Vector3d rest_from =
      trunk_of(transfer.from.figure, transfer.from.calibrated().model_from_joint);
  const Vector3d rest_to = trunk_of(to.figure, to.calibration.model_from_joint);
  ASSERT_LT((rest_from - rest_to).norm(), 1e-2) << "both stand alike, so both are to lean alike";
  const Vector3d lean = trunk_of(transfer.from.figure, transfer.source);
  EXPECT_GT(std::acos(lean.dot(rest_from)), 5.0 * kDeg);
  EXPECT_LT(std::acos(std::min(1.0, lean.dot(trunk_of(to.figure, posed)))), 0.6 * kDeg);
}

}  // namespace
}  // namespace limber
