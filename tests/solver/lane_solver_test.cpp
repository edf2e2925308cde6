// Eight runs in lock-step: what a lane answers is a matter of its own targets alone, to the bit, at
// every SIMD level; it reaches what the solver for one reaches; what it stores is within limits in
// doubles, whatever is asked.

#include "solver/lane_solver.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <functional>

#include "tests/solver/allocation_count.h"
#include "tests/solver/seeded_motion.h"

namespace limber {
namespace {

using test::Random;

constexpr int kLanes = LaneSolver::lanes;
constexpr double kAllowed = 1e-5 * M_PI / 180.0;  // rad
constexpr const char* kRigs[] = {"arm2", "arm3", "hand", "biped", "biped-full", "biped-hands"};

using Targets = std::vector<EffectorTarget>;
/// What a lane is asked for: [frame], and where it starts.
struct Asked {
  Pose start;
  std::vector<Targets> frames;
};

Asked run_of(const Rig& rig, unsigned seed, int frames, const test::MotionOptions& options = {}) {
  Asked run;
  for (const Pose& pose : test::seeded_motion(rig, seed, frames, options)) {
    if (run.frames.empty()) run.start = pose;
    run.frames.push_back(test::targets_at(rig, pose));
  }
  return run;
}

std::vector<Asked> runs_of(const Rig& rig, int frames, const test::MotionOptions& options = {}) {
  std::vector<Asked> runs;
  for (int lane = 0; lane < kLanes; ++lane) {
    runs.push_back(run_of(rig, 100u + static_cast<unsigned>(lane), frames, options));
  }
  return runs;
}

/// Moves targets a little or by 1000 km, out of reach or into contradiction, weights off and on.
void spoil(Asked& run, unsigned seed) {
  Random random(seed);
  for (Targets& targets : run.frames) {
    for (EffectorTarget& target : targets) {
      const int way = random.integer(0, 9);
      const double by = way == 0 ? 1e6 : way < 4 ? 2.0 : way < 7 ? 0.05 : 0.0;
      target.pose = DualQuaternion::from_translation(by * random.unit()) * target.pose;
      if (way == 8) target.weight = 0.0;
      if (way == 9) target.pose = -target.pose;  // the same transform
    }
  }
}

LaneSolver solver_for(const Rig& rig, const std::vector<Asked>& runs, const std::string& level = "",
                      const IkOptions& options = {}) {
  Result<LaneSolver> made = LaneSolver::create(rig, options);
  if (!made) throw std::runtime_error(made.error().message);
  if (!level.empty()) made->use_level(level);
  for (int lane = 0; lane < kLanes; ++lane) made->start(lane, runs[lane].start);
  return std::move(made.value());
}

/// Solves every frame and shows each lane's answer: (lane, frame, pose).
void follow_all(const Rig& rig, LaneSolver& solver, const std::vector<Asked>& runs,
                const std::function<void(int, std::size_t, const Pose&)>& see) {
  Pose pose(rig.joints.size());
  for (std::size_t frame = 0; frame < runs.front().frames.size(); ++frame) {
    Targets targets;
    for (const Asked& run : runs) {
      targets.insert(targets.end(), run.frames[frame].begin(), run.frames[frame].end());
    }
    solver.follow(targets);
    for (int lane = 0; lane < kLanes; ++lane) {
      solver.pose(lane, pose);
      see(lane, frame, pose);
    }
  }
}

/// [lane][frame]
std::vector<std::vector<Pose>> answers(const Rig& rig, LaneSolver solver,
                                       const std::vector<Asked>& runs) {
  std::vector<std::vector<Pose>> out(kLanes);
  follow_all(rig, solver, runs,
             [&](int lane, std::size_t, const Pose& pose) { out[lane].push_back(pose); });
  return out;
}

bool same_bytes(const Pose& a, const Pose& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const auto& p, const auto& q) {
    return std::memcmp(&p, &q, sizeof p) == 0;
  });
}

TEST(LaneSolver, EveryLevelGivesTheSameBytes) {
  ASSERT_EQ(LaneSolver::levels().back(), "sse2");
  for (const char* name : kRigs) {
    const Rig rig = test::shipped_rig(name);
    std::vector<Asked> runs = runs_of(rig, 30, {.press = 0.5});
    spoil(runs[3], 7);  // lanes that are solved alone too
    const auto expected = answers(rig, solver_for(rig, runs, "sse2"), runs);
    for (const std::string& level : LaneSolver::levels()) {
      LaneSolver solver = solver_for(rig, runs, level);
      ASSERT_EQ(solver.level(), level);
      const auto got = answers(rig, std::move(solver), runs);
      for (int lane = 0; lane < kLanes; ++lane) {
        for (std::size_t f = 0; f < got[lane].size(); ++f) {
          ASSERT_TRUE(same_bytes(got[lane][f], expected[lane][f]))
              << name << " " << level << " lane " << lane << " frame " << f;
        }
      }
    }
  }
}

TEST(LaneSolver, ALanesAnswerIsAMatterOfItsOwnTargets) {
  for (const char* name : kRigs) {
    const Rig rig = test::shipped_rig(name);
    const std::vector<Asked> runs = runs_of(rig, 40, {.press = 0.5});
    const auto expected = answers(rig, solver_for(rig, runs), runs);
    // Lane 7 - i gets lane i's run where i is even, and rough company elsewhere.
    std::vector<Asked> shuffled = runs;
    for (int i = 0; i < kLanes; ++i) {
      shuffled[7 - i] = i % 2 == 0 ? runs[i] : run_of(rig, 500u + i, 40, {.press = 1.0});
      if (i % 2 != 0) spoil(shuffled[7 - i], static_cast<unsigned>(i));
    }
    const auto got = answers(rig, solver_for(rig, shuffled), shuffled);
    for (int i = 0; i < kLanes; i += 2) {
      for (std::size_t f = 0; f < got[7 - i].size(); ++f) {
        ASSERT_TRUE(same_bytes(got[7 - i][f], expected[i][f]))
            << name << " lane " << i << " frame " << f;
      }
    }
  }
}

/// Largest distance (m) and angle (rad) between strong effectors and their targets.
std::pair<double, double> worst_miss(const Rig& rig, const Targets& targets, const Pose& pose) {
  const Pose world = test::world_of(rig, pose);
  double far = 0.0, wide = 0.0;
  for (std::size_t e = 0; e < targets.size(); ++e) {
    const RigEffector& effector = rig.effectors[e];
    if (!effector.strong) continue;
    const DualQuaternion& joint = world[effector.joint];
    const Eigen::Vector3d miss =
        joint.transform_point(effector.offset) - targets[e].pose.translation();
    far = std::max(far, miss.norm());
    if (effector.kind != EffectorKind::pose) continue;
    wide = std::max(wide, joint.rotation().angularDistance(targets[e].pose.rotation()));
  }
  return {far, wide};
}

TEST(LaneSolver, ReachesWhatTheSolverForOneReaches) {
  const IkOptions options{.stop_position_m = 5e-6, .stop_orientation_rad = 5e-5};
  const IkOptions exact{.stop_position_m = 1e-6, .stop_orientation_rad = 1e-5};
  for (const char* name : kRigs) {
    const Rig rig = test::shipped_rig(name);
    const std::vector<Asked> runs = runs_of(rig, 60);
    std::vector<IkSolver> one;
    std::vector<Pose> pose(kLanes);
    for (int lane = 0; lane < kLanes; ++lane) {
      one.push_back(std::move(IkSolver::create(rig, exact).value()));
      pose[lane] = runs[lane].start;
      one[lane].solve(runs[lane].frames[0], pose[lane]);
    }
    IkSolver polish = std::move(IkSolver::create(rig, exact).value());
    LaneSolver lanes = solver_for(rig, runs, "", options);
    follow_all(rig, lanes, runs, [&](int lane, std::size_t frame, const Pose& got) {
      const Targets& targets = runs[lane].frames[frame];
      const IkReport report =
          frame == 0 ? IkReport{.reached = true} : one[lane].follow(targets, pose[lane]);
      ASSERT_TRUE(report.reached);
      ASSERT_TRUE(lanes.report(lane).reached);
      const auto [far, wide] = worst_miss(rig, targets, got);
      // Floats: a few roundings of a world some metres wide, along a chain of joints.
      EXPECT_LT(far, options.stop_position_m + 5e-6) << name << " frame " << frame;
      EXPECT_LT(wide, options.stop_orientation_rad + 5e-6) << name << " frame " << frame;
      // Five fingertips leave the hand no choice (a body's swivels may coast elsewhere), so both
      // are next to the same exact answer.
      if (rig.name != "hand") return;
      Pose polished = got;
      polish.resume(got, got);
      ASSERT_TRUE(polish.follow(targets, polished).reached);
      for (std::size_t j = 0; j < got.size(); ++j) {
        EXPECT_LT(polished[j].rotation().angularDistance(pose[lane][j].rotation()), 1e-3)
            << name << " " << rig.joints[j].name << " lane " << lane << " frame " << frame;
      }
    });
  }
}

void expect_kept(const Rig& rig, const Pose& pose, const std::string& told) {
  for (const DualQuaternion& q : pose) {
    ASSERT_TRUE(q.real.coeffs().allFinite() && q.dual.coeffs().allFinite()) << told;
    ASSERT_NEAR(q.real.norm(), 1.0, 1e-12) << told;
    ASSERT_NEAR(q.real.dot(q.dual), 0.0, 1e-12 * (1.0 + q.dual.norm())) << told;
  }
  ASSERT_LT(test::worst_excess(rig, pose), kAllowed) << told;
}

TEST(LaneSolver, KeepsLimitsWhateverIsAsked) {
  for (const char* name : kRigs) {
    const Rig rig = test::shipped_rig(name);
    std::vector<Asked> runs = runs_of(rig, 60, {.amplitude = 1.0, .press = 1.0});
    for (int lane = 2; lane < 5; ++lane) spoil(runs[lane], static_cast<unsigned>(lane));
    LaneSolver solver = solver_for(rig, runs);
    follow_all(rig, solver, runs, [&](int lane, std::size_t frame, const Pose& pose) {
      expect_kept(rig, pose,
                  std::string(name) + " " + std::to_string(lane) + " " + std::to_string(frame));
    });
  }
}

/// Any joints, ranges down to no width, effectors of the kinds that lanes solve.
Rig random_lane_rig(Random& random) {
  Rig rig = test::random_rig(random, 9, 6);
  const JointType roots[] = {JointType::hinge, JointType::ball, JointType::free};
  rig.joints[0] = test::random_joint(random, roots[random.integer(0, 2)], -1, 0);
  const EffectorKind kinds[] = {EffectorKind::pose, EffectorKind::position,
                                EffectorKind::orientation};
  for (std::size_t e = 0; e < rig.effectors.size(); ++e) rig.effectors[e].kind = kinds[e % 3];
  return rig;
}

TEST(LaneSolver, KeepsLimitsOfAnyRig) {
  Random random(11);
  for (int trial = 0; trial < 60; ++trial) {
    const Rig rig = random_lane_rig(random);
    std::vector<Asked> runs = runs_of(rig, 8, {.frames_hz = 30.0, .amplitude = 1.0, .press = 1.0});
    for (int lane = 4; lane < kLanes; ++lane) spoil(runs[lane], static_cast<unsigned>(lane));
    LaneSolver solver = solver_for(rig, runs);
    follow_all(rig, solver, runs, [&](int lane, std::size_t frame, const Pose& pose) {
      expect_kept(rig, pose,
                  std::to_string(trial) + " " + std::to_string(lane) + " " + std::to_string(frame));
    });
  }
}

TEST(LaneSolver, AllocatesNothing) {
  const Rig rig = test::shipped_rig("biped-full");
  std::vector<Asked> runs = runs_of(rig, 5);
  spoil(runs[5], 1);
  LaneSolver solver = solver_for(rig, runs);
  Pose pose(rig.joints.size());
  int alone = 0;
  for (std::size_t frame = 0; frame < 5; ++frame) {
    Targets targets;
    for (const Asked& run : runs) {
      targets.insert(targets.end(), run.frames[frame].begin(), run.frames[frame].end());
    }
    const std::size_t before = test::allocation_count();
    alone += solver.follow(targets);
    for (int lane = 0; lane < kLanes; ++lane) solver.pose(lane, pose);
    EXPECT_EQ(test::allocation_count(), before);
  }
  EXPECT_GT(alone, 0) << "the lane that is solved alone is meant, too";
}

TEST(LaneSolver, RefusesEffectorsThatItDoesNotSolve) {
  for (const EffectorKind kind :
       {EffectorKind::direction, EffectorKind::line, EffectorKind::gaze}) {
    Rig rig = test::shipped_rig("arm2");
    rig.effectors[0].kind = kind;
    const Result<LaneSolver> made = LaneSolver::create(rig);
    ASSERT_FALSE(made.ok());
    EXPECT_EQ(made.error().code, "solver-lanes");
  }
  Rig rig = test::shipped_rig("arm2");
  rig.joints[0].type = JointType::fixed;  // what hangs on it alone cannot move
  rig.effectors[0].joint = 0;
  EXPECT_EQ(LaneSolver::create(rig).error().code, "solver-lanes");
}

}  // namespace
}  // namespace limber
