// A rig written as ikrig/1 and read back is the rig.

#include "importers/rig_json.h"

#include <gtest/gtest.h>

#include "exporters/exporter.h"
#include "tests/exporters/support.h"

namespace limber::test {
namespace {

void expect_same(const Rig& a, const Rig& b) {
  EXPECT_EQ(a.name, b.name);
  EXPECT_EQ(a.description, b.description);
  ASSERT_EQ(a.joints.size(), b.joints.size());
  for (std::size_t i = 0; i < a.joints.size(); ++i) {
    const RigJoint &p = a.joints[i], &q = b.joints[i];
    SCOPED_TRACE(p.name);
    EXPECT_EQ(p.name, q.name);
    EXPECT_EQ(p.role, q.role);
    EXPECT_EQ(p.parent, q.parent);
    EXPECT_EQ(p.type, q.type);
    EXPECT_EQ(p.offset, q.offset);
    EXPECT_LT((p.rest.coeffs() - q.rest.coeffs()).norm(), 1e-15);
    EXPECT_EQ(p.citation, q.citation);
    EXPECT_EQ(p.weight, q.weight);
    EXPECT_EQ(p.max_speed, q.max_speed);
    for (int k = 0; k < 3; ++k) {
      EXPECT_LT((p.axes[k] - q.axes[k]).norm(), 1e-15);
      EXPECT_EQ(p.limits[k].min, q.limits[k].min);
      EXPECT_EQ(p.limits[k].max, q.limits[k].max);
    }
    ASSERT_EQ(p.capsules.size(), q.capsules.size());
    for (std::size_t c = 0; c < p.capsules.size(); ++c) {
      EXPECT_EQ(p.capsules[c].from, q.capsules[c].from);
      EXPECT_EQ(p.capsules[c].to, q.capsules[c].to);
      EXPECT_EQ(p.capsules[c].radius, q.capsules[c].radius);
    }
  }
  ASSERT_EQ(a.effectors.size(), b.effectors.size());
  for (std::size_t i = 0; i < a.effectors.size(); ++i) {
    const RigEffector &p = a.effectors[i], &q = b.effectors[i];
    EXPECT_EQ(p.name, q.name);
    EXPECT_EQ(p.joint, q.joint);
    EXPECT_EQ(p.offset, q.offset);
    EXPECT_EQ(p.kind, q.kind);
    EXPECT_LT((p.axis - q.axis).norm(), 1e-15);
    EXPECT_EQ(p.strong, q.strong);
    EXPECT_EQ(p.weight_pos, q.weight_pos);
    EXPECT_EQ(p.weight_rot, q.weight_rot);
    EXPECT_EQ(p.relative_to, q.relative_to);
    EXPECT_EQ(p.priority, q.priority);
  }
  ASSERT_EQ(a.couplings.size(), b.couplings.size());
  for (std::size_t i = 0; i < a.couplings.size(); ++i) {
    EXPECT_EQ(a.couplings[i].from_joint, b.couplings[i].from_joint);
    EXPECT_EQ(a.couplings[i].to_dof, b.couplings[i].to_dof);
    EXPECT_EQ(a.couplings[i].ratio, b.couplings[i].ratio);
    EXPECT_EQ(a.couplings[i].offset, b.couplings[i].offset);
  }
  ASSERT_EQ(a.collisions.size(), b.collisions.size());
  for (std::size_t i = 0; i < a.collisions.size(); ++i) {
    EXPECT_EQ(a.collisions[i].joint_a, b.collisions[i].joint_a);
    EXPECT_EQ(a.collisions[i].joint_b, b.collisions[i].joint_b);
  }
}

Rig rig_of_every_kind() {
  Rig rig;
  rig.name = "all \"kinds\"";
  rig.description = "one joint of each type";
  const Eigen::Quaterniond turn(Eigen::AngleAxisd(0.3, Eigen::Vector3d(1, 2, 3).normalized()));
  for (const JointType type : {JointType::free, JointType::ball, JointType::universal,
                               JointType::hinge, JointType::fixed, JointType::ball}) {
    RigJoint joint;
    joint.name = "joint" + std::to_string(rig.size());
    joint.parent = rig.size() - 1;
    joint.type = type;
    joint.offset = {0.1 / 3.0, 0.2, -0.3};
    joint.rest = turn;
    if (type != JointType::free && type != JointType::fixed && rig.size() < 5) {
      for (int k = 0; k < 3 && k < dof_count(type); ++k) joint.limits[k] = {-0.1 - k, 1.0 / 3 + k};
      joint.citation = "made up";
      joint.capsules = {{{0, 0, 0}, {0.1, 0, 0}, 0.03}, {{0, 0.1, 0}, {0, 0, 0.2}, 0.04}};
    }
    rig.joints.push_back(joint);  // the last ball has no limits
  }
  rig.joints[1].role = "hips";
  rig.effectors = {{"tip", 4, {0.1, 0, 0}, EffectorKind::pose, {1, 0, 0}, true, 1.0, 0.5},
                   {"gaze", 5, {0, 0, 0}, EffectorKind::line, {0, 0, 1}, false, 0.2, 0.0},
                   {"eyes", 5, {0, 0.1, 0}, EffectorKind::gaze, {0, 0.6, 0.8}, false, 0.0, 0.5}};
  rig.effectors[1].relative_to = 2;
  rig.effectors[1].priority = 1;
  rig.joints[3].weight = 2.5;
  rig.joints[3].max_speed = 7.0;
  rig.couplings = {{3, 0, 2, 1, 0.7, -0.1}};
  rig.collisions = {{1, 3}, {0, 2}};
  return rig;
}

TEST(RigJson, EveryFieldSurvives) {
  const Rig rig = rig_of_every_kind();
  ASSERT_TRUE(validate(rig).ok());
  const auto back = read_rig_json(write_rig_json(rig));
  ASSERT_TRUE(back.ok()) << back.error().message;
  expect_same(rig, *back);
}

TEST(RigJson, ShippedRigsSurvive) {
  int rigs = 0;
  for (const auto& entry : std::filesystem::directory_iterator(
           std::filesystem::path(LIMBER_SOURCE_DIR) / "assets/data/rigs")) {
    if (entry.path().string().ends_with(".schema.json")) continue;
    SCOPED_TRACE(entry.path().filename().string());
    const auto rig = read_rig_json(read_text(entry.path()));
    ASSERT_TRUE(rig.ok()) << rig.error().message;
    const auto back = read_rig_json(write_rig_json(*rig));
    ASSERT_TRUE(back.ok()) << back.error().message;
    expect_same(*rig, *back);
    ++rigs;
  }
  EXPECT_GE(rigs, 7);
}

}  // namespace
}  // namespace limber::test
