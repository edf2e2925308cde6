#include "validation/ceres_refiner.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "tests/validation/zoo.h"
#include "validation/effector_problem.h"

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;
using namespace test;  // NOLINT

void expect_jacobian_meets_differences(const Rig& rig) {
  ASSERT_TRUE(validate(rig).ok());
  std::mt19937 random(17);
  for (const double reach : {0.05, 0.5, 0.95}) {  // both charts of the swing disc
    for (int trial = 0; trial < 20; ++trial) {
      std::vector<EffectorTarget> targets = targets_at(rig, random_pose(rig, random, 0.8));
      targets[1].weight = 0.4;
      EffectorProblem problem(rig, targets);
      problem.chart().start_from(random_pose(rig, random, reach));
      Eigen::VectorXd residual, ahead, behind;
      Eigen::MatrixXd jacobian;
      // Away from the reference of the unlimited rotations, too.
      Eigen::VectorXd x = problem.chart().x();
      x.segment<3>(3) += Vector3d(0.2, -0.3, 0.1);
      x.tail<3>() += Vector3d(-0.1, 0.3, 0.2);
      problem.evaluate(x, residual, &jacobian);
      const double h = 1e-6;
      for (Eigen::Index k = 0; k < x.size(); ++k) {
        Eigen::VectorXd moved = x;
        moved[k] = x[k] + h;
        problem.evaluate(moved, ahead, nullptr);
        moved[k] = x[k] - h;
        problem.evaluate(moved, behind, nullptr);
        const Eigen::VectorXd slope = (ahead - behind) / (2.0 * h);
        EXPECT_LT((slope - jacobian.col(k)).cwiseAbs().maxCoeff(), 2e-8)
            << "coordinate " << k << " reach " << reach;
      }
    }
  }
}

TEST(EffectorProblem, JacobianMeetsFiniteDifferences) {
  expect_jacobian_meets_differences(zoo());
  expect_jacobian_meets_differences(joined_zoo());
}

TEST(CeresRefiner, FindsLittleToGainOnTheSolversAnswersWithRows) {
  // Shared objective, other method: relative targets out of reach, couplings kept.
  const Rig rig = joined_zoo();
  std::mt19937 random(41);
  Result<IkSolver> solver = IkSolver::create(
      rig, {.stop_at_tolerance = false, .stop_cost_decrease = 1e-10, .max_relinearisations = 300});
  ASSERT_TRUE(solver.ok());
  std::vector<double> gaps;
  for (int trial = 0; trial < 15; ++trial) {
    std::vector<DualQuaternion> pose = random_pose(rig, random, 0.7);
    std::vector<EffectorTarget> targets = targets_at(rig, pose);
    for (EffectorTarget& t : targets) {
      t.pose = t.pose * DualQuaternion::from_rotation_translation(random_rotation(random, 0.1),
                                                                  Vector3d(0.05, 0.02, -0.04));
    }
    const IkReport ours = solver->solve(targets, pose);
    EXPECT_LT(ours.row_violation, 1e-5) << trial;
    EXPECT_NEAR(ours.cost, EffectorProblem(rig, targets).cost_of_pose(pose), 1e-9 * ours.cost);
    const auto report = refine_with_ceres(rig, targets, pose, {.max_iterations = 100});
    ASSERT_TRUE(report.ok());
    gaps.push_back(report->gap_percent);
  }
  std::sort(gaps.begin(), gaps.end());
  EXPECT_LT(gaps[gaps.size() / 2], 0.1);
}

TEST(CeresRefiner, SaysWhatItsObjectiveLacks) {
  Rig rig = zoo();
  rig.effectors[1].priority = 1;
  std::mt19937 random(43);
  std::vector<DualQuaternion> pose = random_pose(rig, random, 0.5);
  EXPECT_EQ(refine_with_ceres(rig, targets_at(rig, pose), pose).error().code, "refine-rows");
  rig = zoo();
  rig.couplings = {{4, 0, 3, 1, 1.0, 0.0}};
  EXPECT_EQ(refine_with_ceres(rig, targets_at(rig, pose), pose).error().code, "refine-rows");
}

TEST(EffectorProblem, CostIsTheSumOfTheWeightedSquares) {
  // One free joint: 3 cm off, turned by 0.2 rad, weights 1.3 and 0.7, target weight 0.5.
  Rig rig;
  rig.joints = {joint("root", kNoJoint, JointType::free, {0, 0, 0})};
  RigEffector e;
  e.weight_pos = 1.3;
  e.weight_rot = 0.7;
  rig.effectors = {e};
  const std::vector<EffectorTarget> targets = {
      {DualQuaternion::from_rotation_translation(rotation_exp(Vector3d(0, 0.2, 0)),
                                                 Vector3d(0.03, 0, 0)),
       0.5}};
  const std::vector<DualQuaternion> pose = {DualQuaternion::identity()};
  const EffectorProblem problem(rig, targets);
  const double by_hand = std::pow(0.65 * 0.03, 2) + std::pow(0.1 * 0.35 * 0.2, 2);
  EXPECT_NEAR(problem.cost_of_pose(pose), by_hand, 1e-15);
}

TEST(EffectorProblem, CostIsTheSolversCost) {
  const Rig rig = zoo();
  std::mt19937 random(19);
  for (int trial = 0; trial < 50; ++trial) {
    std::vector<EffectorTarget> targets = targets_at(rig, random_pose(rig, random, 1.0));
    targets[3].weight = 0.3;
    const std::vector<DualQuaternion> pose = random_pose(rig, random, 1.0);
    const double cost = EffectorProblem(rig, targets).cost_of_pose(pose);
    EXPECT_NEAR(effector_cost(rig, targets, pose), cost, 1e-12 * cost);
  }
}

TEST(CeresRefiner, AgreesWithTheSolverOnWhatLimitsAllow) {
  // Both start from the same pose; neither may beat the other by much where targets are in reach.
  const Rig rig = zoo();
  std::mt19937 random(37);
  auto solver = IkSolver::create(rig);
  ASSERT_TRUE(solver.ok());
  for (int trial = 0; trial < 20; ++trial) {
    const std::vector<DualQuaternion> truth = random_pose(rig, random, 0.9);
    const std::vector<EffectorTarget> targets = targets_at(rig, truth);
    std::vector<DualQuaternion> pose = truth;
    for (std::size_t i = 0; i < pose.size(); ++i) {
      if (rig.joints[i].type == JointType::fixed) continue;
      pose[i] = pose[i] * DualQuaternion::from_rotation(random_rotation(random, 0.03));
    }
    solver->solve(targets, pose);
    EXPECT_LT(worst_excess(rig, pose), 1e-5 * M_PI / 180.0);
    const auto report = refine_with_ceres(rig, targets, pose);
    ASSERT_TRUE(report.ok());
    EXPECT_LT(report->cost_before, 1e-5) << "trial " << trial;
    EXPECT_LT(report->cost_after, 1e-12) << "trial " << trial;
  }
}

TEST(CeresRefiner, ReachableTargetsAreReachedFromANearbyPose) {
  const Rig rig = zoo();
  std::mt19937 random(23);
  for (int trial = 0; trial < 30; ++trial) {
    const std::vector<DualQuaternion> truth = random_pose(rig, random, 0.8);
    const std::vector<EffectorTarget> targets = targets_at(rig, truth);
    std::vector<DualQuaternion> pose = truth;
    for (std::size_t i = 0; i < pose.size(); ++i) {
      if (rig.joints[i].type == JointType::fixed) continue;
      pose[i] = pose[i] * DualQuaternion::from_rotation(random_rotation(random, 0.05));
    }
    const auto report = refine_with_ceres(rig, targets, pose);
    ASSERT_TRUE(report.ok());
    EXPECT_LT(report->cost_after, 1e-14) << "trial " << trial;
    EXPECT_GT(report->cost_before, 1e-6);
    EXPECT_LT(worst_excess(rig, pose), 1e-12);
  }
}

TEST(CeresRefiner, AnswerIsWithinLimitsAndNeverWorse) {
  const Rig rig = zoo();
  std::mt19937 random(29);
  for (int trial = 0; trial < 40; ++trial) {
    std::vector<EffectorTarget> targets = targets_at(rig, random_pose(rig, random, 1.0));
    for (EffectorTarget& t : targets) {  // out of reach, often against several limits
      t.pose = t.pose * DualQuaternion::from_rotation_translation(random_rotation(random, 0.7),
                                                                  Vector3d(0.3, 0.1, -0.2));
    }
    std::vector<DualQuaternion> pose = random_pose(rig, random, 1.0);
    const EffectorProblem problem(rig, targets);
    const double before = problem.cost_of_pose(pose);
    const auto report = refine_with_ceres(rig, targets, pose);
    ASSERT_TRUE(report.ok());
    EXPECT_DOUBLE_EQ(report->cost_before, before);
    EXPECT_NEAR(report->cost_after, problem.cost_of_pose(pose), 1e-12 * before);
    EXPECT_LE(report->cost_after, before);
    EXPECT_GE(report->gap_percent, 0.0);
    EXPECT_LT(worst_excess(rig, pose), 1e-12);
    EXPECT_LE(report->iterations, RefineOptions{}.max_iterations);
  }
}

/// Shoulder with a small swing ellipse and a limited elbow, a position target.
Rig two_joints() {
  Rig rig;
  rig.joints = {joint("shoulder", kNoJoint, JointType::ball, {0, 0, 0}),
                joint("elbow", 0, JointType::hinge, {0, 0, 0.3})};
  rig.joints[0].limits = {Range{-0.5, 0.9}, Range{-0.7, 0.3}, Range{-0.4, 0.6}};
  rig.joints[1].limits[0] = {0.1, 1.2};
  RigEffector e;
  e.joint = 1;
  e.offset = {0, 0, 0.25};
  e.kind = EffectorKind::position;
  rig.effectors = {e};
  return rig;
}

TEST(CeresRefiner, AgreesWithBruteForceOnALimitedArm) {
  const Rig rig = two_joints();
  std::mt19937 random(31);
  std::normal_distribution<double> normal;
  RefineOptions options;
  options.max_iterations = 100;
  int on_limit = 0;
  for (int trial = 0; trial < 8; ++trial) {
    const Vector3d goal = 0.45 * Vector3d(normal(random), normal(random), 1.0).normalized();
    const std::vector<EffectorTarget> targets = {{DualQuaternion::from_translation(goal), 1.0}};
    // Brute force: polar grid over the ellipse, grid over twist and elbow, then finer around the
    // best, eight times.
    double centre[4] = {0.5, 0.0, 0.1, 0.65}, width[4] = {0.5, M_PI, 0.5, 0.55}, best = 1e9;
    for (int level = 0; level < 14; ++level) {
      double found[4] = {centre[0], centre[1], centre[2], centre[3]};
      for (int n = 0; n < 11 * 11 * 11 * 11; ++n) {
        const int step[4] = {n % 11, n / 11 % 11, n / 121 % 11, n / 1331};
        double v[4];
        for (int k = 0; k < 4; ++k) v[k] = centre[k] + width[k] * (step[k] - 5) / 5.0;
        v[0] = std::clamp(v[0], 0.0, 1.0);
        v[2] = std::clamp(v[2], -0.4, 0.6);
        v[3] = std::clamp(v[3], 0.1, 1.2);
        const double c = v[0] * std::cos(v[1]), s = v[0] * std::sin(v[1]);
        const Vector3d swing(c * (c < 0 ? 0.5 : 0.9), s * (s < 0 ? 0.7 : 0.3), 0.0);
        const Vector3d tip =
            rotation_exp(swing) * rotation_exp(Vector3d(0, 0, v[2])) *
            (Vector3d(0, 0, 0.3) + rotation_exp(Vector3d(v[3], 0, 0)) * Vector3d(0, 0, 0.25));
        const double cost = (tip - goal).squaredNorm();
        if (cost < best) {
          best = cost;
          std::copy(v, v + 4, found);
        }
      }
      std::copy(found, found + 4, centre);
      for (double& w : width) w *= 0.5;
    }
    std::vector<DualQuaternion> pose = {
        DualQuaternion::identity(), DualQuaternion::from_rotation_translation(
                                        rotation_exp(Vector3d(0.5, 0, 0)), Vector3d(0, 0, 0.3))};
    const auto report = refine_with_ceres(rig, targets, pose, options);
    ASSERT_TRUE(report.ok());
    EXPECT_NEAR(report->cost_after, best, 1e-5) << "trial " << trial;
    EXPECT_LT(report->cost_after, best + 1e-7) << "trial " << trial;
    on_limit += best > 1e-4;
  }
  EXPECT_GE(on_limit, 3) << "the trials must include targets that the limits forbid";
}

TEST(CeresRefiner, TheGapIsMeasuredAsStated) {
  const Rig rig = two_joints();
  std::vector<DualQuaternion> pose = {DualQuaternion::identity(),
                                      DualQuaternion::from_rotation_translation(
                                          rotation_exp(Vector3d(0.5, 0, 0)), Vector3d(0, 0, 0.3))};
  const std::vector<EffectorTarget> targets = targets_at(rig, pose);
  const auto solved = refine_with_ceres(rig, targets, pose);
  ASSERT_TRUE(solved.ok());
  EXPECT_EQ(solved->gap_percent, 0.0) << "two solved poses are equal, whatever their last digits";

  const std::vector<EffectorTarget> far = {
      {DualQuaternion::from_translation(Vector3d(2, 0, 0)), 1.0}};
  const auto gap = refine_with_ceres(rig, far, pose);
  ASSERT_TRUE(gap.ok());
  EXPECT_NEAR(gap->gap_percent, 100.0 * (gap->cost_before / gap->cost_after - 1.0), 1e-9);
  EXPECT_GT(gap->gap_percent, 1.0);
}

TEST(CeresRefiner, BadInputIsAnError) {
  const Rig rig = two_joints();
  std::vector<DualQuaternion> pose(2);
  EXPECT_EQ(refine_with_ceres(rig, {}, pose).error().code, "refine-input");
  std::vector<EffectorTarget> targets(1);
  targets[0].pose.dual.x() = std::nan("");
  EXPECT_EQ(refine_with_ceres(rig, targets, pose).error().code, "refine-input");
}

}  // namespace
}  // namespace limber
