#include "validation/limit_check.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "validation/joint_angles.h"

namespace limber {
namespace {

constexpr double kRad = M_PI / 180.0;
using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;

RigJoint hinge() {
  RigJoint joint;
  joint.name = "hinge";
  joint.type = JointType::hinge;
  joint.axes[0] = Vector3d(1, 2, 2) / 3.0;
  joint.limits[0] = {-0.2, 1.5};
  joint.rest = Quaterniond(AngleAxisd(0.7, Vector3d(2, -1, 2) / 3.0));
  return joint;
}

RigJoint universal() {
  RigJoint joint = hinge();
  joint.name = "universal";
  joint.type = JointType::universal;
  joint.axes[1] = Vector3d(2, 1, -2) / 3.0;
  joint.limits = {Range{-0.5, 0.9}, Range{-1.2, 0.3}, Range{}};
  return joint;
}

RigJoint ball() {
  RigJoint joint = universal();
  joint.name = "ball";
  joint.type = JointType::ball;
  joint.axes[2] = joint.axes[0].cross(joint.axes[1]);
  joint.limits = {Range{-0.6, 1.1}, Range{-0.3, 0.8}, Range{-0.9, 0.4}};
  return joint;
}

Quaterniond ball_local(const RigJoint& joint, double s0, double s1, double twist) {
  const Vector3d swing = s0 * joint.axes[0] + s1 * joint.axes[1];
  return joint.rest * Quaterniond(AngleAxisd(swing.norm(), swing.stableNormalized())) *
         Quaterniond(AngleAxisd(twist, joint.axes[2]));
}

Quaterniond hinge_local(const RigJoint& joint, double q) {
  return joint.rest * Quaterniond(AngleAxisd(q, joint.axes[0]));
}

Quaterniond universal_local(const RigJoint& joint, double q0, double q1) {
  return joint.rest * Quaterniond(AngleAxisd(q0, joint.axes[0])) *
         Quaterniond(AngleAxisd(q1, joint.axes[1]));
}

TEST(LimitCheck, HingeExcessIsTheAngleBeyondItsRange) {
  const RigJoint joint = hinge();
  for (const double inside : {-0.2, 0.0, 0.7, 1.5}) {
    EXPECT_LT(limit_excess(joint, hinge_local(joint, inside)), 1e-14);
  }
  EXPECT_NEAR(limit_excess(joint, hinge_local(joint, 1.5 + kRad)), kRad, 1e-14);
  EXPECT_NEAR(limit_excess(joint, hinge_local(joint, -0.2 - 0.3)), 0.3, 1e-14);
  // Whole turns are the same rotation; the far side is nearer to the other end.
  EXPECT_NEAR(limit_excess(joint, hinge_local(joint, 0.3 + 2.0 * M_PI)), 0.0, 1e-14);
  EXPECT_NEAR(limit_excess(joint, hinge_local(joint, -2.9)), 2.0 * M_PI - 2.9 - 1.5, 1e-13);
  EXPECT_NEAR(limit_excess(joint, hinge_local(joint, 3.1)), 3.1 - 1.5, 1e-13);
}

TEST(LimitCheck, HingeThatTurnsOffItsAxisIsBeyondItsLimit) {
  RigJoint joint = hinge();
  const Vector3d sideways = joint.axes[0].unitOrthogonal();
  const Quaterniond local = hinge_local(joint, 0.4) * Quaterniond(AngleAxisd(0.02, sideways));
  EXPECT_NEAR(limit_excess(joint, local), 0.02, 1e-12);
  joint.limits[0] = Range{};
  EXPECT_NEAR(limit_excess(joint, local), 0.02, 1e-12) << "an unlimited hinge still has one axis";
}

TEST(LimitCheck, UniversalExcessIsTheAngleBeyondItsBox) {
  const RigJoint joint = universal();
  EXPECT_LT(limit_excess(joint, universal_local(joint, 0.9, -1.2)), 1e-14);
  EXPECT_LT(limit_excess(joint, universal_local(joint, -0.2, 0.1)), 1e-14);
  // One angle beyond: turning that one back by its excess suffices, and at q1 = 0 nothing is
  // shorter.
  EXPECT_NEAR(limit_excess(joint, universal_local(joint, 0.9 + kRad, 0.0)), kRad, 1e-9);
  EXPECT_NEAR(limit_excess(joint, universal_local(joint, 0.1, 0.3 + kRad)), kRad, 1e-12);
  // A turn about the axis it does not have.
  const Vector3d third = joint.axes[0].cross(joint.axes[1]);
  const Quaterniond turned = universal_local(joint, 0, 0) * Quaterniond(AngleAxisd(0.03, third));
  EXPECT_NEAR(limit_excess(joint, turned), 0.03, 1e-6);
}

TEST(LimitCheck, BallIsAllowedExactlyInsideItsEllipseAndTwistRange) {
  const RigJoint joint = ball();
  std::mt19937 random(7);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  int inside = 0;
  for (int i = 0; i < 20000; ++i) {
    const double s0 = 2.0 * unit(random), s1 = 2.0 * unit(random), twist = 1.5 * unit(random);
    if (std::hypot(s0, s1) > 3.0) continue;
    const double a = s0 < 0 ? 0.6 : 1.1, b = s1 < 0 ? 0.3 : 0.8;
    const double level = (s0 / a) * (s0 / a) + (s1 / b) * (s1 / b);
    const bool allowed = level <= 1.0 && twist >= -0.9 && twist <= 0.4;
    if (std::abs(level - 1.0) < 1e-9) continue;
    const double excess = limit_excess(joint, ball_local(joint, s0, s1, twist));
    EXPECT_EQ(excess < 1e-12, allowed) << s0 << " " << s1 << " " << twist << ": " << excess;
    inside += allowed;
  }
  EXPECT_GT(inside, 500);
}

TEST(LimitCheck, BallExcessIsTheDistanceToTheEllipse) {
  const RigJoint joint = ball();
  EXPECT_NEAR(limit_excess(joint, ball_local(joint, 1.1 + kRad, 0.0, 0.1)), kRad, 1e-12);
  EXPECT_NEAR(limit_excess(joint, ball_local(joint, 0.0, -0.3 - kRad, 0.1)), kRad, 1e-12);
  EXPECT_NEAR(limit_excess(joint, ball_local(joint, 0.3, 0.2, 0.4 + kRad)), kRad, 1e-12);
  EXPECT_NEAR(limit_excess(joint, ball_local(joint, 1.1 + 0.03, 0.0, 0.4 + 0.04)), 0.05, 1e-12);
  // Anywhere around: against a fine walk along the boundary.
  std::mt19937 random(11);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  for (int i = 0; i < 50; ++i) {
    const Eigen::Vector2d s(1.6 * unit(random), 1.6 * unit(random));
    double nearest = 1e9;
    for (int step = 0; step < 40000; ++step) {
      const double t = 2.0 * M_PI * step / 40000.0, c = std::cos(t), sn = std::sin(t);
      const Eigen::Vector2d p(c * (c < 0 ? 0.6 : 1.1), sn * (sn < 0 ? 0.3 : 0.8));
      nearest = std::min(nearest, (p - s).norm());
    }
    const double a = s[0] < 0 ? 0.6 : 1.1, b = s[1] < 0 ? 0.3 : 0.8;
    if (std::pow(s[0] / a, 2) + std::pow(s[1] / b, 2) <= 1.0) nearest = 0.0;
    EXPECT_NEAR(limit_excess(joint, ball_local(joint, s[0], s[1], 0.0)), nearest, 1e-6);
  }
}

TEST(LimitCheck, ALockedSwingAxisAllowsTheOtherOne) {
  RigJoint joint = ball();
  joint.limits[0] = {0.0, 0.0};
  EXPECT_LT(limit_excess(joint, ball_local(joint, 0.0, 0.8, 0.0)), 1e-12);
  EXPECT_NEAR(limit_excess(joint, ball_local(joint, 0.01, 0.2, 0.0)), 0.01, 1e-12);
}

TEST(LimitCheck, AnglesComeBackAsTheyWerePutIn) {
  const RigJoint joint = ball();
  std::mt19937 random(3);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  for (int i = 0; i < 1000; ++i) {
    const double s0 = 2.2 * unit(random), s1 = 2.2 * unit(random), twist = 3.1 * unit(random);
    const Eigen::Vector3d q =
        joint_angles(joint, joint_rotation(joint, ball_local(joint, s0, s1, twist)));
    EXPECT_NEAR((q - Vector3d(s0, s1, twist)).norm(), 0.0, 1e-9);
  }
  const Vector3d half_turn =
      joint_angles(joint, joint_rotation(joint, ball_local(joint, M_PI * 0.6, M_PI * 0.8, 0.0)));
  EXPECT_NEAR(half_turn.head<2>().norm(), M_PI, 1e-7);
}

struct Fixture {
  Rig rig;
  Clip clip;
};

Fixture moving_arm() {
  Fixture f;
  f.rig.joints = {hinge(), universal(), ball()};
  f.rig.joints[1].parent = 0;
  f.rig.joints[2].parent = 1;
  f.clip.joints = 3;
  for (int frame = 0; frame < 120; ++frame) {
    const double t = frame / 119.0;
    const Quaterniond local[] = {
        hinge_local(f.rig.joints[0], -0.2 + 1.7 * t),
        universal_local(f.rig.joints[1], 0.9 * t, -1.2 * t),
        ball_local(f.rig.joints[2], 1.1 * t, 0.1 * std::sin(3.1 * t), 0.4 * t)};
    for (const Quaterniond& q : local) {
      f.clip.parent_from_joint.push_back(DualQuaternion::from_rotation(q));
    }
  }
  return f;
}

TEST(LimitCheck, APlantedDegreeIsFoundAtItsJointAndFrame) {
  Fixture f = moving_arm();
  EXPECT_EQ(check_joint_limits(f.rig, f.clip).joints, 3);
  const LimitReport clean = check_joint_limits(f.rig, f.clip, 0.02);
  EXPECT_EQ(clean.violations, 0);
  for (int joint = 0; joint < 3; ++joint) {
    Fixture planted = moving_arm();
    const RigJoint& j = planted.rig.joints[joint];
    const Quaterniond q = joint == 0   ? hinge_local(j, 1.5 + kRad)
                          : joint == 1 ? universal_local(j, 0.2, 0.3 + kRad)
                                       : ball_local(j, 0.0, 0.8 + kRad, 0.1);
    planted.clip.frame(77)[joint] = DualQuaternion::from_rotation(q);
    const LimitReport report = check_joint_limits(planted.rig, planted.clip, 0.9 * kRad);
    ASSERT_EQ(report.violations, 1);
    ASSERT_EQ(report.worst.size(), 1u);
    EXPECT_EQ(report.worst[0].joint, joint);
    EXPECT_EQ(report.worst[0].frame, 77);
    EXPECT_NEAR(report.worst[0].excess_rad, kRad, 1e-9);
    EXPECT_NEAR(report.max_violation_deg, 1.0, 1e-6);
    const ClipExcess excess = limit_excess(planted.rig, planted.clip, 0.9 * kRad);
    ASSERT_EQ(excess.joints.size(), 1u);
    EXPECT_EQ(excess.joints[0].joint, joint);
    EXPECT_EQ(excess.joints[0].frames, 1);
    EXPECT_NEAR(excess.max_deg[77], 1.0, 1e-6);
    EXPECT_LT(excess.max_deg[76], 1e-6);
  }
}

TEST(LimitCheck, FramesBeyondALimitAreCountedByHowFar) {
  Fixture planted = moving_arm();
  const double beyond_deg[] = {0.5, 1.5, 3.0, 4.9, 7.0, 15.0, 30.0, 46.0, 60.0};
  for (int i = 0; i < 9; ++i) {
    planted.clip.frame(10 + i)[0] = DualQuaternion::from_rotation(
        hinge_local(planted.rig.joints[0], 1.5 + beyond_deg[i] * kRad));
  }
  const ClipExcess excess = limit_excess(planted.rig, planted.clip, kRad);
  ASSERT_EQ(excess.joints.size(), 1u);
  EXPECT_EQ(excess.joints[0].frames, 8) << "half a degree is within the tolerance";
  EXPECT_EQ(excess.joints[0].frames_by_excess, (std::array<std::int64_t, 6>{1, 2, 1, 1, 1, 2}));
  EXPECT_NEAR(excess.joints[0].max_deg, 60.0, 1e-6);
  for (int i = 0; i < 9; ++i) EXPECT_NEAR(excess.max_deg[10 + i], beyond_deg[i], 1e-6);
}

TEST(LimitCheck, TimeOnALimitIsCountedByJointAndByFrame) {
  Fixture f = moving_arm();
  const auto pose = [&](std::int64_t frame, double hinge, double ball_twist) {
    const auto& joints = f.rig.joints;
    f.clip.frame(frame)[0] = DualQuaternion::from_rotation(hinge_local(joints[0], hinge));
    f.clip.frame(frame)[1] = DualQuaternion::from_rotation(universal_local(joints[1], 0.0, 0.0));
    f.clip.frame(frame)[2] =
        DualQuaternion::from_rotation(ball_local(joints[2], 0.0, 0.8, ball_twist));
  };
  for (std::int64_t frame = 0; frame < f.clip.frames(); ++frame) pose(frame, 0.5, 0.1);
  // All the while on the ball's swing border (0.8), and on its twist's as well in frame 3: one
  // joint, counted once.
  pose(3, 1.5, 0.4);
  pose(4, 1.5, 0.1);
  const LimitOccupancy occupancy = limit_occupancy(f.rig, f.clip);
  EXPECT_EQ(occupancy.frames, (std::vector<std::int64_t>{2, 0, f.clip.frames()}));
  EXPECT_EQ(occupancy.joints[2], 1);
  EXPECT_EQ(occupancy.joints[3], 2);
  EXPECT_EQ(occupancy.joints[4], 2);
}

TEST(LimitCheck, NaNIsAViolation) {
  Fixture f = moving_arm();
  f.clip.frame(5)[1].real.w() = std::nan("");
  EXPECT_GE(check_joint_limits(f.rig, f.clip, 0.02).violations, 1);
}

TEST(LimitCheck, JointsThatRideOnALimitAreNamed) {
  Fixture f = moving_arm();
  EXPECT_EQ(joints_at_limit(f.rig, f.clip, 0.01), (std::vector<std::int32_t>{0, 1, 2}));
  for (std::int64_t frame = 0; frame < f.clip.frames(); ++frame) {
    f.clip.frame(frame)[1] = DualQuaternion::from_rotation(universal_local(f.rig.joints[1], 0, 0));
  }
  EXPECT_EQ(joints_at_limit(f.rig, f.clip, 0.01), (std::vector<std::int32_t>{0, 2}));
}

// ---------------------------------------------------------------------------- contacts

std::vector<std::string> contacts_of(const RigJoint& joint, const Quaterniond& local) {
  Rig rig;
  rig.joints = {joint};
  const std::vector<DualQuaternion> pose = {
      DualQuaternion::from_rotation_translation(local, Vector3d::Zero())};
  std::vector<std::string> words;
  for (const LimitContact& c : limit_contacts(rig, pose)) {
    words.push_back(std::string(c.coordinate) + " " + c.side);
  }
  return words;
}

TEST(LimitContacts, NameTheCoordinateAndTheSide) {
  using Words = std::vector<std::string>;
  EXPECT_EQ(contacts_of(hinge(), hinge_local(hinge(), 1.4995)), Words{"angle max"});
  EXPECT_EQ(contacts_of(hinge(), hinge_local(hinge(), -0.2)), Words{"angle min"});
  EXPECT_EQ(contacts_of(hinge(), hinge_local(hinge(), 1.49)), Words{});
  EXPECT_EQ(contacts_of(universal(), universal_local(universal(), 0.9, -1.2)),
            (Words{"angle0 max", "angle1 min"}));
  // On the ellipse, off both axes: (0.8 * 1.1, 0.6 * 0.8) has level 1.
  EXPECT_EQ(contacts_of(ball(), ball_local(ball(), 0.88, 0.48, 0.0)), Words{"swing border"});
  EXPECT_EQ(contacts_of(ball(), ball_local(ball(), 0.8, 0.4, 0.4)), Words{"twist max"});
  EXPECT_EQ(contacts_of(ball(), ball_local(ball(), 0.8, 0.4, 0.0)), Words{});
}

TEST(LimitContacts, LockedRangesAreNoNews) {
  RigJoint joint = hinge();
  joint.limits[0] = {0.3, 0.3};
  EXPECT_TRUE(contacts_of(joint, hinge_local(joint, 0.3)).empty());
}

}  // namespace
}  // namespace limber
