#include "solver/swing_twist.h"

#include <gtest/gtest.h>

#include "tests/solver/test_rigs.h"

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector2d;
using Eigen::Vector3d;
using test::about;
using test::Random;

std::array<Vector3d, 3> triad(Random& random) {
  const Eigen::Matrix3d m = random.rotation().toRotationMatrix();
  return {Vector3d(m.col(0)), Vector3d(m.col(1)), Vector3d(m.col(2))};
}

std::vector<Quaterniond> rotations(Random& random) {
  std::vector<Quaterniond> all{Quaterniond::Identity()};
  for (int i = 0; i < 30; ++i) {
    all.push_back(random.small_rotation(1e-8));
    all.push_back(random.rotation());
    all.push_back(about(random.unit(), M_PI - 1e-9));
    all.push_back(about(random.unit(), M_PI));
  }
  return all;
}

TEST(SwingTwist, ComposeUndoesDecompose) {
  Random random(1);
  for (const Quaterniond& q : rotations(random)) {
    const auto axes = triad(random);
    EXPECT_LT(rotation_angle(compose(decompose(q, axes), axes), q), 1e-14);
    Quaterniond minus = q;
    minus.coeffs() *= -1.0;
    EXPECT_LT(rotation_angle(compose(decompose(minus, axes), axes), q), 1e-14);
    EXPECT_LE(std::abs(decompose(q, axes).twist), M_PI);
  }
}

TEST(SwingTwist, DecomposeUndoesCompose) {
  Random random(2);
  for (int i = 0; i < 200; ++i) {
    const auto axes = triad(random);
    const double a = random.uniform(-M_PI, M_PI), r = random.uniform(0.0, 3.0);
    const SwingTwist in{r * std::cos(a), r * std::sin(a), random.uniform(-3.1, 3.1)};
    const SwingTwist out = decompose(compose(in, axes), axes);
    EXPECT_NEAR(out.swing0, in.swing0, 1e-12);
    EXPECT_NEAR(out.swing1, in.swing1, 1e-12);
    EXPECT_NEAR(out.twist, in.twist, 1e-12);
  }
}

TEST(SwingTwist, SwingTakesTheTwistAxisWhereItGoesTheShortWay) {
  Random random(3);
  for (int i = 0; i < 100; ++i) {
    const auto axes = triad(random);
    const Quaterniond q = random.rotation();
    const SwingTwist s = decompose(q, axes);
    const Vector3d went = q * axes[2];
    const Vector3d shortest = axes[2].cross(went).normalized() * std::acos(axes[2].dot(went));
    EXPECT_LT((s.swing0 * axes[0] + s.swing1 * axes[1] - shortest).norm(), 1e-7);
  }
}

TEST(SwingTwist, CoordinateAxesMeetThePapersFormulas) {
  // Kenwright 2013, eqs. 32-34, put right: twist = (s, along) / hypot, q = swing twist.
  Random random(4);
  for (int axis = 0; axis < 3; ++axis) {
    const Quaterniond q = random.rotation();
    const std::array<Vector3d, 3> axes{Vector3d::Unit((axis + 1) % 3),
                                       Vector3d::Unit((axis + 2) % 3), Vector3d::Unit(axis)};
    const double c = std::hypot(q.w(), q.vec()[axis]);
    Vector3d v = Vector3d::Zero();
    v[axis] = q.vec()[axis] / c;
    const Quaterniond twist(q.w() / c, v.x(), v.y(), v.z());
    const Quaterniond swing = q * twist.conjugate();
    EXPECT_NEAR(swing.vec()[axis], 0.0, 1e-15);
    EXPECT_NEAR(swing.w(), c, 1e-15);
    const SwingTwist s = decompose(q, axes);
    EXPECT_LT(rotation_angle(about(axes[2], s.twist), twist), 1e-14);
  }
}

// ---- the ellipse

struct Ellipse {
  const char* name;
  SwingEllipse e;
};
const Ellipse kEllipses[] = {{"round", {-1, 1, -1, 1}},
                             {"asymmetric", {-0.4, 1.9, -0.7, 0.3}},
                             {"flat", {-1.0, 1.5, -1e-9, 1e-9}},
                             {"no width", {-1.0, 1.2, 0.0, 0.0}},
                             {"half", {0.0, 1.0, -0.5, 0.7}},
                             {"quarter", {0.0, 1.0, 0.0, 0.5}},
                             {"point", {0, 0, 0, 0}},
                             {"aspect 1e6", {-2, 2, -2e-6, 2e-6}}};

TEST(SwingEllipse, NearestPointBeatsEveryOtherPointOfTheSet) {
  Random random(5);
  for (const auto& [name, e] : kEllipses) {
    for (int i = 0; i < 60; ++i) {
      const double reach = i % 3 == 0 ? 0.3 : i % 3 == 1 ? 2.0 : 4.0;
      const Vector2d p(random.uniform(-reach, reach), random.uniform(-reach, reach));
      const Vector2d y = e.project(p);
      EXPECT_LE(e.level(y), 1.0 + 1e-12) << name;
      for (int k = 0; k < 720; ++k) {
        const double c = std::cos(k * M_PI / 360), s = std::sin(k * M_PI / 360);
        const Vector2d other(c * (c < 0 ? -e.min0 : e.max0), s * (s < 0 ? -e.min1 : e.max1));
        // Convex set: no point of it lies beyond the plane at y facing p.
        EXPECT_LE((p - y).dot(other - y), 1e-12) << name;
      }
    }
  }
}

TEST(SwingEllipse, InsideStaysAndBorderStaysAndProjectingTwiceIsProjectingOnce) {
  Random random(6);
  for (const auto& [name, e] : kEllipses) {
    for (int i = 0; i < 100; ++i) {
      const double a = random.uniform(-M_PI, M_PI), r = random.uniform(0.0, 0.999);
      const double c = std::cos(a), s = std::sin(a);
      const Vector2d border(c * (c < 0 ? -e.min0 : e.max0), s * (s < 0 ? -e.min1 : e.max1));
      const Vector2d inside = r * border;
      EXPECT_EQ(e.project(inside), inside) << name;
      EXPECT_LT((e.project(border) - border).norm(), 1e-14) << name;
      const Vector2d once =
          e.project(random.uniform(1.0, 5.0) * border + random.vector().head<2>());
      EXPECT_LT((e.project(once) - once).norm(), 1e-14) << name;
    }
  }
}

TEST(SwingEllipse, OnAxesAndFarAway) {
  const SwingEllipse e{-0.4, 1.9, -0.7, 0.3};
  EXPECT_LT((e.project({5.0, 0.0}) - Vector2d(1.9, 0.0)).norm(), 1e-14);
  EXPECT_LT((e.project({-5.0, 0.0}) - Vector2d(-0.4, 0.0)).norm(), 1e-14);
  EXPECT_LT((e.project({0.0, 2.0}) - Vector2d(0.0, 0.3)).norm(), 1e-14);
  EXPECT_LT((e.project({0.0, -2.0}) - Vector2d(0.0, -0.7)).norm(), 1e-14);
  EXPECT_TRUE(e.project({1e9, -1e9}).allFinite());
}

TEST(SwingEllipse, CurvatureIsThatOfTheBorder) {
  const SwingEllipse e{-0.4, 1.9, -0.7, 0.3};
  const auto at = [](double t) { return Vector2d(1.9 * std::cos(t), 0.3 * std::sin(t)); };
  for (const double t : {0.1, 0.5, 1.0, 1.5}) {
    const double h = 1e-4;
    const Vector2d d1 = (at(t + h) - at(t - h)) / (2 * h);
    const Vector2d d2 = (at(t + h) - 2 * at(t) + at(t - h)) / (h * h);
    const double kappa = (d1.x() * d2.y() - d1.y() * d2.x()) / std::pow(d1.norm(), 3);
    EXPECT_NEAR(e.curvature(at(t)) / kappa, 1.0, 1e-5);
  }
}

// ---- joints

RigJoint ball(Random& random) {
  RigJoint joint = test::random_joint(random, JointType::ball, -1, 0);
  // Twist ranges need not hold zero, nor be narrow; swings may reach far.
  const double low = random.uniform(-3.0, 2.5);
  joint.limits[2] = {low, random.uniform(low, 3.1)};
  if (random.integer(0, 4) == 0) joint.limits[0] = {-3.0, 3.1};
  if (random.integer(0, 4) == 0) joint.limits[1] = {0.0, 0.0};
  return joint;
}

TEST(Limits, AnyRotationEndsWithinThem) {
  Random random(7);
  for (int trial = 0; trial < 2000; ++trial) {
    const JointType types[] = {JointType::hinge, JointType::universal, JointType::ball};
    const JointType type = types[trial % 3];
    const RigJoint joint =
        type == JointType::ball ? ball(random) : test::random_joint(random, type, -1, 0);
    const Quaterniond out = project_into_limits(joint, random.rotation());
    EXPECT_NEAR(out.norm(), 1.0, 1e-12);
    EXPECT_LT(test::excess(joint, out), 1e-5 * M_PI / 180.0) << to_string(type);
  }
}

TEST(Limits, ProjectingTwiceIsProjectingOnceBitForBit) {
  Random random(8);
  for (int trial = 0; trial < 3000; ++trial) {
    const JointType types[] = {JointType::hinge, JointType::universal, JointType::ball};
    const JointType type = types[trial % 3];
    const RigJoint joint =
        type == JointType::ball ? ball(random) : test::random_joint(random, type, -1, 0);
    const Quaterniond once = project_into_limits(joint, random.rotation());
    const Quaterniond twice = project_into_limits(joint, once);
    EXPECT_EQ(once.coeffs(), twice.coeffs()) << to_string(type) << " " << trial;
  }
}

TEST(Limits, InsideComesBackBitForBit) {
  Random random(9);
  for (int trial = 0; trial < 2000; ++trial) {
    const JointType types[] = {JointType::hinge, JointType::universal, JointType::ball};
    const RigJoint joint = test::random_joint(random, types[trial % 3], -1, 0);
    Quaterniond in = test::allowed_rotation(random, joint);
    if (trial % 2 == 0) in.coeffs() *= -1.0;
    EXPECT_EQ(project_into_limits(joint, in).coeffs(), in.coeffs());
  }
}

TEST(Limits, NearestInItsCoordinates) {
  Random random(10);
  for (int trial = 0; trial < 200; ++trial) {
    const RigJoint joint = test::random_joint(random, JointType::ball, -1, 0);
    const SwingTwist in{random.uniform(-2, 2), random.uniform(-2, 2), random.uniform(-2, 2)};
    const SwingTwist out =
        decompose(project_into_limits(joint, compose(in, joint.axes)), joint.axes);
    const auto apart = [&](const SwingTwist& s) {
      return std::hypot(s.swing0 - in.swing0, s.swing1 - in.swing1);
    };
    EXPECT_NEAR(out.twist, std::clamp(in.twist, joint.limits[2].min, joint.limits[2].max), 1e-10);
    for (int i = 0; i < 200; ++i) {
      const SwingTwist other = decompose(test::allowed_rotation(random, joint), joint.axes);
      EXPECT_GE(apart(other), apart(out) - 1e-10);
    }
  }
}

TEST(Limits, HalfTurnSwingsWithTwistRangesThatExcludeZero) {
  Random random(11);
  for (int trial = 0; trial < 200; ++trial) {
    RigJoint joint = ball(random);
    joint.limits[0] = joint.limits[1] = {-M_PI, M_PI};
    joint.limits[2] = {0.5, 1.0};
    const Vector3d axis =
        (random.uniform(-1, 1) * joint.axes[0] + random.uniform(-1, 1) * joint.axes[1])
            .normalized();
    const Quaterniond out = project_into_limits(joint, about(axis, M_PI));
    EXPECT_LT(test::excess(joint, out), 1e-7);
    EXPECT_EQ(project_into_limits(joint, out).coeffs(), out.coeffs());
  }
}

TEST(Limits, RangesTakeAnglesByTheShortWay) {
  RigJoint hinge;
  hinge.type = JointType::hinge;
  hinge.axes[0] = Vector3d::UnitX();
  hinge.limits[0] = {2.0, 2.8};
  // -2.9 rad is 3.38: 0.58 beyond the top, and much further from the bottom.
  const Quaterniond top = project_into_limits(hinge, about(Vector3d::UnitX(), -2.9));
  EXPECT_LT(rotation_angle(top, about(Vector3d::UnitX(), 2.8)), 1e-14);
  const Quaterniond bottom = project_into_limits(hinge, about(Vector3d::UnitX(), 0.1));
  EXPECT_LT(rotation_angle(bottom, about(Vector3d::UnitX(), 2.0)), 1e-14);
  hinge.limits[0] = {-4.0, 4.0};  // more than a turn: no limit
  const Quaterniond any = about(Vector3d::UnitX(), 3.0);
  EXPECT_EQ(project_into_limits(hinge, any).coeffs(), any.coeffs());
}

TEST(Limits, PosesKeepOffsetsAndFixedJointsTheirRest) {
  Random random(12);
  for (int trial = 0; trial < 30; ++trial) {
    const Rig rig = test::random_rig(random, 8, 0);
    Pose pose;
    for (int i = 0; i < 8; ++i) pose.push_back(random.motion());
    project_into_limits(rig, pose);
    EXPECT_LT(test::worst_excess(rig, pose), 1e-8);
    Pose again = pose;
    project_into_limits(rig, again);
    for (int i = 0; i < 8; ++i) {
      EXPECT_EQ(again[i].real.coeffs(), pose[i].real.coeffs());
      EXPECT_EQ(again[i].dual.coeffs(), pose[i].dual.coeffs());
    }
  }
}

}  // namespace
}  // namespace limber
