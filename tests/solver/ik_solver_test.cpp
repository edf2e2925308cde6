#include "solver/ik_solver.h"

#include <gtest/gtest.h>

#include "solver/swing_twist.h"
#include "tests/solver/allocation_count.h"
#include "tests/solver/test_rigs.h"

namespace limber {
namespace {

using Eigen::Vector3d;
using test::make_solver;
using test::Random;
using test::rest_pose;

constexpr double kAllowed = 1e-5 * M_PI / 180.0;  // rad

/// A pose a little away from another, within limits.
Pose nudged(Random& random, const Rig& rig, const Pose& pose, double angle) {
  Pose out = pose;
  for (std::size_t i = 0; i < out.size(); ++i) {
    out[i] = DualQuaternion::from_rotation_translation(
        out[i].rotation() * random.small_rotation(angle), out[i].translation());
  }
  project_into_limits(rig, out);
  return out;
}

class ShippedRigs : public testing::TestWithParam<const char*> {};

TEST_P(ShippedRigs, ReachesNearbyPosesWithinLimits) {
  const Rig rig = test::shipped_rig(GetParam());
  Random random(1);
  IkSolver solver = make_solver(rig);
  int reached = 0;
  for (int trial = 0; trial < 50; ++trial) {
    const Pose truth = test::allowed_pose(random, rig, 0.95);
    const auto targets = test::targets_at(rig, truth);
    Pose pose = nudged(random, rig, truth, 0.05);
    const double before = test::objective(rig, targets, pose);
    const IkReport report = solver.solve(targets, pose);
    EXPECT_LT(test::worst_excess(rig, pose), kAllowed);
    EXPECT_LE(test::objective(rig, targets, pose), before + 1e-15);
    EXPECT_NEAR(test::objective(rig, targets, pose), report.cost, 1e-12 + 1e-6 * report.cost);
    reached += report.reached;
  }
  EXPECT_GE(reached, 49);
}

INSTANTIATE_TEST_SUITE_P(All, ShippedRigs,
                         testing::Values("hand", "biped", "biped-foot-root", "biped-full",
                                         "biped-hands", "arm2", "arm3"));

TEST(IkSolver, RandomRigsAndTargetsKeepLimitsAndNeverGetWorse) {
  Random random(2);
  for (const IkMethod method : {IkMethod::pgs, IkMethod::pgs_paper}) {
    for (int trial = 0; trial < 150; ++trial) {
      const Rig rig = test::random_rig(random, 12, 8);
      IkSolver solver = make_solver(rig, {.method = method});
      auto targets = test::targets_at(rig, test::allowed_pose(random, rig));
      for (EffectorTarget& target : targets) {
        if (random.integer(0, 3) == 0) target.pose = random.motion();  // likely out of reach
        target.weight = random.uniform(0.0, 2.0);
      }
      Pose pose = test::allowed_pose(random, rig);
      const double before = test::objective(rig, targets, pose);
      const IkReport report = solver.solve(targets, pose);
      EXPECT_LT(test::worst_excess(rig, pose), 1e-7);
      const double after = test::objective(rig, targets, pose);
      EXPECT_LE(after, before * (1.0 + 1e-9) + 1e-12);
      EXPECT_NEAR(after, report.cost, 1e-9 + 1e-6 * after);
    }
  }
}

TEST(IkSolver, StartsOutsideTheLimitsAreAllowed) {
  Random random(3);
  const Rig rig = test::shipped_rig("biped-full");
  IkSolver solver = make_solver(rig);
  for (int trial = 0; trial < 20; ++trial) {
    Pose pose;
    for (int i = 0; i < rig.size(); ++i) pose.push_back(random.motion());
    solver.solve(test::targets_at(rig, test::allowed_pose(random, rig)), pose);
    EXPECT_LT(test::worst_excess(rig, pose), kAllowed);
  }
}

TEST(IkSolver, WhatIsReachedAndAllowedStaysBitForBit) {
  Random random(4);
  const Rig rig = test::shipped_rig("biped-full");
  IkSolver solver = make_solver(rig);
  const Pose pose = test::allowed_pose(random, rig, 0.99);
  Pose out = pose;
  const IkReport report = solver.solve(test::targets_at(rig, pose), out);
  EXPECT_EQ(report.relinearisations, 0);
  EXPECT_TRUE(report.converged && report.reached);
  for (std::size_t i = 0; i < pose.size(); ++i) {
    EXPECT_EQ(out[i].real.coeffs(), pose[i].real.coeffs());
    EXPECT_EQ(out[i].dual.coeffs(), pose[i].dual.coeffs());
  }
}

/// First-order optimality in the limits, found by trying: no small allowed change of one or more
/// joints lowers the cost by more than second order.
double best_small_gain(Random& random, const Rig& rig, const std::vector<EffectorTarget>& targets,
                       const Pose& pose, double size) {
  const double here = test::objective(rig, targets, pose);
  double gain = 0.0;
  for (int i = 0; i < 400; ++i) {
    Pose other = pose;
    const int joint = random.integer(0, rig.size() - 1);
    const bool all = i % 4 == 0;
    for (int j = all ? 0 : joint; j <= (all ? rig.size() - 1 : joint); ++j) {
      const Vector3d slide = rig.joints[j].type == JointType::free ? Vector3d(random.vector(size))
                                                                   : Vector3d(Vector3d::Zero());
      other[j] = DualQuaternion::from_rotation_translation(
          other[j].rotation() * random.small_rotation(size), other[j].translation() + slide);
    }
    project_into_limits(rig, other);
    gain = std::max(gain, here - test::objective(rig, targets, other));
  }
  return gain;
}

TEST(IkSolver, OutOfReachEndsAtAPointNoSmallMoveImproves) {
  Random random(5);
  for (const char* name : {"hand", "arm3", "biped-full"}) {
    const Rig rig = test::shipped_rig(name);
    IkSolver solver = make_solver(
        rig,
        {.stop_at_tolerance = false, .stop_cost_decrease = 1e-12, .max_relinearisations = 400});
    for (int trial = 0; trial < 4; ++trial) {
      auto targets = test::targets_at(rig, test::allowed_pose(random, rig, 0.8));
      for (EffectorTarget& target : targets) {
        target.pose = DualQuaternion::from_translation(1.5 * random.unit()) * target.pose;
      }
      Pose pose = rest_pose(rig);
      const IkReport report = solver.solve(targets, pose);
      EXPECT_GT(report.cost, 1e-4);
      EXPECT_LT(report.residual, 1e-5);
      const double size = 1e-4;
      EXPECT_LT(best_small_gain(random, rig, targets, pose, size), 1e-3 * size) << name;
      // Stable: solving again from there changes nothing to speak of.
      Pose again = pose;
      solver.solve(targets, again);
      for (std::size_t i = 0; i < pose.size(); ++i) {
        EXPECT_LT(rotation_angle(pose[i].rotation(), again[i].rotation()), 1e-3);
      }
    }
  }
}

TEST(IkSolver, OutOfReachOnTheArmMeetsAFineSearch) {
  // Four degrees of freedom: the best reach can be searched without derivatives.
  Random random(6);
  const Rig rig = test::shipped_rig("arm2");
  IkSolver solver = make_solver(rig, {.stop_at_tolerance = false});
  for (int trial = 0; trial < 6; ++trial) {
    const Vector3d target = random.uniform(0.7, 1.2) * random.unit();
    const std::vector<EffectorTarget> targets{{.pose = DualQuaternion::from_translation(target)}};
    double least = 1e300;
    Pose best;
    for (int i = 0; i < 20000; ++i) {
      const Pose pose = test::allowed_pose(random, rig);
      const double cost = test::objective(rig, targets, pose);
      if (cost < least) least = cost, best = pose;
    }
    for (double size = 0.3; size > 1e-7; size *= 0.7) {
      for (int i = 0; i < 150; ++i) {
        const Pose pose = nudged(random, rig, best, size);
        const double cost = test::objective(rig, targets, pose);
        if (cost < least) least = cost, best = pose;
      }
    }
    // From the search's own basin, and never worse than it by more than it can resolve.
    Pose pose = nudged(random, rig, best, 0.2);
    const IkReport report = solver.solve(targets, pose);
    EXPECT_LT(report.cost, least * (1.0 + 1e-4) + 1e-9) << trial;
    EXPECT_GT(report.cost, least * (1.0 - 1e-3) - 1e-9) << trial;
  }
}

TEST(IkSolver, BothMethodsAgreeOnEasyProblems) {
  Random random(7);
  for (const char* name : {"arm3", "hand"}) {
    const Rig rig = test::shipped_rig(name);
    IkSolver pgs = make_solver(rig);
    IkSolver paper = make_solver(
        rig, {.method = IkMethod::pgs_paper, .max_relinearisations = 3000, .sweeps = 50});
    for (int trial = 0; trial < 10; ++trial) {
      const Pose truth = test::allowed_pose(random, rig, 0.7);
      const auto targets = test::targets_at(rig, truth);
      const Pose start = nudged(random, rig, truth, 0.03);
      Pose a = start, b = start;
      const IkReport by_pgs = pgs.solve(targets, a), by_paper = paper.solve(targets, b);
      EXPECT_TRUE(by_pgs.reached);
      EXPECT_TRUE(by_paper.reached);
      EXPECT_GT(by_paper.sweeps, 0);
      EXPECT_GT(by_pgs.tree_passes, 0);
      const Pose world_a = test::world_of(rig, a), world_b = test::world_of(rig, b);
      for (const RigEffector& effector : rig.effectors) {
        EXPECT_LT((world_a[effector.joint].transform_point(effector.offset) -
                   world_b[effector.joint].transform_point(effector.offset))
                      .norm(),
                  2.1e-4);
      }
    }
  }
}

TEST(IkSolver, SolvesAreDeterministicAndForgetEarlierOnes) {
  Random random(8);
  const Rig rig = test::shipped_rig("biped-full");
  IkSolver one = make_solver(rig), two = make_solver(rig);
  for (int trial = 0; trial < 10; ++trial) {
    const auto targets = test::targets_at(rig, test::allowed_pose(random, rig));
    Pose a = rest_pose(rig), b = a;
    one.solve(targets, a);
    Pose elsewhere = test::allowed_pose(random, rig);
    two.solve(test::targets_at(rig, test::allowed_pose(random, rig)), elsewhere);
    two.solve(targets, b);
    for (std::size_t i = 0; i < a.size(); ++i) {
      EXPECT_EQ(a[i].real.coeffs(), b[i].real.coeffs());
      EXPECT_EQ(a[i].dual.coeffs(), b[i].dual.coeffs());
    }
  }
}

TEST(IkSolver, SolvingAllocatesNothing) {
  Random random(9);
  const Rig rig = test::shipped_rig("biped-hands");
  for (const IkMethod method : {IkMethod::pgs, IkMethod::pgs_paper}) {
    IkSolver solver = make_solver(rig, {.method = method, .restarts = 2});
    const auto reachable = test::targets_at(rig, test::allowed_pose(random, rig));
    auto far = reachable;
    for (EffectorTarget& target : far) {
      target.pose = DualQuaternion::from_translation(random.vector()) * target.pose;
    }
    Pose pose = rest_pose(rig);
    const std::size_t before = test::allocation_count();
    solver.solve(reachable, pose);
    solver.solve(far, pose);
    EXPECT_EQ(test::allocation_count(), before);
  }
}

TEST(IkSolver, RestartsFindLonePoses) {
  Random random(10);
  const Rig rig = test::shipped_rig("arm3");
  IkSolver once = make_solver(rig), many = make_solver(rig, {.restarts = 20});
  int by_once = 0, by_many = 0;
  for (int trial = 0; trial < 200; ++trial) {
    const auto targets = test::targets_at(rig, test::allowed_pose(random, rig));
    Pose a = rest_pose(rig), b = a;
    by_once += once.solve(targets, a).reached;
    by_many += many.solve(targets, b).reached;
    EXPECT_LT(test::worst_excess(rig, b), kAllowed);
  }
  EXPECT_GE(by_many, by_once);
  EXPECT_GE(by_many, 199);
}

TEST(IkSolver, UnwindingLeavesACornerOrThePoseAlone) {
  Random random(13);
  const Rig rig = test::shipped_rig("hand");
  IkSolver plain = make_solver(rig), unwinding = make_solver(rig, {.unwind = true});
  int more = 0;
  for (int trial = 0; trial < 200; ++trial) {
    const auto targets = test::targets_at(rig, test::allowed_pose(random, rig));
    Pose a = test::allowed_pose(random, rig), b = a;
    const IkReport first = plain.solve(targets, a), second = unwinding.solve(targets, b);
    EXPECT_GE(second.reached, first.reached);
    more += second.reached && !first.reached;
    if (second.reached) continue;
    for (std::size_t i = 0; i < a.size(); ++i) EXPECT_EQ(a[i].real.coeffs(), b[i].real.coeffs());
  }
  EXPECT_GT(more, 0);
}

TEST(IkSolver, HostileTargetsGiveFinitePosesWithinLimits) {
  Random random(11);
  for (int trial = 0; trial < 100; ++trial) {
    Rig rig = test::random_rig(random, 10, 10);
    for (RigJoint& joint : rig.joints) {
      if (random.integer(0, 3) == 0) joint.offset.setZero();
      if (random.integer(0, 5) == 0 && joint.limited()) {
        for (Range& range : joint.limits) range = {0.0, 0.0};
      }
    }
    rig.effectors[1] = rig.effectors[0];  // duplicate, then contradicting
    rig.effectors[1].name = "again";
    auto targets = test::targets_at(rig, test::allowed_pose(random, rig));
    targets[1].pose = random.motion();
    targets[2].pose = DualQuaternion::from_translation({1e6, -1e6, 1e6});
    targets[3].weight = 0.0;
    targets[4].weight = 1e4;
    Pose pose = test::allowed_pose(random, rig);
    const IkReport report = make_solver(rig).solve(targets, pose);
    EXPECT_TRUE(std::isfinite(report.cost));
    for (const DualQuaternion& q : pose) {
      EXPECT_TRUE(q.real.coeffs().allFinite() && q.dual.coeffs().allFinite());
    }
    EXPECT_LT(test::worst_excess(rig, pose), 1e-7);
  }
}

TEST(IkSolver, JointsWithoutEffectorsAndFixedOnesStay) {
  Random random(12);
  Rig rig = test::shipped_rig("biped-hands");
  std::erase_if(rig.effectors, [](const RigEffector& e) { return e.name != "l_hand"; });
  ASSERT_EQ(rig.effectors.size(), 1U);
  IkSolver solver = make_solver(rig);
  const Pose start = test::allowed_pose(random, rig, 0.9);
  Pose pose = start;
  solver.solve(test::targets_at(rig, test::allowed_pose(random, rig)), pose);
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    std::int32_t j = rig.effectors[0].joint;
    while (j >= 0 && j != i) j = rig.joints[j].parent;
    if (j == i) continue;
    EXPECT_EQ(pose[i].real.coeffs(), start[i].real.coeffs()) << rig.joints[i].name;
  }
}

TEST(IkSolver, BadOptionsAndRigsAreRefused) {
  const Rig rig = test::shipped_rig("arm2");
  EXPECT_EQ(IkSolver::create(rig, {.damping = 0.0}).error().code, "solver-options");
  EXPECT_EQ(IkSolver::create(rig, {.max_relinearisations = 0}).error().code, "solver-options");
  EXPECT_EQ(IkSolver::create(rig, {.sweeps = 0}).error().code, "solver-options");
  EXPECT_EQ(IkSolver::create(rig, {.relaxation = 2.0}).error().code, "solver-options");
  EXPECT_EQ(IkSolver::create(Rig{}).error().code, "rig-invalid");
}

}  // namespace
}  // namespace limber
