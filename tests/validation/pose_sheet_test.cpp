#include "validation/pose_sheet.h"

#include <gtest/gtest.h>

#include "assets/model/mannequin.h"
#include "validation/figure_model.h"

namespace limber {
namespace {

using Eigen::Vector3d;

/// A leg with its foot as the root: foot, lower leg, hips, head, and the other foot on the hips.
Rig foot_rooted() {
  Rig rig;
  const auto add = [&](const char* name, std::int32_t parent, const Vector3d& offset) {
    RigJoint joint;
    joint.name = joint.role = name;
    joint.parent = parent;
    joint.type = parent == kNoJoint ? JointType::free : JointType::ball;
    joint.offset = offset;
    rig.joints.push_back(joint);
  };
  add("rightFoot", kNoJoint, {-0.1, 0.05, 0});
  add("rightLowerLeg", 0, {0, 0.4, 0});
  add("hips", 1, {0.1, 0.45, 0});
  add("head", 2, {0, 0.6, 0});
  add("leftLowerLeg", 2, {0.1, -0.45, 0});
  add("leftFoot", 4, {0, -0.4, 0});
  return rig;
}

PoseSheet sheet_of(const Character& character, const Vector3d& target) {
  PoseSheet sheet;
  sheet.title = "a figure";
  sheet.character = &character;
  PoseCell cell;
  cell.name = "a pose";
  cell.verdict = "reached";
  cell.parent_from_joint = character.skeleton.rest_parent_from_joint;
  cell.lines = {"a line"};
  PoseMark mark;
  mark.joint = 3;
  const auto at = [](const Vector3d& p) {
    return DualQuaternion::from_rotation_translation(Eigen::Quaterniond::Identity(), p);
  };
  mark.reached = at({0, 1.5, 0});
  mark.target = at(target);
  cell.marks = {mark};
  sheet.cells = {cell};
  return sheet;
}

TEST(PoseSheet, TheTrunkIsInTheMiddleWhicheverJointItHangsOn) {
  const Character character = mannequin(foot_rooted());
  const BodyPlan plan = plan_of(character);
  const auto side = [&](const char* name) { return plan.sides[character.skeleton.find(name)]; };
  EXPECT_EQ(side("rightLowerLeg"), BodySide::right);
  EXPECT_EQ(side("hips"), BodySide::centre);
  EXPECT_EQ(side("head"), BodySide::centre);
  EXPECT_EQ(side("leftFoot"), BodySide::left);
}

TEST(PoseSheet, NothingIsDrawnOutsideThePictures) {
  // The same sheet with a target near by, far off, and farther than floats tell apart: words and
  // margins stay as they are.
  const Character character = mannequin(foot_rooted());
  const auto near = render_pose_sheet(sheet_of(character, {0, 1.5, 0}));
  ASSERT_TRUE(near.ok());
  const auto inside = [&](std::int32_t x, std::int32_t y) {
    for (const PoseView& view : near->views) {
      const Box& b = view.box;
      if (x >= b.x && x < b.x + b.width && y >= b.y && y < b.y + b.height) return true;
    }
    return false;
  };
  for (const Vector3d& target : {Vector3d(5, 3, 2), Vector3d(-1e6, 1e6, 1e6), Vector3d(0, -9, 0)}) {
    const auto far = render_pose_sheet(sheet_of(character, target));
    ASSERT_TRUE(far.ok());
    ASSERT_EQ(far->image.rgb.size(), near->image.rgb.size());
    int changed = 0, red = 0;
    for (std::int32_t y = 0; y < near->image.height; ++y) {
      for (std::int32_t x = 0; x < near->image.width; ++x) {
        const std::size_t i = 3 * (std::size_t(y) * near->image.width + x);
        const std::uint8_t *a = &near->image.rgb[i], *b = &far->image.rgb[i];
        const bool same = a[0] == b[0] && a[1] == b[1] && a[2] == b[2];
        changed += !same && !inside(x, y);
        red += inside(x, y) && b[0] > 190 && b[1] < 70 && b[2] < 70;
      }
    }
    EXPECT_EQ(changed, 0) << target.transpose();
    EXPECT_GT(red, 100) << "the way to the target is drawn";
  }
}

TEST(PoseSheet, PosesThatDoNotFitAreErrors) {
  const Character character = mannequin(foot_rooted());
  PoseSheet sheet = sheet_of(character, {0, 1.5, 0});
  sheet.cells[0].parent_from_joint.pop_back();
  EXPECT_EQ(render_pose_sheet(sheet).error().code, "sheet-input");
  sheet.cells.clear();
  EXPECT_EQ(render_pose_sheet(sheet).error().code, "sheet-input");
}

}  // namespace
}  // namespace limber
