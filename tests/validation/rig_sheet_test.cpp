// What is drawn of a joint's limits is where its limits are.
#include "validation/rig_sheet.h"

#include <gtest/gtest.h>

#include <cmath>

#include "validation/limit_check.h"

namespace limber {
namespace {

using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

/// The bone at the border is within the limits, and beyond them a little farther on.
void expect_on_border(const RigJoint& joint, const Vector3d& bone, const Vector3d& direction) {
  const AngleAxisd swing(Quaterniond::FromTwoVectors(bone, direction));
  const auto excess = [&](double share) {
    return limit_excess(joint,
                        joint.rest * Quaterniond(AngleAxisd(share * swing.angle(), swing.axis())));
  };
  EXPECT_LT(excess(0.999), 1e-6);
  EXPECT_GT(excess(1.01), 1e-4);
}

TEST(LimitShape, ABallsEllipseIsItsBorder) {
  RigJoint joint;
  joint.type = JointType::ball;
  joint.rest = Quaterniond(AngleAxisd(0.4, Vector3d(1, 2, 3).normalized()));
  joint.axes = {Vector3d::UnitY(), Vector3d::UnitZ(), Vector3d::UnitX()};
  joint.limits = {Range{-0.3, 1.1}, Range{-0.7, 0.4}, Range{-0.5, 0.2}};
  const LimitShape shape = limit_shape(joint, Vector3d::UnitX());
  EXPECT_TRUE(shape.closed);
  ASSERT_GT(shape.border.size(), 20U);
  for (const Vector3d& direction : shape.border) {
    expect_on_border(joint, Vector3d::UnitX(), direction);
  }
  EXPECT_EQ(shape.twist.min, -0.5);
  const LimitShape reversed = limit_shape(joint, -Vector3d::UnitX());
  EXPECT_EQ(reversed.twist.min, -0.2);  // about a bone that points the other way
}

TEST(LimitShape, AHingesArcEndsAtItsRange) {
  RigJoint joint;
  joint.type = JointType::hinge;
  joint.axes[0] = Vector3d::UnitZ();
  joint.limits[0] = {-0.4, 2.0};
  const LimitShape shape = limit_shape(joint, Vector3d::UnitX());
  EXPECT_FALSE(shape.closed);
  ASSERT_FALSE(shape.border.empty());
  expect_on_border(joint, Vector3d::UnitX(), shape.border.front());
  expect_on_border(joint, Vector3d::UnitX(), shape.border.back());
}

TEST(LimitShape, AnAxisAlongTheBoneIsATwist) {
  RigJoint joint;  // an elbow: flexion and the forearm's rotation
  joint.type = JointType::universal;
  joint.axes = {-Vector3d::UnitY(), Vector3d::UnitX(), Vector3d::UnitZ()};
  joint.limits = {Range{0.0, 2.5}, Range{-1.4, 1.3}, Range{}};
  const LimitShape shape = limit_shape(joint, Vector3d::UnitX());
  EXPECT_FALSE(shape.closed);
  EXPECT_NEAR(shape.border.back().dot(Vector3d::UnitX()), std::cos(2.5), 1e-12);
  EXPECT_EQ(shape.twist.max, 1.3);
}

TEST(RigSheet, WhatDoesNotFitIsAnError) {
  Rig rig;
  Character character;
  RigSheet sheet;
  EXPECT_EQ(render_rig_sheet(sheet).error().code, "sheet-input");
  sheet.rig = &rig;
  sheet.character = &character;
  sheet.joint_of_row = {0};
  EXPECT_EQ(render_rig_sheet(sheet).error().code, "sheet-input");
}

}  // namespace
}  // namespace limber
