#include "assets/model/skeleton.h"

#include <gtest/gtest.h>

#include "tests/model/random_motion.h"

namespace limber {
namespace {

Skeleton random_tree(test::Random& random, int joints) {
  Skeleton skeleton;
  for (int i = 0; i < joints; ++i) {
    skeleton.names.push_back("joint" + std::to_string(i));
    skeleton.parents.push_back(i == 0 ? kNoJoint : random.integer(-1, i - 1));
    skeleton.rest_parent_from_joint.push_back(random.motion());
  }
  return skeleton;
}

TEST(Skeleton, ForwardKinematicsIsTheProductOfMatricesUpTheChain) {
  test::Random random(21);
  for (int trial = 0; trial < 10; ++trial) {
    const Skeleton skeleton = random_tree(random, 12);
    std::vector<DualQuaternion> local, model(12);
    for (int i = 0; i < 12; ++i) local.push_back(random.motion());
    model_from_local(skeleton, local, model);
    for (int i = 0; i < 12; ++i) {
      Eigen::Matrix4d expected = Eigen::Matrix4d::Identity();
      for (int j = i; j != kNoJoint; j = skeleton.parents[j]) {
        expected = local[j].matrix() * expected;
      }
      EXPECT_LT((model[i].matrix() - expected).norm(), 1e-12);
    }
  }
}

TEST(Skeleton, LocalFromModelIsTheInverseAndBothWorkInPlace) {
  test::Random random(22);
  const Skeleton skeleton = random_tree(random, 20);
  std::vector<DualQuaternion> local;
  for (int i = 0; i < 20; ++i) local.push_back(random.motion());
  std::vector<DualQuaternion> there = local;
  model_from_local(skeleton, there, there);
  local_from_model(skeleton, there, there);
  for (int i = 0; i < 20; ++i) EXPECT_LT((there[i].matrix() - local[i].matrix()).norm(), 1e-12);
}

TEST(Skeleton, EveryInvariantIsChecked) {
  test::Random random(23);
  const Skeleton good = random_tree(random, 5);
  EXPECT_TRUE(validate(good).ok());
  const auto refused = [](const Skeleton& skeleton) {
    const auto result = validate(skeleton);
    return !result.ok() && result.error().code == "skeleton-invalid";
  };
  EXPECT_TRUE(refused({}));
  Skeleton bad = good;
  bad.parents[2] = 2;
  EXPECT_TRUE(refused(bad));
  bad = good;
  bad.parents[1] = -2;
  EXPECT_TRUE(refused(bad));
  bad = good;
  bad.names[3] = bad.names[0];
  EXPECT_TRUE(refused(bad));
  bad = good;
  bad.names[3].clear();
  EXPECT_TRUE(refused(bad));
  bad = good;
  bad.names.pop_back();
  EXPECT_TRUE(refused(bad));
  bad = good;
  bad.rest_parent_from_joint[4].real.w() = std::nan("");
  EXPECT_TRUE(refused(bad));
  bad = good;
  bad.rest_parent_from_joint[4] = 1.01 * bad.rest_parent_from_joint[4];
  EXPECT_TRUE(refused(bad));
  bad = good;  // r.d must vanish
  bad.rest_parent_from_joint[4].dual.coeffs() += 0.1 * bad.rest_parent_from_joint[4].real.coeffs();
  EXPECT_TRUE(refused(bad));
}

TEST(Skeleton, ChildrenAndNames) {
  Skeleton skeleton;
  skeleton.names = {"root", "left", "right", "tip"};
  skeleton.parents = {kNoJoint, 0, 0, 2};
  skeleton.rest_parent_from_joint.resize(4);
  const auto children = children_of(skeleton);
  EXPECT_EQ(children[0], (std::vector<std::int32_t>{1, 2}));
  EXPECT_EQ(children[2], (std::vector<std::int32_t>{3}));
  EXPECT_TRUE(children[3].empty());
  EXPECT_EQ(skeleton.find("right"), 2);
  EXPECT_EQ(skeleton.find("nobody"), kNoJoint);
}

}  // namespace
}  // namespace limber
