// The peers move and see what Limber moves and sees, and what they answer obeys the limits.
#include <gtest/gtest.h>

#include <algorithm>

#include "tests/bench/peers/contest.h"
#include "tests/bench/peers/entries.h"
#include "tests/bench/peers/kinematics.h"
#include "tests/solver/test_rigs.h"
#include "validation/limit_check.h"

namespace limber::peers {
namespace {

using test::Random;

const char* const kRigs[] = {"arm3", "hand", "biped-full", "biped-hands"};

std::vector<std::unique_ptr<Kinematics>> all_kinematics(const Coordinates& coordinates) {
  std::vector<std::unique_ptr<Kinematics>> all;
  all.push_back(std::make_unique<PlainKinematics>(coordinates));
  if (has_mujoco()) all.push_back(mujoco_kinematics(coordinates));
  return all;
}

/// Allowed poses of the rig, each a step from the last, and targets that they reach; `stretch`
/// moves every target away from the root.
Workload small_workload(const std::string& rig_name, bool rest_start, double stretch) {
  Random random(7);
  Workload work;
  work.name = rig_name;
  work.rig = test::shipped_rig(rig_name);
  work.rest_start = rest_start;
  const auto ndof = static_cast<std::size_t>(dof_count(work.rig));
  Pose pose = test::allowed_pose(random, work.rig, 0.9);
  const Pose goal = test::allowed_pose(random, work.rig, 0.9);
  for (int f = 0; f < 4; ++f) {
    Pose here = pose;
    for (std::size_t i = 0; i < pose.size(); ++i) here[i] = sclerp(pose[i], goal[i], 0.02 * f);
    project_into_limits(work.rig, here);
    work.truth_q.emplace_back(ndof);
    coordinates_from_pose(work.rig, here, work.truth_q.back());
    work.targets.push_back(test::targets_at(work.rig, here));
    for (EffectorTarget& target : work.targets.back()) {
      target.pose = DualQuaternion::from_rotation_translation(
          target.pose.rotation(), (1.0 + stretch) * target.pose.translation());
    }
  }
  return work;
}

TEST(PeerKinematics, AgreeWithForwardKinematics) {
  for (const char* const name : kRigs) {
    Random random(3);
    const Rig rig = test::shipped_rig(name);
    const Result<Coordinates> coordinates = Coordinates::of(rig);
    ASSERT_TRUE(coordinates.ok()) << name;
    const Skeleton skeleton = skeleton_of(rig);
    Pose pose(rig.joints.size()), world(rig.joints.size());
    for (const auto& kinematics : all_kinematics(*coordinates)) {
      ASSERT_NE(kinematics, nullptr) << name;
      for (int trial = 0; trial < 20; ++trial) {
        pose = test::allowed_pose(random, rig, 0.99);
        kinematics->set(coordinates->from_pose(pose));
        model_from_local(skeleton, pose, world);
        for (std::size_t e = 0; e < rig.effectors.size(); ++e) {
          const DualQuaternion& joint = world[rig.effectors[e].joint];
          const Eigen::Vector3d point = joint.transform_point(rig.effectors[e].offset);
          EXPECT_LT((kinematics->position(e) - point).norm(), 1e-12) << name;
          EXPECT_LT(rotation_angle(kinematics->rotation(e), joint.rotation()), 1e-12) << name;
        }
      }
    }
  }
}

TEST(PeerKinematics, JacobiansAreTheDerivatives) {
  constexpr double kStep = 1e-6;
  for (const char* const name : kRigs) {
    Random random(5);
    const Rig rig = test::shipped_rig(name);
    const Result<Coordinates> coordinates = Coordinates::of(rig);
    ASSERT_TRUE(coordinates.ok()) << name;
    for (const auto& kinematics : all_kinematics(*coordinates)) {
      const State state = coordinates->from_pose(test::allowed_pose(random, rig, 0.9));
      for (std::size_t e = 0; e < rig.effectors.size(); ++e) {
        const auto& chain = kinematics->chain(e);
        ChainJacobian jacobian(6, static_cast<Eigen::Index>(chain.size()));
        kinematics->set(state);
        kinematics->prepare_jacobian(state);
        kinematics->jacobian(e, jacobian);
        for (std::size_t k = 0; k < chain.size(); ++k) {
          Eigen::Vector3d at[2];
          Eigen::Quaterniond turned[2];
          for (const int side : {0, 1}) {
            State moved = state;
            Eigen::VectorXd step = Eigen::VectorXd::Zero(coordinates->dofs());
            step[chain[k]] = side == 0 ? -kStep : kStep;
            coordinates->add(step, moved);
            kinematics->set(moved);
            at[side] = kinematics->position(e);
            turned[side] = kinematics->rotation(e);
          }
          const auto column = jacobian.col(static_cast<Eigen::Index>(k));
          const Eigen::Vector3d linear = (at[1] - at[0]) / (2.0 * kStep);
          const Eigen::Vector3d angular =
              rotation_log(Eigen::Quaterniond(turned[1] * turned[0].conjugate())) / (2.0 * kStep);
          EXPECT_LT((column.head<3>() - linear).norm(), 1e-8) << name;
          EXPECT_LT((column.tail<3>() - angular).norm(), 1e-8) << name;
        }
      }
    }
  }
}

TEST(PeerCoordinates, KeepPoses) {
  for (const char* const name : kRigs) {
    Random random(11);
    const Rig rig = test::shipped_rig(name);
    const Result<Coordinates> coordinates = Coordinates::of(rig);
    ASSERT_TRUE(coordinates.ok()) << name;
    const Pose pose = test::allowed_pose(random, rig, 0.99);
    Pose back(pose.size());
    coordinates->to_pose(coordinates->from_pose(pose), back);
    for (std::size_t i = 0; i < pose.size(); ++i) {
      EXPECT_LT(rotation_angle(pose[i].rotation(), back[i].rotation()), 1e-12) << name;
      EXPECT_LT((pose[i].translation() - back[i].translation()).norm(), 1e-12) << name;
    }
  }
}

class EveryContestant : public testing::TestWithParam<std::tuple<bool, double>> {};

TEST_P(EveryContestant, ObeysTheLimitsAndRepeatsItself) {
  const auto [rest_start, stretch] = GetParam();
  for (const char* const name : {"arm3", "hand", "biped-full"}) {
    const Workload work = small_workload(name, rest_start, stretch);
    const std::size_t frames = rest_start ? 2 : work.frames();
    for (const auto& contestant : all_contestants(work)) {
      const Result<void> ready = contestant->prepare(work);
      if (!ready) {
        EXPECT_FALSE(has_mujoco()) << contestant->name() << ready.error().message;
        continue;
      }
      const Answer answer = contestant->solve_all(frames);
      ASSERT_EQ(answer.us.size(), frames) << contestant->name();
      EXPECT_TRUE(validate(skeleton_of(work.rig), answer.clip).ok()) << contestant->name();
      const LimitReport limits = check_joint_limits(work.rig, answer.clip, 1e-9);
      EXPECT_EQ(limits.violations, 0) << contestant->name() << " on " << name;
      const Answer again = contestant->solve_all(frames);
      for (std::size_t i = 0; i < answer.clip.parent_from_joint.size(); ++i) {
        EXPECT_EQ(answer.clip.parent_from_joint[i].real.coeffs(),
                  again.clip.parent_from_joint[i].real.coeffs())
            << contestant->name();
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Targets, EveryContestant,
                         testing::Values(std::tuple(false, 0.0),    // a motion within reach
                                         std::tuple(true, 0.0),     // lone poses
                                         std::tuple(false, 0.3)));  // targets beyond reach

/// A peer that is no straw man solves what ours solves.
TEST(Contest, SecondOrderPeersSolveAMotionWithinReach) {
  const Workload work = small_workload("biped-full", false, 0.0);
  auto contestants = all_contestants(work);
  std::erase_if(contestants, [](const auto& contestant) {
    return !contestant->ours() && contestant->name().find("DLS by chains") == std::string::npos;
  });
  for (const Score& score : hold_contest(work, contestants, {.rounds = 1})) {
    if (!score.absent.empty()) continue;
    EXPECT_EQ(score.success, 1.0) << score.name;
    EXPECT_EQ(score.violations, 0) << score.name;
    EXPECT_EQ(score.frames, work.frames()) << score.name;
  }
}

}  // namespace
}  // namespace limber::peers
