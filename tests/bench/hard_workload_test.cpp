// Laws of the hard workload: limits, contacts, couplings, hands together, no pops.
#include "tests/bench/hard_workload.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "tests/solver/test_rigs.h"

namespace limber::test {
namespace {

constexpr std::int64_t kFrames = 600;

struct Solved {
  HardWorkload work = make_hard_workload(shipped_rig("biped-hands"), kFrames);
  HardRun run = run_hard_workload(work, true);
};

const Solved& solved() {
  static const Solved once;
  return once;
}

Pose pose_of(const Clip& clip, std::int64_t f) {
  return {clip.frame(f).begin(), clip.frame(f).end()};
}

/// Distance of two segments by fine search along one, exact along the other.
double distance_of(const Eigen::Vector3d& p, const Eigen::Vector3d& p1, const Eigen::Vector3d& q,
                   const Eigen::Vector3d& q1) {
  const auto to_second = [&](double s) {
    const Eigen::Vector3d at = p + s * (p1 - p), along = q1 - q;
    const double length2 = along.squaredNorm();
    const double t = length2 > 0.0 ? std::clamp(along.dot(at - q) / length2, 0.0, 1.0) : 0.0;
    return (at - q - t * along).norm();
  };
  double low = 0.0, high = 1.0;  // the distance is convex along a segment
  for (int i = 0; i < 60; ++i) {
    const double a = low + (high - low) / 3.0, b = high - (high - low) / 3.0;
    (to_second(a) < to_second(b) ? high : low) = to_second(a) < to_second(b) ? b : a;
  }
  return to_second(0.5 * (low + high));
}

/// Every pair of capsules on joints that are neither parent and child nor rigid to each other: how
/// near they are, less what they already overlap at rest.
struct CapsulePairs {
  struct Pair {
    std::int32_t joint_a, joint_b;
    Capsule a, b;
    double least = 0.0;  ///< gap allowed
  };
  std::vector<Pair> pairs;

  static double gap(const Pair& pair, const Pose& world) {
    const auto at = [&](std::int32_t joint, const Eigen::Vector3d& p) {
      return world[joint].transform_point(p);
    };
    return distance_of(at(pair.joint_a, pair.a.from), at(pair.joint_a, pair.a.to),
                       at(pair.joint_b, pair.b.from), at(pair.joint_b, pair.b.to)) -
           pair.a.radius - pair.b.radius;
  }

  explicit CapsulePairs(const Rig& rig) {
    Pose rest(rig.joints.size());
    pose_from_coordinates(rig, std::vector<double>(dof_count(rig), 0.0), rest);
    const Pose world = world_of(rig, rest);
    for (std::int32_t b = 0; b < rig.size(); ++b) {
      for (std::int32_t a = 0; a < b; ++a) {
        if (rig.joints[b].parent == a) continue;
        for (const Capsule& ca : rig.joints[a].capsules) {
          for (const Capsule& cb : rig.joints[b].capsules) {
            Pair pair{a, b, ca, cb};
            pair.least = std::min(gap(pair, world), 0.0);
            if (pair.least >= -0.2 * std::min(ca.radius, cb.radius)) pairs.push_back(pair);
          }
        }
      }
    }
  }
  double deepest(const Pose& world) const {
    double worst = 0.0;
    for (const Pair& pair : pairs) {
      const double reach = pair.a.radius + pair.b.radius + (pair.a.to - pair.a.from).norm() +
                           (pair.b.to - pair.b.from).norm();
      const Eigen::Vector3d apart = world[pair.joint_a].transform_point(pair.a.from) -
                                    world[pair.joint_b].transform_point(pair.b.from);
      if (apart.norm() > reach) continue;
      worst = std::max(worst, pair.least - gap(pair, world));
    }
    return worst;
  }
};

TEST(HardWorkload, IsAsHardAsItSays) {
  const HardWorkload& work = solved().work;
  EXPECT_EQ(dof_count(work.rig), 99);
  EXPECT_EQ(work.rig.couplings.size(), 8u);
  EXPECT_EQ(work.source.frames(), kFrames);
  for (const IkReport& report : solved().run.reports) EXPECT_GE(report.active_rows, 10);
  // The source itself breaks what the rows ask for.
  const CapsulePairs pairs(work.rig);
  for (std::int64_t f = 0; f < kFrames; f += 50) {
    EXPECT_GT(pairs.deepest(world_of(work.rig, pose_of(work.source, f))), 5e-4);
  }
}

TEST(HardWorkload, LimitsAreExact) {
  const Rig& rig = solved().work.rig;
  for (std::int64_t f = 0; f < kFrames; ++f) {
    EXPECT_LT(worst_excess(rig, pose_of(solved().run.clip, f)), 1e-5 * M_PI / 180.0) << f;
  }
}

TEST(HardWorkload, CapsulesOverlapByLessThanHalfAMillimetre) {
  const Rig& rig = solved().work.rig;
  const CapsulePairs pairs(rig);
  for (std::int64_t f = 0; f < kFrames; f += 5) {
    EXPECT_LT(pairs.deepest(world_of(rig, pose_of(solved().run.clip, f))), 5e-4) << f;
  }
  for (const IkReport& report : solved().run.reports) EXPECT_LT(report.row_violation, 5e-4);
}

TEST(HardWorkload, CouplingsHoldWithinATenthOfADegree) {
  const Rig& rig = solved().work.rig;
  for (std::int64_t f = 0; f < kFrames; ++f) {
    const auto pose = solved().run.clip.frame(f);
    const auto angle = [&](std::int32_t joint) {
      double q = 0.0;
      angles_from_rotation(rig.joints[joint],
                           rig.joints[joint].rest.conjugate() * pose[joint].rotation(), &q);
      return q;
    };
    for (const Coupling& c : rig.couplings) {
      EXPECT_NEAR(angle(c.to_joint), c.ratio * angle(c.from_joint) + c.offset, 0.1 * M_PI / 180.0);
    }
  }
}

TEST(HardWorkload, HandsStayTogether) {
  // Pressed 6 mm into each other by their target, they give way by about that much.
  const HardWorkload& work = solved().work;
  for (std::int64_t f = 0; f < kFrames; ++f) {
    const Pose world = world_of(work.rig, pose_of(solved().run.clip, f));
    for (std::size_t e = 0; e < work.rig.effectors.size(); ++e) {
      const RigEffector& effector = work.rig.effectors[e];
      if (effector.relative_to == kNoJoint) continue;
      const DualQuaternion goal = world[effector.relative_to] * work.targets[f][e].pose;
      EXPECT_LT(
          (world[effector.joint].transform_point(effector.offset) - goal.translation()).norm(),
          0.02)
          << f;
    }
  }
}

/// Largest first and second differences: of the joints' world positions (m) and of their rotations
/// against their parents (rad), per frame.
struct Kinks {
  double way = 0.0, turn = 0.0;                ///< first differences
  double way_change = 0.0, turn_change = 0.0;  ///< second differences
};

Kinks kinks_of(const Rig& rig, const Clip& clip) {
  Kinks out;
  std::vector<Pose> world;
  for (std::int64_t f = 0; f < clip.frames(); ++f) {
    world.push_back(world_of(rig, pose_of(clip, f)));
  }
  for (std::int64_t f = 1; f + 1 < clip.frames(); ++f) {
    for (std::int32_t j = 0; j < rig.size(); ++j) {
      const auto turn = [&](std::int64_t from) {
        return Eigen::Vector3d(rotation_log(clip.frame(from + 1)[j].rotation() *
                                            clip.frame(from)[j].rotation().conjugate()));
      };
      const auto at = [&](std::int64_t g) { return world[g][j].translation(); };
      out.way = std::max(out.way, (at(f) - at(f - 1)).norm());
      out.turn = std::max(out.turn, turn(f).norm());
      out.way_change = std::max(out.way_change, (at(f + 1) - 2.0 * at(f) + at(f - 1)).norm());
      out.turn_change = std::max(out.turn_change, (turn(f) - turn(f - 1)).norm());
    }
  }
  return out;
}

TEST(HardWorkload, NothingPops) {
  // A contact that begins or ends takes or gives at most the speed of what touches, at once: a
  // joint's second difference stays below twice the source's largest first difference, in place and
  // in rotation. A pop is a way that belongs to no speed.
  const HardWorkload& work = solved().work;
  const Kinks source = kinks_of(work.rig, work.source);
  const Kinks output = kinks_of(work.rig, solved().run.clip);
  EXPECT_LT(output.way_change, 2.0 * source.way);
  EXPECT_LT(output.turn_change, 2.0 * source.turn);
  // The law can fail: one joint of one frame, moved by a degree, breaks it.
  Clip popped = solved().run.clip;
  DualQuaternion& joint = popped.frame(kFrames / 2)[work.rig.find_role("rightUpperArm")];
  joint = joint * DualQuaternion::from_rotation(Eigen::Quaterniond(
                      Eigen::AngleAxisd(M_PI / 180.0, Eigen::Vector3d::UnitY())));
  EXPECT_GT(kinks_of(work.rig, popped).turn_change, 2.0 * source.turn);
}

}  // namespace
}  // namespace limber::test
