// The load that retargeting puts on the solver: a weak orientation effector on almost every joint,
// strong poses and positions on pelvis, hands and feet, all somewhat in conflict, from a good
// start.
#include <gtest/gtest.h>

#include "solver/swing_twist.h"
#include "tests/solver/test_rigs.h"

namespace limber {
namespace {

using test::Random;

Rig retarget_rig(const char* name) {
  Rig rig = test::shipped_rig(name);
  for (RigEffector& effector : rig.effectors) effector.weight_rot = 0.3;
  const std::size_t first = rig.effectors.size();
  rig = test::with_posture(std::move(rig), 0.05);
  for (std::int32_t j = 1; j < rig.size(); j += 2) rig.effectors[first + j].weight_rot = 0.2;
  return rig;
}

/// Targets of an allowed pose, each then disturbed by itself.
std::vector<EffectorTarget> conflicting(Random& random, const Rig& rig, const Pose& truth) {
  auto targets = test::targets_at(rig, truth);
  for (std::size_t e = 0; e < targets.size(); ++e) {
    const bool posture = rig.effectors[e].kind == EffectorKind::orientation;
    targets[e].pose = DualQuaternion::from_rotation_translation(
        random.small_rotation(posture ? 0.3 : 0.05) * targets[e].pose.rotation(),
        targets[e].pose.translation() + random.vector(0.02));
  }
  return targets;
}

class RetargetLoad : public testing::TestWithParam<const char*> {};

TEST_P(RetargetLoad, ConvergesToOnePointWithinLimits) {
  Random random(1);
  const Rig rig = retarget_rig(GetParam());
  ASSERT_TRUE(validate(rig).ok());
  Result<IkSolver> quick = IkSolver::create(rig, {.stop_at_tolerance = false});
  Result<IkSolver> exact = IkSolver::create(rig, {.stop_at_tolerance = false,
                                                  .stop_step = 1e-12,
                                                  .stop_cost_decrease = 1e-15,
                                                  .max_relinearisations = 500});
  ASSERT_TRUE(quick.ok() && exact.ok());
  for (int trial = 0; trial < 15; ++trial) {
    const Pose truth = test::allowed_pose(random, rig, 1.0);
    const auto targets = conflicting(random, rig, truth);
    Pose start = truth;
    for (DualQuaternion& q : start) {
      q = DualQuaternion::from_rotation_translation(q.rotation() * random.small_rotation(0.1),
                                                    q.translation());
    }
    project_into_limits(rig, start);
    const double before = test::objective(rig, targets, start);
    Pose a = start, b = start;
    const IkReport by_quick = quick->solve(targets, a);
    const IkReport by_exact = exact->solve(targets, b);
    EXPECT_LT(test::worst_excess(rig, a), 1e-5 * M_PI / 180.0);
    EXPECT_TRUE(by_quick.converged);
    EXPECT_LE(by_quick.relinearisations, 25);
    EXPECT_LT(by_quick.cost, before);
    // The default stop leaves next to nothing, and the optimum satisfies the projected residual.
    EXPECT_LT(by_quick.cost, by_exact.cost * 1.001 + 1e-9);
    EXPECT_LT(by_exact.residual, 1e-6);
    EXPECT_NEAR(test::objective(rig, targets, b), by_exact.cost, 1e-9);
  }
}

TEST_P(RetargetLoad, StoppingAtToleranceWouldIgnoreTheWeak) {
  // Strong targets are met at the start, weak ones are not: only stop_at_tolerance = false moves.
  Random random(2);
  const Rig rig = retarget_rig(GetParam());
  const Pose truth = test::allowed_pose(random, rig, 0.8);
  auto targets = test::targets_at(rig, truth);
  for (std::size_t e = 0; e < targets.size(); ++e) {
    if (rig.effectors[e].strong) continue;
    targets[e].pose = DualQuaternion::from_rotation_translation(
        random.small_rotation(0.5) * targets[e].pose.rotation(), targets[e].pose.translation());
  }
  Pose a = truth, b = truth;
  Result<IkSolver> stops = IkSolver::create(rig);
  Result<IkSolver> goes_on = IkSolver::create(rig, {.stop_at_tolerance = false});
  ASSERT_TRUE(stops.ok() && goes_on.ok());
  EXPECT_EQ(stops->solve(targets, a).relinearisations, 0);
  const double before = test::objective(rig, targets, truth);
  EXPECT_LT(goes_on->solve(targets, b).cost, 0.95 * before);
}

INSTANTIATE_TEST_SUITE_P(Bodies, RetargetLoad, testing::Values("biped-full", "biped-hands"));

}  // namespace
}  // namespace limber
