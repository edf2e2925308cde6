// Laws of the calibrated T-pose: what it says does not hang on how the file's reference leans.
#include "pipeline/calibration.h"

#include <gtest/gtest.h>

#include <cmath>

#include "assets/model/clip.h"
#include "pipeline/foot_reference.h"
#include "pipeline/target.h"
#include "tests/pipeline/body.h"

namespace limber {
namespace {

using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;
using limber_test::Body;

constexpr double kDeg = M_PI / 180.0;

/// Holds a body's rest pose for a second.
Clip standing_clip(const Body& body) {
  const Skeleton& skeleton = body.character.skeleton;
  Clip clip;
  clip.rate_hz = 30.0;
  clip.joints = skeleton.size();
  for (int f = 0; f < 30; ++f) {
    clip.parent_from_joint.insert(clip.parent_from_joint.end(),
                                  skeleton.rest_parent_from_joint.begin(),
                                  skeleton.rest_parent_from_joint.end());
  }
  return clip;
}

Vector3d line(const Body& body, const Calibration& c, Role from, Role to) {
  return (c.position(body.figure.at(to)) - c.position(body.figure.at(from))).normalized();
}

TEST(Calibration, LevelsAndSquaresPelvisAndChestOfAnyReference) {
  for (const Vector3d& axis : {Vector3d(Vector3d::UnitY()), Vector3d(Vector3d::UnitZ())}) {
    for (const Role part : {Role::hips, Role::upperChest}) {
      Body body;
      const Quaterniond turn(AngleAxisd(8.0 * kDeg, axis));
      body.turn_rest(part, turn);
      if (part == Role::hips) body.turn_rest(Role::spine, turn.conjugate());  // the shoulders stay
      const Calibration c = body.calibrated();
      const Vector3d hips = line(body, c, Role::rightUpperLeg, Role::leftUpperLeg);
      const Vector3d shoulders = line(body, c, Role::rightUpperArm, Role::leftUpperArm);
      EXPECT_NEAR(hips.dot(Vector3d::UnitX()), 1.0, 1e-9) << name_of(part);
      EXPECT_NEAR(shoulders.dot(Vector3d::UnitX()), 1.0, 1e-9) << name_of(part);
    }
  }
}

TEST(Calibration, FromTheMotionAsksNotHowTheBodyLeansInIt) {
  const auto from_motion = [](const Body& body) {
    const Clip clip = standing_clip(body);
    auto out = calibrate(body.character, body.figure, {ReferenceChoice::motion, 0}, {}, &clip);
    EXPECT_TRUE(out);
    return std::move(*out);
  };
  Body upright, leaning;
  for (Body* body : {&upright, &leaning}) {  // no T-pose, which would be taken as it stands
    body->turn_rest(Role::leftUpperArm, Quaterniond(AngleAxisd(-1.2, Vector3d::UnitZ())));
    body->turn_rest(Role::rightUpperArm, Quaterniond(AngleAxisd(1.2, Vector3d::UnitZ())));
  }
  leaning.turn_rest(Role::hips, Quaterniond(AngleAxisd(8.0 * kDeg, Vector3d::UnitX())));
  const Calibration a = from_motion(upright), b = from_motion(leaning);
  for (const Role role : {Role::hips, Role::spine, Role::upperChest, Role::neck}) {
    const std::int32_t j = upright.figure.at(role);
    EXPECT_LT(rotation_angle(a.model_from_joint[j].rotation(), b.model_from_joint[j].rotation()),
              1e-6)
        << name_of(role);
  }
}

TEST(Calibration, ReadsFromTheClipWhetherSplayedLegsCarryTheirSolesAlong) {
  const Body t_pose;
  const Clip standing = standing_clip(t_pose);
  for (const bool square : {false, true}) {
    Body splayed;
    for (const Role thigh : {Role::leftUpperLeg, Role::rightUpperLeg}) {
      const double out = side_of(thigh) == Side::left ? 20.0 : -20.0;
      const Quaterniond turn(AngleAxisd(out * kDeg, Vector3d::UnitZ()));
      splayed.turn_rest(thigh, turn);
      // Flat in the reference: the foot undoes its leg's turn, and stands likewise in the clip.
      if (!square) splayed.turn_rest(on_side(Role::leftFoot, side_of(thigh)), turn.conjugate());
    }
    const Calibration calibration = splayed.calibrated(&standing);
    const Calibration upright = t_pose.calibrated();
    for (const Role foot : {Role::leftFoot, Role::rightFoot}) {
      const std::int32_t j = splayed.figure.at(foot);
      EXPECT_NEAR(calibration.model_from_joint[j].rotation().angularDistance(
                      upright.model_from_joint[j].rotation()),
                  0.0, 1e-6)
          << (square ? "square to the leg" : "flat") << ", " << name_of(foot);
    }
  }
}

TEST(StanceTilt, IsTheAngleOfTheSoleWhereTheAnkleIsLow) {
  const Body body;
  const Clip standing = standing_clip(body);
  const std::int32_t foot = body.figure.at(Role::leftFoot);
  const Quaterniond level = body.calibrated().model_from_joint[foot].rotation();
  const auto rolled = [&](double deg) {
    return Quaterniond(AngleAxisd(deg * kDeg, Vector3d::UnitZ()) * level);
  };
  EXPECT_NEAR(stance_tilt_deg(body.character.skeleton, standing, foot, level), 0.0, 1e-4);
  EXPECT_NEAR(stance_tilt_deg(body.character.skeleton, standing, foot, rolled(12.0)), 12.0, 1e-6);
}

}  // namespace
}  // namespace limber
