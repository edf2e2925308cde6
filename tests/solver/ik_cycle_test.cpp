// Cycles solved as one: laws of motions that repeat.
#include "solver/ik_cycle.h"

#include <gtest/gtest.h>

#include <tuple>

#include "solver/ik_clip.h"
#include "tests/solver/allocation_count.h"
#include "tests/solver/seeded_motion.h"

namespace limber {
namespace {

/// A motion that repeats, and targets for as many frames of it as asked for.
struct Motion {
  Rig rig;
  std::vector<Pose> truth;

  Motion(const std::string& name, unsigned seed, int period, double amplitude = 0.5)
      : rig(test::shipped_rig(name)),
        truth(test::seeded_motion(rig, seed, period,
                                  {.fastest_hz = 1.4, .amplitude = amplitude, .period = period})) {}
  int period() const { return static_cast<int>(truth.size()); }
  const Pose& at(int frame) const { return truth[static_cast<std::size_t>(frame % period())]; }
  std::vector<EffectorTarget> targets(int first, int frames) const {
    std::vector<EffectorTarget> all;
    for (int f = first; f < first + frames; ++f) {
      const auto these = test::targets_at(rig, at(f));
      all.insert(all.end(), these.begin(), these.end());
    }
    return all;
  }
  /// Frames of poses, the first one holding the start.
  std::vector<DualQuaternion> poses(int first, int frames) const {
    std::vector<DualQuaternion> all(static_cast<std::size_t>(frames) * rig.joints.size());
    std::ranges::copy(at(first), all.begin());
    return all;
  }
  Pose pose(const std::vector<DualQuaternion>& poses, int frame) const {
    const auto first = poses.begin() + frame * static_cast<std::ptrdiff_t>(rig.joints.size());
    return {first, first + static_cast<std::ptrdiff_t>(rig.joints.size())};
  }
};

IkSolver clip_solver(const Rig& rig) { return test::make_solver(rig, {.unwind = true}); }

struct Solved {
  std::vector<DualQuaternion> poses;
  CycleReport report;
};

Solved solve(const Motion& motion, int first, int frames) {
  Solved out{motion.poses(first, frames), {}};
  IkSolver solver = clip_solver(motion.rig);
  auto report = solve_cycle(solver, motion.rig, motion.targets(first, frames), out.poses);
  EXPECT_TRUE(report.ok());
  if (report) out.report = report.value();
  return out;
}

/// The largest miss of a strong effector: m, and rad at 0.1 m.
double miss(const Motion& motion, const Pose& pose, int frame) {
  const Pose have = test::world_of(motion.rig, pose);
  const Pose want = test::world_of(motion.rig, motion.at(frame));
  double worst = 0.0;
  for (const RigEffector& effector : motion.rig.effectors) {
    if (!effector.strong) continue;
    const DualQuaternion &a = have[effector.joint], &b = want[effector.joint];
    worst = std::max(
        worst, (a.transform_point(effector.offset) - b.transform_point(effector.offset)).norm());
    if (effector.kind != EffectorKind::pose) continue;
    worst = std::max(worst, 0.1 * rotation_angle(a.rotation(), b.rotation()));
  }
  return worst;
}

/// The largest angle between joints of neighbouring frames, from frame a to frame b.
double turn_between(const Pose& a, const Pose& b) {
  double most = 0.0;
  for (std::size_t j = 0; j < a.size(); ++j) {
    most = std::max(most, rotation_angle(a[j].rotation(), b[j].rotation()));
  }
  return most;
}

class CycleOf : public testing::TestWithParam<std::tuple<const char*, int, unsigned>> {};

TEST_P(CycleOf, ClosesOnItsTargetsWithinLimits) {
  const auto [name, period, seed] = GetParam();
  const Motion motion(name, seed, period, period < 60 ? 0.2 : 0.5);
  const Solved s = solve(motion, 0, period);
  EXPECT_EQ(s.report.closing, Closing::continues);
  EXPECT_TRUE(s.report.closed);
  EXPECT_EQ(s.report.unreached, 0);
  double largest = 0.0;
  for (int f = 0; f < period; ++f) {
    EXPECT_LT(miss(motion, motion.pose(s.poses, f), f), 1.2e-4) << f;  // the stop tolerances
    EXPECT_LT(test::worst_excess(motion.rig, motion.pose(s.poses, f)), 1.7e-7) << f;  // 1e-5 deg
    if (f == 0) continue;
    largest = std::max(largest, turn_between(motion.pose(s.poses, f - 1), motion.pose(s.poses, f)));
  }
  const Pose last = motion.pose(s.poses, period - 1), first = motion.pose(s.poses, 0);
  EXPECT_LE(turn_between(last, first), largest);
  EXPECT_NEAR(s.report.steps.seam.turn_rad, turn_between(last, first), 1e-12);
  EXPECT_NEAR(s.report.steps.elsewhere.turn_rad, largest, 1e-12);
  // Nor does the velocity jump there more than it does elsewhere, or than the motion has it do.
  std::vector<DualQuaternion> truth;
  for (int f = 0; f < period; ++f)
    truth.insert(truth.end(), motion.at(f).begin(), motion.at(f).end());
  const PoseStep &seam = s.report.steps.seam, &elsewhere = s.report.steps.elsewhere;
  const CycleSteps asked = cycle_steps(motion.rig, truth);
  EXPECT_LE(seam.turn_change_rad,
            std::max(elsewhere.turn_change_rad, 1.01 * asked.seam.turn_change_rad));
  EXPECT_LE(seam.way_change_m, std::max(elsewhere.way_change_m, 1.01 * asked.seam.way_change_m));
  // And closing it made no jump elsewhere, be it of a joint that the targets leave open.
  EXPECT_LT(elsewhere.way_change_m, 2.0 * asked.elsewhere.way_change_m);
  EXPECT_LT(elsewhere.turn_change_rad, 2.0 * asked.elsewhere.turn_change_rad);
}

INSTANTIATE_TEST_SUITE_P(Rigs, CycleOf,
                         testing::Combine(testing::Values("arm3", "hand", "biped-full"),
                                          testing::Values(36, 120), testing::Values(1u, 2u, 3u)));

TEST(Cycle, FollowingItAloneLeavesTheSeamOpen) {
  // What the others would show of a solver that goes round once: not that cycles close by nature.
  const Motion motion("biped-full", 1, 120);
  auto poses = motion.poses(0, 120);
  const auto targets = motion.targets(0, 120);
  IkSolver solver = clip_solver(motion.rig);
  IkClipSolver clip(solver, motion.rig, targets, poses);
  for (int f = 0; f < 120; ++f) clip.next();
  const CycleSteps steps = cycle_steps(motion.rig, poses);
  EXPECT_GT(steps.seam.turn_rad, 5.0 * steps.elsewhere.turn_rad);
}

TEST(Cycle, IsTheSameFromAnyPhaseWhereLapsMeet) {
  // Where laps differ by 1e-6 rad, and each by c times what the one before did, the cycle that all
  // starts lead to is 1e-6 c / (1 - c) away: 1e-4 rad allow for c up to 0.98 on either side.
  int met = 0;
  for (const char* name : {"arm3", "hand", "biped-full"}) {
    for (unsigned seed = 1; seed <= 4; ++seed) {
      const Motion motion(name, seed, 120);
      const Solved a = solve(motion, 0, 120), b = solve(motion, 43, 120);
      if (a.report.led_over || b.report.led_over) continue;
      ++met;
      for (int f = 0; f < 120; ++f) {
        EXPECT_LT(turn_between(motion.pose(a.poses, (f + 43) % 120), motion.pose(b.poses, f)), 1e-4)
            << name << " " << seed << " " << f;
      }
    }
  }
  EXPECT_GE(met, 8);
}

TEST(Cycle, ARepeatedFrameIsTheFirstOne) {
  const Motion motion("arm3", 2, 100);
  const Solved open = solve(motion, 0, 100), closed = solve(motion, 0, 101);
  EXPECT_EQ(closed.report.closing, Closing::repeats);
  EXPECT_EQ(closed.report.period, 100);
  for (int f = 0; f <= 100; ++f) {
    const Pose a = motion.pose(open.poses, f % 100), b = motion.pose(closed.poses, f);
    for (std::size_t j = 0; j < a.size(); ++j) {
      EXPECT_EQ(a[j].real.coeffs(), b[j].real.coeffs());
      EXPECT_EQ(a[j].dual.coeffs(), b[j].dual.coeffs());
    }
  }
}

TEST(Cycle, ASecondSolveOfOneSolverGivesTheSameBytes) {
  const Motion motion("biped-full", 2, 60, 0.3);
  const auto targets = motion.targets(0, 60);
  IkSolver solver = clip_solver(motion.rig);
  auto a = motion.poses(0, 60), b = a;
  ASSERT_TRUE(solve_cycle(solver, motion.rig, targets, a).ok());
  ASSERT_TRUE(solve_cycle(solver, motion.rig, targets, b).ok());
  for (std::size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].real.coeffs(), b[i].real.coeffs());
    EXPECT_EQ(a[i].dual.coeffs(), b[i].dual.coeffs());
  }
}

/// Targets on a circle: at frame f at `turns(f / frames)` of the way round.
std::vector<EffectorTarget> circling(const Rig& rig, int frames, double (*turns)(double)) {
  std::vector<EffectorTarget> all;
  for (int f = 0; f < frames; ++f) {
    const double angle = 2.0 * M_PI * turns(static_cast<double>(f) / frames);
    for (std::size_t e = 0; e < rig.effectors.size(); ++e) {
      all.push_back({DualQuaternion::from_translation({std::cos(angle), std::sin(angle), 0.0})});
    }
  }
  return all;
}

TEST(Cycle, AllocationsDoNotGrowWithItsFrames) {
  std::vector<std::size_t> counts;
  for (const int period : {60, 150}) {
    const Motion motion("hand", 1, period, 0.3);
    const auto targets = motion.targets(0, period);
    auto poses = motion.poses(0, period);
    IkSolver solver = clip_solver(motion.rig);
    const std::size_t before = test::allocation_count();
    ASSERT_TRUE(solve_cycle(solver, motion.rig, targets, poses).ok());
    counts.push_back(test::allocation_count() - before);
  }
  EXPECT_EQ(counts[0], counts[1]);
}

TEST(Cycle, AClipThatDoesNotCloseIsRefusedAndLeftAsItIs) {
  const Motion motion("arm3", 1, 120);
  IkSolver solver = clip_solver(motion.rig);
  EXPECT_EQ(closing_of(motion.rig, circling(motion.rig, 60, [](double u) { return u; })),
            Closing::continues);
  // A part of the period; too short; and one that closes in place but not in speed: it comes to
  // rest where it set out.
  const auto coming_to_rest = [](double u) { return 1.0 - (1.0 - u) * (1.0 - u); };
  for (const auto& targets :
       {motion.targets(0, 70), motion.targets(0, 3), circling(motion.rig, 60, coming_to_rest)}) {
    const auto frames = static_cast<int>(targets.size() / motion.rig.effectors.size());
    const auto before = motion.poses(0, frames);
    auto poses = before;
    const auto report = solve_cycle(solver, motion.rig, targets, poses);
    ASSERT_FALSE(report.ok()) << frames;
    EXPECT_EQ(report.error().code, "clip-open");
    for (std::size_t i = 0; i < poses.size(); ++i) {
      EXPECT_EQ(poses[i].real.coeffs(), before[i].real.coeffs());
      EXPECT_EQ(poses[i].dual.coeffs(), before[i].dual.coeffs());
    }
  }
}

TEST(Cycle, ARigWithoutEffectorsHasNone) {
  Rig rig = test::shipped_rig("arm3");
  rig.effectors.clear();
  EXPECT_EQ(closing_of(rig, {}), Closing::none);
}

TEST(Cycle, OutOfReachItClosesWithinLimits) {
  Motion motion("arm3", 1, 120);
  auto targets = motion.targets(0, 120);
  for (EffectorTarget& target : targets) {
    target.pose = DualQuaternion::from_translation(1.0 * target.pose.translation().normalized()) *
                  target.pose;
  }
  auto poses = motion.poses(0, 120);
  IkSolver solver = clip_solver(motion.rig);
  const auto report = solve_cycle(solver, motion.rig, targets, poses);
  ASSERT_TRUE(report.ok());
  EXPECT_EQ(report->unreached, 120);
  EXPECT_LE(report->steps.seam.turn_rad, report->steps.elsewhere.turn_rad);
  for (int f = 0; f < 120; ++f) {
    EXPECT_LT(test::worst_excess(motion.rig, motion.pose(poses, f)), 1.7e-7) << f;
  }
}

TEST(CycleSteps, AreTheFrameToFrameDifferencesOfAKnownTurn) {
  // One hinge with a point 1 m out, turned by the same angle per frame but for one step.
  Rig rig;
  rig.joints.resize(2);
  rig.joints[0].name = "hinge";
  rig.joints[0].type = JointType::hinge;
  rig.joints[0].axes[0] = Eigen::Vector3d::UnitZ();
  rig.joints[1].name = "tip";
  rig.joints[1].parent = 0;
  rig.joints[1].offset = Eigen::Vector3d::UnitX();
  // Seven steps of 0.8 rad, and one that closes: 2 pi - 5.6.
  std::vector<DualQuaternion> poses;
  for (int f = 0; f < 8; ++f) {
    poses.push_back(DualQuaternion::from_rotation_translation(
        test::about(Eigen::Vector3d::UnitZ(), 0.8 * f), Eigen::Vector3d::Zero()));
    poses.push_back(DualQuaternion::from_translation(Eigen::Vector3d::UnitX()));
  }
  const double closing = 2.0 * M_PI - 5.6;
  const CycleSteps steps = cycle_steps(rig, poses);
  EXPECT_NEAR(steps.elsewhere.turn_rad, 0.8, 1e-12);
  EXPECT_NEAR(steps.elsewhere.way_m, 2.0 * std::sin(0.4), 1e-12);
  EXPECT_NEAR(steps.elsewhere.turn_change_rad, 0.0, 1e-12);
  EXPECT_NEAR(steps.seam.turn_rad, closing, 1e-12);
  EXPECT_NEAR(steps.seam.way_m, 2.0 * std::sin(0.5 * closing), 1e-12);
  EXPECT_NEAR(steps.seam.turn_change_rad, 0.8 - closing, 1e-12);
}

}  // namespace
}  // namespace limber
