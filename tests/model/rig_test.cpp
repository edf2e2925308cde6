#include "assets/model/rig.h"

#include <gtest/gtest.h>

#include "tests/model/random_motion.h"

namespace limber {
namespace {

/// One joint of every type, in a chain, limits on.
Rig all_types(test::Random& random) {
  Rig rig;
  const JointType types[] = {JointType::free, JointType::ball, JointType::universal,
                             JointType::hinge, JointType::fixed};
  for (const JointType type : types) {
    RigJoint joint;
    joint.name = to_string(type);
    joint.parent = rig.size() - 1;
    joint.type = type;
    joint.offset = random.vector();
    joint.rest = random.rotation();
    const Eigen::Matrix3d triad = random.rotation().toRotationMatrix();
    for (int k = 0; k < 3; ++k) joint.axes[k] = triad.col(k);
    if (type != JointType::free && type != JointType::fixed) {
      for (Range& range : joint.limits) range = {-1.0, 1.2};
    }
    rig.joints.push_back(joint);
  }
  return rig;
}

TEST(Rig, CoordinatesGoThereAndBack) {
  test::Random random(41);
  for (int trial = 0; trial < 50; ++trial) {
    const Rig rig = all_types(random);
    ASSERT_TRUE(validate(rig).ok());
    ASSERT_EQ(dof_count(rig), 12);
    std::vector<double> q(12), back(12);
    for (double& x : q) x = random.uniform(-1.5, 1.5);
    Pose pose(rig.joints.size());
    pose_from_coordinates(rig, q, pose);
    coordinates_from_pose(rig, pose, back);
    for (int k = 0; k < 12; ++k) EXPECT_NEAR(back[k], q[k], 1e-12) << k;
    for (DualQuaternion& local : pose) local = -local;
    coordinates_from_pose(rig, pose, back);
    for (int k = 0; k < 12; ++k) EXPECT_NEAR(back[k], q[k], 1e-12) << k;
  }
}

TEST(Rig, PoseFollowsTheDefinition) {
  test::Random random(42);
  const Rig rig = all_types(random);
  const std::vector<double> q{0.1, -0.2, 0.3, 0.4, 0.1, -0.5, 0.2, 0.7, -0.6, 0.5, -0.9, 0.8};
  Pose pose(rig.joints.size());
  pose_from_coordinates(rig, q, pose);
  const auto vector_turn = [](double x, double y, double z) {
    const Eigen::Vector3d v(x, y, z);
    return Eigen::Quaterniond(Eigen::AngleAxisd(v.norm(), v.normalized()));
  };
  const auto about = [](double angle, const Eigen::Vector3d& axis) {
    return Eigen::Quaterniond(Eigen::AngleAxisd(angle, axis));
  };
  const Eigen::Quaterniond expected[] = {
      vector_turn(q[3], q[4], q[5]), vector_turn(q[6], q[7], q[8]),
      about(q[9], rig.joints[2].axes[0]) * about(q[10], rig.joints[2].axes[1]),
      about(q[11], rig.joints[3].axes[0]), Eigen::Quaterniond::Identity()};
  for (int i = 0; i < 5; ++i) {
    EXPECT_LT(rotation_angle(pose[i].rotation(), rig.joints[i].rest * expected[i]), 1e-12) << i;
    const Eigen::Vector3d slide =
        i == 0 ? Eigen::Vector3d(q[0], q[1], q[2]) : Eigen::Vector3d::Zero();
    EXPECT_LT((pose[i].translation() - rig.joints[i].offset - slide).norm(), 1e-14) << i;
  }
}

TEST(Rig, UniversalAnglesAreTheNearestOfAnyRotation) {
  test::Random random(43);
  Rig rig = all_types(random);
  rig.joints = {rig.joints[2]};
  rig.joints[0].parent = kNoJoint;
  rig.joints[0].rest = Eigen::Quaterniond::Identity();
  for (int trial = 0; trial < 20; ++trial) {
    const Eigen::Quaterniond rotation = random.small_rotation(1.5);
    Pose pose{DualQuaternion::from_rotation_translation(rotation, rig.joints[0].offset)};
    std::vector<double> q(2);
    coordinates_from_pose(rig, pose, q);
    const auto apart = [&](double a, double b) {
      Pose candidate(1);
      pose_from_coordinates(rig, std::vector<double>{a, b}, candidate);
      return rotation_angle(candidate[0].rotation(), rotation);
    };
    const double best = apart(q[0], q[1]);
    for (int i = 0; i < 200; ++i) {
      const double scale = i < 100 ? 3.0 : 1e-3;
      EXPECT_GE(apart(q[0] + random.uniform(-scale, scale), q[1] + random.uniform(-scale, scale)),
                best - 1e-12);
    }
  }
}

TEST(Rig, EveryInvariantIsChecked) {
  test::Random random(44);
  const Rig good = all_types(random);
  const auto refused = [](const Rig& rig) {
    const auto result = validate(rig);
    return !result.ok() && result.error().code == "rig-invalid";
  };
  EXPECT_TRUE(refused({}));
  const auto broken = [&](auto&& breaker) {
    Rig rig = good;
    breaker(rig);
    return refused(rig);
  };
  EXPECT_TRUE(broken([](Rig& r) { r.joints[2].parent = 2; }));
  EXPECT_TRUE(broken([](Rig& r) { r.joints[2].name = r.joints[1].name; }));
  EXPECT_TRUE(broken([](Rig& r) { r.joints[3].axes[0] *= 2.0; }));
  EXPECT_TRUE(broken([](Rig& r) { r.joints[1].axes[2] *= -1.0; }));
  EXPECT_TRUE(broken([](Rig& r) { r.joints[2].axes[1] = r.joints[2].axes[0]; }));
  EXPECT_TRUE(broken([](Rig& r) { r.joints[3].limits[0] = {1.0, 0.0}; }));
  EXPECT_TRUE(broken([](Rig& r) { r.joints[1].limits[0] = {0.1, 0.5}; }));
  EXPECT_TRUE(broken([](Rig& r) { r.joints[1].limits[2] = Range{}; }));
  EXPECT_TRUE(broken([](Rig& r) { r.joints[3].offset.x() = std::nan(""); }));
  EXPECT_TRUE(broken([](Rig& r) { r.effectors.push_back({.name = "e", .joint = 9}); }));
}

}  // namespace
}  // namespace limber
