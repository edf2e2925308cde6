// Unit and up axis are read off the figure, whatever it does.

#include "importers/figure_guess.h"

#include <gtest/gtest.h>

#include "tests/importers/bvh_writer.h"
#include "tests/importers/support.h"

namespace limber::test {
namespace {

Skeleton figure_skeleton() {
  Skeleton skeleton;
  for (const FigureJoint& joint : figure()) {
    skeleton.names.emplace_back(joint.name);
    skeleton.parents.push_back(joint.parent);
    skeleton.rest_parent_from_joint.push_back(DualQuaternion::from_translation(joint.offset));
  }
  return skeleton;
}

/// The rest pose, turned as a whole and put somewhere.
Clip still_clip(const Skeleton& skeleton, const Eigen::Quaterniond& turn,
                const Eigen::Vector3d& root) {
  Clip clip;
  clip.joints = skeleton.size();
  for (int f = 0; f < 5; ++f) {
    clip.parent_from_joint.insert(clip.parent_from_joint.end(),
                                  skeleton.rest_parent_from_joint.begin(),
                                  skeleton.rest_parent_from_joint.end());
    clip.frame(f)[0] = DualQuaternion::from_rotation_translation(turn, root);
  }
  return clip;
}

const Eigen::Quaterniond kQuarterX(Eigen::AngleAxisd(M_PI / 2, Eigen::Vector3d::UnitX()));

TEST(FigureGuess, CanonicalTurnTakesUpToY) {
  for (const char* up : {"+X", "-X", "+Y", "-Y", "+Z", "-Z"}) {
    Eigen::Vector3d axis = Eigen::Vector3d::Zero();
    axis[up[1] - 'X'] = up[0] == '+' ? 1 : -1;
    EXPECT_LT((canonical_from_up(up) * axis - Eigen::Vector3d::UnitY()).norm(), 1e-12) << up;
  }
}

TEST(FigureGuess, ASleeperIsNoProofOfZUp) {
  const Skeleton skeleton = figure_skeleton();
  // Lies on the floor of a Y-up stage, 3 m from the origin: head along +Z.
  const Clip clip = still_clip(skeleton, kQuarterX, {0, 0.1, 3.0});
  EXPECT_EQ(guess_up(skeleton, &clip).up, "+Y");
}

TEST(FigureGuess, StandingAlongZOnYUpOffsetsIsZUp) {
  const Skeleton skeleton = figure_skeleton();
  const Clip clip = still_clip(skeleton, kQuarterX, {0, 3.0, 0.95});
  const UpGuess guess = guess_up(skeleton, &clip);
  EXPECT_EQ(guess.up, "+Z");
  EXPECT_EQ(guess.rest_up, "+Y");
}

TEST(FigureGuess, AHandstandIsNotUpsideDown) {
  const Skeleton skeleton = figure_skeleton();
  const Clip clip = still_clip(
      skeleton, Eigen::Quaterniond(Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitX())), {0, 1, 0});
  EXPECT_EQ(guess_up(skeleton, &clip).up, "+Y");
}

TEST(FigureGuess, UnitsOfAnAdult) {
  for (const double unit : {1.0, 0.01, 0.001, 0.1, 0.0254, 0.0254 / 0.45}) {
    Skeleton skeleton = figure_skeleton();
    for (DualQuaternion& q : skeleton.rest_parent_from_joint) q.dual.coeffs() /= unit;
    const UnitGuess guess = guess_unit(skeleton, nullptr, "+Y");
    EXPECT_NEAR(guess.unit_m, unit, 1e-12) << guess.evidence;
    EXPECT_TRUE(guess.plausible);
    EXPECT_TRUE(guess.certain);
  }
}

TEST(FigureGuess, AGiantIsScaledToAHumanAndSaidSo) {
  Skeleton skeleton = figure_skeleton();
  for (DualQuaternion& q : skeleton.rest_parent_from_joint) q.dual.coeffs() *= 5.0;
  const UnitGuess guess = guess_unit(skeleton, nullptr, "+Y");
  EXPECT_FALSE(guess.plausible);
  EXPECT_NEAR(guess.unit_m, 1.72 / (5.0 * 1.16 * (0.95 + 0.63)), 0.01);
}

TEST(FigureGuess, AHandIsNotAPerson) {
  Skeleton skeleton;
  const auto add = [&](const std::string& name, int parent, const Eigen::Vector3d& offset_cm) {
    skeleton.names.push_back(name);
    skeleton.parents.push_back(parent);
    skeleton.rest_parent_from_joint.push_back(DualQuaternion::from_translation(offset_cm));
    return skeleton.size() - 1;
  };
  const int wrist = add("wrist", -1, {0, 0, 0});
  for (const char* finger : {"thumb", "index", "middle", "ring", "little"}) {
    int joint = wrist;
    for (int k = 0; k < 4; ++k) joint = add(finger + std::to_string(k), joint, {4.5, 0, 0});
  }
  const UnitGuess guess = guess_unit(skeleton, nullptr, "+Y");
  EXPECT_DOUBLE_EQ(guess.unit_m, 0.01) << guess.evidence;
}

}  // namespace
}  // namespace limber::test
