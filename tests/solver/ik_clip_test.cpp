// Clips: following, mending, braking.
#include "solver/ik_clip.h"

#include <gtest/gtest.h>

#include <functional>
#include <tuple>

#include "tests/solver/allocation_count.h"
#include "tests/solver/seeded_motion.h"

namespace limber {
namespace {

constexpr int kFrames = 600;

/// A motion's targets and the poses that a clip solver made of them.
struct Followed {
  Rig rig;
  std::vector<Pose> truth;
  std::vector<EffectorTarget> targets;
  std::vector<DualQuaternion> poses;
  std::vector<IkReport> reports;
  int mended = 0, jumps = 0;

  std::span<const DualQuaternion> pose(int frame) const {
    return std::span(poses).subspan(frame * rig.joints.size(), rig.joints.size());
  }
  Pose pose_copy(int frame) const { return {pose(frame).begin(), pose(frame).end()}; }
  std::span<const EffectorTarget> targets_of(int frame) const {
    return std::span(targets).subspan(frame * rig.effectors.size(), rig.effectors.size());
  }
};

Followed follow_motion(const std::string& name, unsigned seed, IkOptions options = {},
                       double outward_m = 0.0, double stretched = 1.0) {
  Followed out;
  out.rig = test::shipped_rig(name);
  out.truth = test::seeded_motion(out.rig, seed, kFrames, {.amplitude = 1.0, .press = 0.3});
  for (int f = 0; f < kFrames; ++f) {
    for (EffectorTarget target : test::targets_at(out.rig, out.truth[f])) {
      const Eigen::Vector3d away = target.pose.translation() - out.truth[f][0].translation();
      const Eigen::Vector3d from_start = target.pose.translation() - out.truth[0][0].translation();
      target.pose = DualQuaternion::from_translation(outward_m * away.normalized() +
                                                     (stretched - 1.0) * from_start) *
                    target.pose;
      out.targets.push_back(target);
    }
  }
  options.unwind = true;
  IkSolver solver = std::move(IkSolver::create(out.rig, options).value());
  out.poses.resize(kFrames * out.rig.joints.size());
  std::ranges::copy(out.truth[0], out.poses.begin());
  IkClipSolver clip(solver, out.rig, out.targets, out.poses);
  for (int f = 0; f < kFrames; ++f) out.reports.push_back(clip.next());
  out.mended = clip.mended();
  out.jumps = clip.jumps();
  return out;
}

/// The largest miss of a strong effector, m and 0.1 m/rad.
double miss(const Followed& f, int frame) {
  Pose world(f.rig.joints.size());
  model_from_local(skeleton_of(f.rig), f.pose(frame), world);
  double worst = 0.0;
  for (std::size_t e = 0; e < f.rig.effectors.size(); ++e) {
    const RigEffector& effector = f.rig.effectors[e];
    if (!effector.strong) continue;
    const DualQuaternion& target = f.targets_of(frame)[e].pose;
    const DualQuaternion& joint = world[effector.joint];
    worst = std::max(worst, (target.translation() - joint.transform_point(effector.offset)).norm());
    if (effector.kind != EffectorKind::pose) continue;
    worst = std::max(worst, 0.1 * rotation_angle(target.rotation(), joint.rotation()));
  }
  return worst;
}

/// The largest second difference of any joint's place, m.
double largest_jerk(const Rig& rig, const std::function<std::span<const DualQuaternion>(int)>& at) {
  std::vector<Pose> world(kFrames, Pose(rig.joints.size()));
  double worst = 0.0;
  for (int f = 0; f < kFrames; ++f) {
    model_from_local(skeleton_of(rig), at(f), world[f]);
    for (std::int32_t j = 0; f > 1 && j < rig.size(); ++j) {
      worst = std::max(worst, (world[f][j].translation() - 2.0 * world[f - 1][j].translation() +
                               world[f - 2][j].translation())
                                  .norm());
    }
  }
  return worst;
}

class ClipOf : public testing::TestWithParam<std::tuple<const char*, unsigned>> {};

TEST_P(ClipOf, EveryFrameIsReachedWithinLimitsAndNothingPops) {
  const auto [name, seed] = GetParam();
  const Followed f = follow_motion(name, seed);
  for (int i = 0; i < kFrames; ++i) {
    EXPECT_TRUE(f.reports[i].reached) << i;
    EXPECT_LT(miss(f, i), 1.2e-4) << i;  // the stop tolerances; earlier answers may have changed
    EXPECT_LT(test::worst_excess(f.rig, f.pose_copy(i)), 1e-7) << i;
  }
  // Weak effectors and limits that the truth itself rides on leave it some freedom, pops none: the
  // fastest joint's second difference stays near that of the motion that the targets came from.
  const double truth =
      largest_jerk(f.rig, [&](int i) { return std::span<const DualQuaternion>(f.truth[i]); });
  EXPECT_LT(largest_jerk(f.rig, [&](int i) { return f.pose(i); }), 3.0 * truth);
}

INSTANTIATE_TEST_SUITE_P(Rigs, ClipOf,
                         testing::Combine(testing::Values("arm3", "hand", "biped-full"),
                                          testing::Values(1u, 2u, 3u)));

TEST(IkClip, MendingIsWhatReachesAWoundClip) {
  // Somewhere among these motions following alone ends in a corner of the limits.
  int lost = 0, mended = 0, rough = 0;
  for (unsigned seed = 25; seed <= 36; ++seed) {
    const Followed clip = follow_motion("arm3", seed);
    mended += clip.mended;
    IkSolver solver = std::move(IkSolver::create(clip.rig).value());
    Pose pose = clip.truth[0];
    solver.solve(clip.targets_of(0), pose);
    for (int f = 1; f < kFrames; ++f) lost += !solver.follow(clip.targets_of(f), pose).reached;
    for (int f = 0; f < kFrames; ++f) EXPECT_TRUE(clip.reports[f].reached) << seed << " " << f;
    for (int f = 0; f < kFrames; ++f) EXPECT_LT(miss(clip, f), 1.2e-4) << seed << " " << f;
    // The ways over are smoothed: no rougher than a fast moment of the truth, but where the room
    // that is left closes within a few frames.
    const double truth = largest_jerk(
        clip.rig, [&](int i) { return std::span<const DualQuaternion>(clip.truth[i]); });
    rough += largest_jerk(clip.rig, [&](int i) { return clip.pose(i); }) > 2.0 * truth;
  }
  EXPECT_EQ(rough, 0);
  EXPECT_GT(lost, 0);
  EXPECT_GT(mended, 0);
}

TEST(IkSolver, FollowingIsDeterministicAndAllocatesNothing) {
  const Rig rig = test::shipped_rig("biped-full");
  const auto motion = test::seeded_motion(rig, 4, 60);
  IkSolver one = std::move(IkSolver::create(rig).value());
  IkSolver two = std::move(IkSolver::create(rig).value());
  Pose a = motion[0], b = motion[0];
  one.solve(test::targets_at(rig, motion[0]), a);
  two.solve(test::targets_at(rig, motion[0]), b);
  for (int f = 1; f < 60; ++f) {
    const auto targets = test::targets_at(rig, motion[f]);
    const std::size_t before = test::allocation_count();
    one.follow(targets, a);
    EXPECT_EQ(test::allocation_count(), before);
    two.follow(targets, b);
    for (std::size_t i = 0; i < a.size(); ++i) {
      EXPECT_EQ(a[i].real.coeffs(), b[i].real.coeffs());
      EXPECT_EQ(a[i].dual.coeffs(), b[i].dual.coeffs());
    }
  }
}

TEST(IkSolver, ResumingGoesOnAsIfNothingHadHappened) {
  const Rig rig = test::shipped_rig("hand");
  const auto motion = test::seeded_motion(rig, 5, 40);
  IkSolver whole = std::move(IkSolver::create(rig).value());
  std::vector<Pose> answers(40, motion[0]);
  whole.solve(test::targets_at(rig, motion[0]), answers[0]);
  for (int f = 1; f < 40; ++f) whole.follow(test::targets_at(rig, motion[f]), answers[f]);
  IkSolver resumed = std::move(IkSolver::create(rig).value());
  resumed.resume(answers[18], answers[19]);
  Pose pose(answers[0].size());
  EXPECT_TRUE(resumed.follow(test::targets_at(rig, motion[20]), pose).reached);
  for (std::size_t i = 0; i < pose.size(); ++i) {
    EXPECT_LT(rotation_angle(pose[i].rotation(), answers[20][i].rotation()), 1e-3) << i;
  }
}

TEST(IkClip, OutOfReachTheLimitsHoldAndCostStaysThatOfALonePose) {
  // On its way from one best reach to another a frame may cost more; the clip hardly does.
  const Followed f = follow_motion("biped-full", 6, {}, 0.1);
  IkSolver alone = std::move(IkSolver::create(f.rig).value());
  double followed = 0.0, lone = 0.0;
  for (int i = 0; i < kFrames; ++i) {
    EXPECT_LT(test::worst_excess(f.rig, f.pose_copy(i)), 1e-7) << i;
    followed += effector_cost(f.rig, f.targets_of(i), f.pose(i));
    Pose pose = f.pose_copy(i);
    lone += alone.solve(f.targets_of(i), pose).cost;
  }
  EXPECT_LT(followed, 1.01 * lone);
}

TEST(IkClip, OutOfReachNothingJumps) {
  // Best reaches come and go; what is shown stays about as calm as the motion whose targets were
  // pulled apart.
  const auto calm = [](const char* name, unsigned seed) {
    const Followed f = follow_motion(name, seed, {}, 0.0, 1.2);
    const double truth =
        largest_jerk(f.rig, [&](int i) { return std::span<const DualQuaternion>(f.truth[i]); });
    EXPECT_LT(largest_jerk(f.rig, [&](int i) { return f.pose(i); }), 2.0 * truth)
        << name << " " << seed;
  };
  for (unsigned seed = 1; seed <= 12; ++seed) {
    for (const char* name : {"hand", "biped-full", "biped-hands"}) calm(name, seed);
  }
  calm("arm3", 6);  // never within reach; where others come back, they may have to hurry
}

}  // namespace
}  // namespace limber
