#include "solver/resolved_rate.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <Eigen/QR>
#include <Eigen/SVD>

#include "tests/solver/allocation_count.h"
#include "tests/solver/arm_reach.h"

namespace limber {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;
using test::ArmReach;
using test::Random;

ResolvedRate make(const Rig& rig, const ResolvedRateOptions& options = {}) {
  Result<ResolvedRate> made = ResolvedRate::create(rig, options);
  if (!made) throw std::runtime_error(made.error().message);
  return std::move(made.value());
}

Matrix3d cross_matrix(const Vector3d& v) {
  Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

int rank_of(const MatrixXd& m) {
  Eigen::JacobiSVD<MatrixXd> svd(m);
  svd.setThreshold(1e-9);
  return static_cast<int>(svd.rank());
}

/// What the effectors are now, as rows: points and Pluecker lines, by matrices.
VectorXd rows_of(const Rig& rig, const Pose& pose) {
  const Pose world = test::world_of(rig, pose);
  std::vector<double> rows;
  for (const RigEffector& e : rig.effectors) {
    const Eigen::Matrix4d m = world[e.joint].matrix();
    const Vector3d p = (m * e.offset.homogeneous()).head<3>();
    const Vector3d n = m.topLeftCorner<3, 3>() * e.axis, moment = p.cross(n);
    const bool line = e.kind == EffectorKind::line;
    for (int k = 0; k < 3; ++k) rows.push_back(line ? n[k] : p[k]);
    for (int k = 0; line && k < 3; ++k) rows.push_back(moment[k]);
  }
  return Eigen::Map<VectorXd>(rows.data(), rows.size());
}

std::vector<MovingTransform> random_targets(Random& random, const Rig& rig) {
  std::vector<MovingTransform> targets;
  for (std::size_t e = 0; e < rig.effectors.size(); ++e) {
    targets.push_back({random.motion(), {random.vector(), random.vector()}});
  }
  return targets;
}

/// A tree of every joint type with points and lines on it.
Rig random_task_rig(Random& random) {
  Rig rig = test::random_rig(random, 7, 4);
  rig.joints[0] = test::random_joint(random, JointType::hinge, -1, 0);
  for (std::size_t e = 0; e < rig.effectors.size(); ++e) {
    rig.effectors[e].kind = e % 2 == 0 ? EffectorKind::position : EffectorKind::line;
  }
  return rig;
}

TEST(ResolvedRate, JacobianIsHowItsStepsMoveTheEffectors) {
  Random random(1);
  for (int trial = 0; trial < 60; ++trial) {
    const Rig rig = random_task_rig(random);
    const double h = 1e-6;
    ResolvedRate control = make(rig, {.step_s = h, .feedback = 0.0});
    const auto targets = random_targets(random, rig);
    const Pose start = test::allowed_pose(random, rig);
    Pose ahead = start;
    control.step(targets, ahead);
    const VectorXd x = control.velocity();
    const VectorXd slope = (rows_of(rig, ahead) - rows_of(rig, start)) / h;
    const VectorXd expected = control.jacobian() * x;
    EXPECT_LT((slope - expected).norm(), 1e-4 * (1.0 + x.squaredNorm())) << trial;
  }
}

TEST(ResolvedRate, VelocityIsNearestToTheWishAmongThoseThatDoTheTask) {
  Random random(2);
  for (int trial = 0; trial < 60; ++trial) {
    const Rig rig = random_task_rig(random);
    ResolvedRate control = make(rig, {.feedback = 0.0});
    const auto targets = random_targets(random, rig);
    Pose pose = test::allowed_pose(random, rig);
    Pose same = pose;
    control.step(targets, pose);
    const VectorXd plain = control.velocity();
    const VectorXd wish = VectorXd::NullaryExpr(plain.size(), [&] { return random.normal(); });
    control.step(targets, same, {wish.data(), static_cast<std::size_t>(wish.size())});
    const MatrixXd& j = control.jacobian();
    Eigen::CompleteOrthogonalDecomposition<MatrixXd> cod;
    cod.setThreshold(1e-9);
    cod.compute(j);
    // The general solution J+ v + (1 - J+ J) w: the task sees no difference.
    const VectorXd expected = plain + wish - cod.solve(j * wish);
    EXPECT_LT((control.velocity() - expected).norm(), 1e-8 * (1.0 + expected.norm()));
    EXPECT_LT((plain - cod.solve(j * plain)).norm(), 1e-8 * (1.0 + plain.norm()));
  }
}

TEST(ResolvedRate, DampedInverseIsThatOfAppendixG4) {
  Random random(3);
  const Rig rig = test::shipped_rig("arm2");
  for (const double k0 : {1e-6, 1e-4, 1e-1}) {
    ResolvedRate control = make(rig, {.feedback = 0.0, .damping = k0});
    for (int trial = 0; trial < 20; ++trial) {
      const auto targets = random_targets(random, rig);
      const Vector3d v = targets[0].twist.velocity_at(targets[0].a_from_b.translation());
      Pose pose = test::allowed_pose(random, rig);
      control.step(targets, pose);
      const MatrixXd& j = control.jacobian();
      const Matrix3d inner = j * j.transpose() + k0 * Matrix3d::Identity();
      const VectorXd expected = j.transpose() * inner.inverse() * v;
      EXPECT_LT((control.velocity() - expected).norm(), 1e-9 * (1.0 + expected.norm()));
    }
  }
}

TEST(ResolvedRate, PlanarArmTurnsAsWorkedOutByHand) {
  // Section 3.2.2, two hinges about z: eq. 20's matrix written out for a = 0.3, b = 0.25.
  Rig rig;
  for (int i = 0; i < 2; ++i) {
    RigJoint joint;
    joint.name = std::to_string(i);
    joint.parent = i - 1;
    joint.type = JointType::hinge;
    joint.axes[0] = Vector3d::UnitZ();
    joint.offset = {0.3 * i, 0, 0};
    rig.joints.push_back(joint);
  }
  rig.effectors = {
      {.name = "hand", .joint = 1, .offset = {0.25, 0, 0}, .kind = EffectorKind::position}};
  ResolvedRate control = make(rig, {.feedback = 0.0});
  const double phi = 0.4, theta = 0.9;
  Pose pose(2);
  pose_from_coordinates(rig, std::vector<double>{phi, theta}, pose);
  const Vector3d v(0.2, -0.5, 0.0);
  control.step(std::vector<MovingTransform>{{DualQuaternion::identity(), {Vector3d::Zero(), v}}},
               pose);
  Eigen::Matrix2d j;
  j << -0.3 * std::sin(phi) - 0.25 * std::sin(phi + theta), -0.25 * std::sin(phi + theta),
      0.3 * std::cos(phi) + 0.25 * std::cos(phi + theta), 0.25 * std::cos(phi + theta);
  EXPECT_LT((control.velocity() - j.inverse() * v.head<2>()).norm(), 1e-13);
  // Euler's step of eq. 21.
  std::vector<double> q(2);
  coordinates_from_pose(rig, pose, q);
  EXPECT_NEAR(q[0], phi + 1e-3 * control.velocity()[0], 1e-14);
  EXPECT_NEAR(q[1], theta + 1e-3 * control.velocity()[1], 1e-14);
}

/// Three velocities per joint, as the paper has them: rows of a point and of a line through it.
struct PaperRows {
  MatrixXd point, line;  // [3 or 6, 3 joints]

  PaperRows(const Rig& rig, const Pose& pose) {
    const Pose world = test::world_of(rig, pose);
    const RigEffector& e = rig.effectors[0];
    const Vector3d p = world[e.joint].transform_point(e.offset);
    const Matrix3d n = cross_matrix(world[e.joint].transform_direction(e.axis));
    point.resize(3, 3 * rig.size());
    line.resize(6, 3 * rig.size());
    for (std::int32_t i = 0; i < rig.size(); ++i) {
      const Matrix3d arm = cross_matrix(p - world[i].translation());
      point.middleCols<3>(3 * i) = -arm;
      line.block<3, 3>(0, 3 * i) = -n;
      line.block<3, 3>(3, 3 * i) = n * arm - cross_matrix(p) * n;
    }
  }

  /// With the elbow's constraint axis x velocity = 0 below.
  static MatrixXd with_elbow(const MatrixXd& task, const Rig& rig, const Pose& pose) {
    MatrixXd all = MatrixXd::Zero(task.rows() + 3, task.cols());
    all.topRows(task.rows()) = task;
    const Vector3d axis = test::world_of(rig, pose)[1].transform_direction(rig.joints[1].axes[0]);
    all.block<3, 3>(task.rows(), 3) = cross_matrix(axis);
    return all;
  }
};

TEST(ResolvedRate, RanksAreThePapersTwoPerHingeApart) {
  Random random(4);
  const Rig arm2 = test::shipped_rig("arm2");
  const Rig line = test::tool_rig({EffectorKind::line}),
            point = test::tool_rig({EffectorKind::position});
  const Rig tool = test::tool_rig({EffectorKind::position, EffectorKind::line});
  for (int trial = 0; trial < 20; ++trial) {
    Pose two = test::allowed_pose(random, arm2, 0.8);
    const PaperRows paper2(arm2, two);
    EXPECT_EQ(rank_of(PaperRows::with_elbow(paper2.point, arm2, two)), 5);  // as printed
    EXPECT_EQ(make(arm2).step(random_targets(random, arm2), two).rank, 3);

    const Pose three = test::allowed_pose(random, line, 0.8);
    const PaperRows paper3(line, three);
    const MatrixXd nine = PaperRows::with_elbow(paper3.line, line, three);
    EXPECT_EQ(nine.rows(), 9);
    EXPECT_EQ(rank_of(nine), 6) << "printed as 8";
    const auto rank = [&](const Rig& rig) {
      Pose pose = three;
      return make(rig).step(random_targets(random, rig), pose).rank;
    };
    EXPECT_EQ(rank(line), 4);
    EXPECT_EQ(rank(point), 3);
    EXPECT_EQ(rank(tool), 5) << "the spin about the tool is open";
    Rig held = tool;  // a second point, off the line
    held.effectors.push_back(point.effectors[0]);
    held.effectors.back().name = "grip";
    held.effectors.back().offset += Vector3d(0.03, 0, 0);
    EXPECT_EQ(rank(held), 6);
  }
  Pose straight(2);  // aligned links: no velocity along them
  pose_from_coordinates(arm2, std::vector<double>(4, 0.0), straight);
  EXPECT_EQ(make(arm2).step(random_targets(random, arm2), straight).rank, 2);
}

TEST(ResolvedRate, HingeColumnsGiveThePapersConstrainedAnswer) {
  Random random(5);
  const Rig rig = test::shipped_rig("arm2");
  ResolvedRate control = make(rig, {.feedback = 0.0});
  for (int trial = 0; trial < 30; ++trial) {
    Pose pose = test::allowed_pose(random, rig, 0.8);
    const Pose world = test::world_of(rig, pose);
    const MatrixXd j = PaperRows::with_elbow(PaperRows(rig, pose).point, rig, pose);
    const auto targets = random_targets(random, rig);
    VectorXd v = VectorXd::Zero(6);
    v.head<3>() = targets[0].twist.velocity_at(targets[0].a_from_b.translation());
    Eigen::JacobiSVD<MatrixXd> svd(j, Eigen::ComputeThinU | Eigen::ComputeThinV);
    svd.setThreshold(1e-9);
    const VectorXd paper = svd.solve(v);  // world axes
    control.step(targets, pose);
    const VectorXd& x = control.velocity();
    const Vector3d shoulder = world[0].transform_direction(x.head<3>());
    const Vector3d elbow = x[3] * world[1].transform_direction(rig.joints[1].axes[0]);
    const double size = 1.0 + paper.norm();
    EXPECT_LT((shoulder - paper.head<3>()).norm() + (elbow - paper.tail<3>()).norm(), 1e-9 * size);
  }
}

/// The error's growth per step, from 1 mm off, target at rest.
double growth_per_step(const Rig& rig, double feedback, int steps) {
  const ArmReach reach;
  Pose pose = test::reach_start(rig, reach);
  MovingTransform target{reach.at(0).a_from_b, {}};
  target.a_from_b =
      DualQuaternion::from_translation(Vector3d(6, 4, -7).normalized() * 1e-3) * target.a_from_b;
  const std::vector<MovingTransform> targets{target};
  ResolvedRate control = make(rig, {.step_s = ArmReach::kStep, .feedback = feedback});
  const double first = control.step(targets, pose).point_error;
  for (int i = 1; i < steps; ++i) control.step(targets, pose);
  const Vector3d miss = target.a_from_b.translation() - test::effector_point(rig, pose);
  return std::pow(miss.norm() / first, 1.0 / steps);
}

TEST(ResolvedRate, ErrorsDieBelowTheFeedbackBoundAndGrowAboveIt) {
  const Rig rig = test::shipped_rig("arm2");
  const double bound = ResolvedRate::feedback_bound(ArmReach::kStep);
  EXPECT_DOUBLE_EQ(bound, 2000.0);
  for (const double part : {0.05, 0.3, 0.8, 0.95}) {  // |1 - k1 dt| = |1 - 2 part|
    const double growth = growth_per_step(rig, part * bound, 20);
    EXPECT_NEAR(growth, std::abs(1.0 - 2.0 * part), 0.01) << part;
  }
  EXPECT_LT(growth_per_step(rig, 0.5 * bound, 3), 1e-2) << "deadbeat";
  for (const double part : {1.05, 1.2}) {
    EXPECT_NEAR(growth_per_step(rig, part * bound, 8), 2.0 * part - 1.0, 0.02) << part;
  }
}

/// Follows a reach and gives the largest distance from it at the end of a step.
double follow(const Rig& rig, const ArmReach& reach, const ResolvedRateOptions& options,
              Pose* last = nullptr) {
  Pose pose = test::reach_start(rig, reach);
  ResolvedRate control = make(rig, options);
  double worst = 0.0;
  for (int i = 0; i < ArmReach::kSteps; ++i) {
    const std::vector<MovingTransform> targets(rig.effectors.size(), reach.at(i));
    control.step(targets, pose);
    const Vector3d goal = reach.at(i + 1).a_from_b.translation();
    worst = std::max(worst, (goal - test::effector_point(rig, pose)).norm());
  }
  if (last) *last = pose;
  return worst;
}

TEST(ArmReach, IsThePapersPath) {
  EXPECT_NEAR(ArmReach::distance(0.8), 0.25, 1e-3);  // "about 25 cm"
  EXPECT_DOUBLE_EQ(ArmReach::speed(0.4), 1.0);
  double simpson = 0.0;
  for (int i = 0; i < ArmReach::kSteps; ++i) {
    const double t = i * ArmReach::kStep, h = ArmReach::kStep;
    simpson += h / 6.0 *
               (ArmReach::speed(t) + 4.0 * ArmReach::speed(t + 0.5 * h) + ArmReach::speed(t + h));
    EXPECT_NEAR(ArmReach::distance(t + h), simpson, 1e-10);
  }
}

TEST(ArmReach, ThePapersControllerKeepsWithinItsFigure) {
  const Rig rig = test::shipped_rig("arm2");
  // Figure 4D: always below 0.02 cm, with k1 = 1000 as its text has it and k0 = 1 cm^2.
  EXPECT_LT(follow(rig, {}, {.feedback = 1000.0, .damping = 1e-4}), 2e-4);
  EXPECT_LT(follow(rig, {}, {.feedback = 1000.0}), 2e-4);
  // Without feedback the integration drifts.
  EXPECT_GT(follow(rig, {}, {.feedback = 0.0}), 2.0 * follow(rig, {}, {.feedback = 1000.0}));
  Random random(6);
  for (int i = 0; i < 20; ++i) {  // "several directions in space"
    const ArmReach any{.start = {0.1, -0.05, 0.3}, .direction = random.unit()};
    EXPECT_LT(follow(rig, any, {.feedback = 1000.0, .damping = 1e-4}), 2e-4) << i;
  }
}

TEST(ArmReach, LimbersSolverKeepsWithinAHundredthOfAMillimetre) {
  const Rig rig = test::shipped_rig("arm2");
  const ArmReach reach;
  for (const IkMethod method : {IkMethod::pgs, IkMethod::pgs_paper}) {
    auto solver = IkSolver::create(rig, {.method = method, .stop_position_m = 1e-6});
    ASSERT_TRUE(solver.ok());
    Pose pose = test::reach_start(rig, reach);
    for (int i = 1; i <= ArmReach::kSteps; ++i) {
      const std::vector<EffectorTarget> targets{{.pose = reach.at(i).a_from_b}};
      solver->solve(targets, pose);
      const Vector3d miss = targets[0].pose.translation() - test::effector_point(rig, pose);
      ASSERT_LE(miss.norm(), 1e-5) << "step " << i;
      ASSERT_LT(test::worst_excess(rig, pose), 1e-7);
    }
  }
}

TEST(ArmReach, ToolFollowsItsPointAndItsLine) {
  // The three-link arm: the tip runs the reach while the shaft turns.
  const Rig rig = test::tool_rig({EffectorKind::position, EffectorKind::line});
  const ArmReach reach = test::tool_reach(rig);
  for (const double damping : {0.0, 1e-6}) {
    Pose pose;
    EXPECT_LT(follow(rig, reach, {.damping = damping}, &pose), 2e-4);
    const Vector3d shaft = test::world_of(rig, pose)[2].transform_direction(Vector3d::UnitY());
    const Vector3d wanted =
        reach.at(ArmReach::kSteps).a_from_b.transform_direction(Vector3d::UnitY());
    EXPECT_LT((shaft - wanted).norm(), 1e-3);
    // The elbow is a hinge still.
    RigJoint elbow = rig.joints[1];
    elbow.limits = {};
    EXPECT_LT(test::excess(elbow, elbow.rest.conjugate() * pose[1].rotation()), 1e-12);
    EXPECT_LT((pose[1].translation() - elbow.offset).norm(), 1e-12);
  }
}

TEST(ArmReach, LimbersSolverTakesTheToolAlongToo) {
  const Rig rig = test::tool_rig({EffectorKind::position, EffectorKind::line});
  const ArmReach reach = test::tool_reach(rig);
  auto solver = IkSolver::create(rig, {.stop_position_m = 1e-6, .stop_orientation_rad = 1e-5});
  ASSERT_TRUE(solver.ok());
  Pose pose = test::reach_start(rig, reach);
  for (int i = 1; i <= ArmReach::kSteps; ++i) {
    const std::vector<EffectorTarget> targets(2, {.pose = reach.at(i).a_from_b});
    ASSERT_TRUE(solver->solve(targets, pose).reached) << i;
    const Vector3d miss = targets[0].pose.translation() - test::effector_point(rig, pose);
    ASSERT_LE(miss.norm(), 1e-5) << i;
  }
}

TEST(ResolvedRate, AllocatesNothingPerStep) {
  const Rig rig = test::tool_rig({EffectorKind::position, EffectorKind::line});
  ResolvedRate control = make(rig);
  Random random(7);
  Pose pose = test::allowed_pose(random, rig, 0.8);
  const auto targets = random_targets(random, rig);
  const std::vector<double> wish(dof_count(rig), 0.1);
  control.step(targets, pose, wish);
  const std::size_t before = test::allocation_count();
  for (int i = 0; i < 10; ++i) control.step(targets, pose, wish);
  EXPECT_EQ(test::allocation_count(), before);
}

TEST(ResolvedRate, RefusesWhatItCannotFollow) {
  const Rig rig = test::shipped_rig("arm2");
  const auto code = [](const Rig& r, const ResolvedRateOptions& options) {
    return ResolvedRate::create(r, options).error().code;
  };
  EXPECT_EQ(code(rig, {.step_s = 0.0}), "solver-options");
  EXPECT_EQ(code(rig, {.feedback = -1.0}), "solver-options");
  EXPECT_EQ(code(rig, {.damping = NAN}), "solver-options");
  EXPECT_EQ(code(test::shipped_rig("arm3"), {}), "solver-options");  // a pose
  EXPECT_EQ(code(Rig{}, {}), "rig-invalid");
}

}  // namespace
}  // namespace limber
