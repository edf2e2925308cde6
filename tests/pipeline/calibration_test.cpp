// Laws of the calibrated T-pose: what it says does not hang on how the file's reference leans.
#include "pipeline/calibration.h"

#include <gtest/gtest.h>

#include <cmath>

#include "assets/model/clip.h"
#include "assets/model/mannequin.h"
#include "pipeline/foot_reference.h"
#include "pipeline/target.h"

namespace limber {
namespace {

using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

constexpr double kDeg = M_PI / 180.0;

/// A shipped body whose rest pose is its T-pose, to be bent by a test.
struct Body {
  Character character;
  Figure figure;

  Body() : character(mannequin(*shipped_rig("biped-full"))) {
    auto found = identify_figure(character);
    EXPECT_TRUE(found);
    figure = std::move(*found);
  }

  /// Turns the rest pose of a role's joint by `turn`, given in the world.
  void turn_rest(Role role, const Quaterniond& turn) {
    Skeleton& skeleton = character.skeleton;
    std::vector<DualQuaternion> model(skeleton.parents.size());
    model_from_local(skeleton, skeleton.rest_parent_from_joint, model);
    const std::int32_t j = figure.at(role);
    const Quaterniond world = model[j].rotation();
    DualQuaternion& local = skeleton.rest_parent_from_joint[j];
    local = DualQuaternion::from_rotation_translation(
        (local.rotation() * world.conjugate() * turn * world).normalized(), local.translation());
  }

  Calibration calibrated(const Clip* clip = nullptr) const {
    auto out = calibrate(character, figure, {ReferenceChoice::rest, 0}, {}, clip);
    EXPECT_TRUE(out);
    return std::move(*out);
  }

  Vector3d hip_line(const Calibration& c) const {
    return (c.position(figure.at(Role::leftUpperLeg)) - c.position(figure.at(Role::rightUpperLeg)))
        .normalized();
  }
};

TEST(Calibration, LevelsAndSquaresThePelvisOfAnyReference) {
  for (const Vector3d& axis : {Vector3d(Vector3d::UnitY()), Vector3d(Vector3d::UnitZ())}) {
    Body body;
    const Quaterniond turn(AngleAxisd(8.0 * kDeg, axis));
    body.turn_rest(Role::hips, turn);
    body.turn_rest(Role::spine, turn.conjugate());  // the shoulders stay
    EXPECT_NEAR(body.hip_line(body.calibrated()).dot(Vector3d::UnitX()), 1.0, 1e-9);
  }
}

/// Stands with level legs and soles for a second: what the joints are to a body that is in its
/// T-pose, whatever the rest pose of the file.
Clip standing_clip(const Body& t_pose) {
  const Skeleton& skeleton = t_pose.character.skeleton;
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
