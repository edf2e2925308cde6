// Kenwright 2013 against itself: what its equations say, its errata put right, by independent
// computation.
#include <gtest/gtest.h>

#include "solver/joint_chart.h"
#include "solver/paper_ik.h"
#include "tests/solver/test_rigs.h"

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;
using test::Random;

/// The exponential of any quaternion by its power series.
Quaterniond exponential_series(const Quaterniond& q) {
  Quaterniond sum(1, 0, 0, 0), term(1, 0, 0, 0);
  for (int k = 1; k < 60; ++k) {
    term = term * q;
    term.coeffs() /= k;
    sum.coeffs() += term.coeffs();
  }
  return sum;
}

TEST(PaperEquations, Eq6TheAxisAngleVectorIsTheLogarithm) {
  Random random(1);
  for (int i = 0; i < 50; ++i) {
    const Vector3d n = random.unit();
    const double theta = random.uniform(0.1, 3.1);
    // Eq. 3.
    const Vector3d v = std::sin(0.5 * theta) * n;
    const Quaterniond q(std::cos(0.5 * theta), v.x(), v.y(), v.z());
    EXPECT_LT((rotation_log(q) - theta * n).norm(), 1e-13);
    // The exponential leads from the vector (half of it: q turns by q x q*) to the quaternion,
    const Vector3d half = 0.5 * theta * n;
    const Quaterniond up = exponential_series({0.0, half.x(), half.y(), half.z()});
    EXPECT_LT((up.coeffs() - q.coeffs()).norm(), 1e-13);
    EXPECT_LT((rotation_exp<double>(theta * n).coeffs() - q.coeffs()).norm(), 1e-13);
    // and the exponential of the quaternion, as printed, is no such vector: its norm is e^qs.
    const Quaterniond printed = exponential_series(q);
    EXPECT_NEAR(printed.norm(), std::exp(q.w()), 1e-12);
    EXPECT_GT((printed.vec() - theta * n).norm() + std::abs(printed.w()), 0.1);
  }
}

/// Eqs. 32-34: swing and twist of q about coordinate axis 0, 1 or 2, in coefficients.
struct Factors {
  Quaterniond swing, twist;
};
Factors eqs_32_to_34(const Quaterniond& q, int axis) {
  const double s = q.w(), x = q.x(), y = q.y(), z = q.z();
  const double c = std::hypot(s, q.vec()[axis]);
  switch (axis) {
    case 0:
      return {{c, 0.0, (s * y - x * z) / c, (s * z + x * y) / c}, {s / c, x / c, 0.0, 0.0}};
    case 1:
      return {{c, (s * x + y * z) / c, 0.0, (s * z - x * y) / c}, {s / c, 0.0, y / c, 0.0}};
    default:
      return {{c, (s * x - y * z) / c, (s * y + x * z) / c, 0.0}, {s / c, 0.0, 0.0, z / c}};
  }
}

TEST(PaperEquations, Eqs32To34AreUnitFactorsAndOurs) {
  Random random(2);
  for (int i = 0; i < 100; ++i) {
    const Quaterniond q = random.rotation();
    for (int axis = 0; axis < 3; ++axis) {
      const Factors f = eqs_32_to_34(q, axis);
      EXPECT_NEAR(f.swing.norm(), 1.0, 1e-14);
      EXPECT_NEAR(f.twist.norm(), 1.0, 1e-14);
      EXPECT_LT(((f.swing * f.twist).coeffs() - q.coeffs()).norm(), 1e-14);
      const std::array<Vector3d, 3> axes{Vector3d::Unit((axis + 1) % 3),
                                         Vector3d::Unit((axis + 2) % 3), Vector3d::Unit(axis)};
      const SwingTwist ours = decompose(q, axes);
      const Vector3d swing = ours.swing0 * axes[0] + ours.swing1 * axes[1];
      EXPECT_LT(rotation_angle(rotation_exp(swing), f.swing), 1e-13);
      EXPECT_LT(rotation_angle(rotation_exp<double>(ours.twist * axes[2]), f.twist), 1e-13);
    }
  }
}

TEST(PaperEquations, Eq34AsPrintedIsNoUnitQuaternion) {
  Random random(3);
  for (int i = 0; i < 50; ++i) {
    const Quaterniond q = random.rotation();
    const double s = q.w(), x = q.x(), y = q.y(), z = q.z();
    const double c2 = s * s + z * z;
    const double norm2 =
        c2 + (std::pow(s * x - y * z, 2) + std::pow(s * y - x * z, 2)) / c2;  // as printed
    EXPECT_NEAR(norm2, 1.0 - 4.0 * s * x * y * z / c2, 1e-14);
    EXPECT_NEAR(eqs_32_to_34(q, 2).swing.squaredNorm(), 1.0, 1e-14);
  }
}

/// A rig of hinges and universal joints, whose coordinates are the angles themselves.
Rig angles_only(Random& random) {
  Rig rig;
  for (int i = 0; i < 6; ++i) {
    const JointType type = i % 2 == 0 ? JointType::hinge : JointType::universal;
    RigJoint joint = test::random_joint(random, type, i == 0 ? -1 : random.integer(0, i - 1), i);
    joint.limits = {};
    rig.joints.push_back(joint);
  }
  const EffectorKind kinds[] = {EffectorKind::pose, EffectorKind::position,
                                EffectorKind::orientation, EffectorKind::direction,
                                EffectorKind::line};
  for (int e = 0; e < 5; ++e) {
    rig.effectors.push_back({.name = std::to_string(e),
                             .joint = random.integer(0, 5),
                             .offset = random.vector(0.2),
                             .kind = kinds[e],
                             .axis = random.unit()});
  }
  for (int j = 0; j < 6; ++j) {  // so that every joint counts
    rig.effectors.push_back({.name = "end " + std::to_string(j), .joint = j});
  }
  return rig;
}

TEST(PaperEquations, Eq23TargetMinusCurrentLeadsDownhill) {
  // b = J'(target - current) is minus half the gradient of the cost, measured by moving along it.
  // With eq. 26's sign it would be uphill.
  Random random(4);
  for (int trial = 0; trial < 30; ++trial) {
    const Rig rig = angles_only(random);
    const auto targets = test::targets_at(rig, test::allowed_pose(random, rig));
    PaperIk ik(rig, {});
    Pose pose = test::allowed_pose(random, rig);
    ik.linearise(targets, pose);
    const Eigen::VectorXd b = ik.problem().b, at = ik.coordinates();
    ASSERT_EQ(b.size(), dof_count(rig));
    const auto cost_at = [&](double along) {
      const Eigen::VectorXd q = at + along * b / b.norm();
      Pose there(pose.size());
      pose_from_coordinates(rig, {q.data(), static_cast<std::size_t>(q.size())}, there);
      return test::objective(rig, targets, there);
    };
    const double h = 1e-5, slope = (cost_at(h) - cost_at(-h)) / (2.0 * h);
    EXPECT_LT(slope, 0.0);
    EXPECT_NEAR(slope, -2.0 * b.norm(), 1e-7 * (1.0 + b.norm()));
  }
}

TEST(PaperEquations, Eqs28To30TheNormalEquationsAreThoseOfTheRows) {
  Random random(5);
  for (int trial = 0; trial < 30; ++trial) {
    const Rig rig = test::random_rig(random, 10, 7);
    const double delta = 1e-3;
    PaperIk ik(rig, {.damping = delta});
    auto targets = test::targets_at(rig, test::allowed_pose(random, rig));
    for (EffectorTarget& target : targets) target.weight = random.uniform(0.0, 2.0);
    Pose pose = test::allowed_pose(random, rig);
    ik.linearise(targets, pose);
    const Eigen::MatrixXd& j = ik.jacobian();
    const Eigen::MatrixXd a =
        j.transpose() * j + delta * Eigen::MatrixXd::Identity(j.cols(), j.cols());
    EXPECT_LT((ik.problem().a - a).cwiseAbs().maxCoeff(), 1e-13);
    EXPECT_LT((ik.problem().b - j.transpose() * ik.error()).cwiseAbs().maxCoeff(), 1e-13);
  }
}

TEST(PaperEquations, ShiftedExponentialMapsAreTheSameRotationWithinPi) {
  Random random(6);
  for (int i = 0; i < 200; ++i) {
    const double angle = random.uniform(0.0, 3.5 * M_PI);
    const Vector3d w = angle * random.unit(), shifted = shift_exponential_map(w);
    EXPECT_LE(shifted.norm(), M_PI + 1e-14);
    EXPECT_LT(rotation_angle(rotation_exp(w), rotation_exp(shifted)), 1e-13);
    if (angle <= M_PI) {
      EXPECT_EQ(shifted, w);
    } else if (angle < 2.0 * M_PI) {
      EXPECT_LT((shifted - (1.0 - 2.0 * M_PI / angle) * w).norm(), 1e-14);
    }
  }
}

TEST(PaperEquations, ChartsReadBackWhatTheyMake) {
  Random random(7);
  for (const JointType type :
       {JointType::hinge, JointType::universal, JointType::ball, JointType::free}) {
    for (const bool limited : {true, false}) {
      for (int trial = 0; trial < 40; ++trial) {
        RigJoint joint = test::random_joint(random, type, -1, 0);
        if (!limited) joint.limits = {};
        Rig rig;
        rig.joints.push_back(joint);
        const Pose pose = test::allowed_pose(random, rig);
        const JointChart chart(joint);
        double w[JointChart::kMost] = {};
        chart.coordinates(pose[0], w);
        const DualQuaternion back = chart.parent_from_joint(w);
        EXPECT_LT((back.matrix() - pose[0].matrix()).norm(), 1e-12);
      }
    }
  }
}

}  // namespace
}  // namespace limber
