#include "solver/jacobian.h"

#include <gtest/gtest.h>

#include "tests/solver/test_rigs.h"

namespace limber {
namespace {

using test::Random;

/// A tree, a place inside its limits, and goals.
struct Place {
  Rig rig;
  IkTree tree;
  IkState state;
  IkKinematics kinematics;
  std::vector<IkGoal> goals;

  Place(Rig source, Random& random, bool at_goal, double fill = 0.9)
      : rig(std::move(source)),
        tree(rig),
        state(tree.make_state()),
        kinematics(tree.make_kinematics()),
        goals(rig.effectors.size()) {
    const Pose pose = test::allowed_pose(random, rig, fill);
    tree.load(pose, state);
    auto targets = test::targets_at(rig, at_goal ? pose : test::allowed_pose(random, rig, 0.9));
    for (EffectorTarget& target : targets) target.weight = random.uniform(0.5, 2.0);
    tree.resolve(targets, goals);
    tree.evaluate(state, goals, kinematics);
    tree.linearise(state, kinematics);
  }

  /// Kinematics after one coordinate moved by h.
  IkKinematics moved(Eigen::Index coordinate, double h) const {
    Eigen::VectorXd step = Eigen::VectorXd::Zero(state.x.size());
    step[coordinate] = h;
    IkState next = tree.make_state();
    IkKinematics out = tree.make_kinematics();
    tree.move(state, step, next);
    tree.evaluate(next, goals, out);
    return out;
  }
};

Rig rig_of(Random& random, JointType type, bool limited, EffectorKind kind) {
  Rig rig;
  for (int i = 0; i < 3; ++i) {
    RigJoint joint = test::random_joint(random, i == 1 ? JointType::fixed : type, i - 1, i);
    if (!limited) joint.limits = {};
    rig.joints.push_back(joint);
  }
  rig.effectors.push_back({.name = "effector",
                           .joint = 2,
                           .offset = random.vector(0.2),
                           .kind = kind,
                           .axis = random.unit(),
                           .weight_pos = 1.3,
                           .weight_rot = 0.7});
  return rig;
}

const JointType kTypes[] = {JointType::hinge, JointType::universal, JointType::ball,
                            JointType::free};
const EffectorKind kKinds[] = {EffectorKind::pose,        EffectorKind::position,
                               EffectorKind::orientation, EffectorKind::direction,
                               EffectorKind::line,        EffectorKind::gaze};

TEST(Jacobian, MeetsFiniteDifferencesForEveryJointAndEffector) {
  Random random(1);
  for (const JointType type : kTypes) {
    for (const EffectorKind kind : kKinds) {
      for (const bool limited : {true, false}) {
        for (int trial = 0; trial < 5; ++trial) {
          // On the goal the residual's derivative is minus the Jacobian, with no other term.
          const Place s(rig_of(random, type, limited, kind), random, true);
          Eigen::MatrixXd jacobian(6, s.state.x.size());
          effector_jacobian(s.tree, s.goals, s.kinematics, jacobian);
          for (Eigen::Index k = 0; k < s.state.x.size(); ++k) {
            const double h = 1e-6;
            const IkKinematics plus = s.moved(k, h), minus = s.moved(k, -h);
            Eigen::Matrix<double, 6, 1> slope;
            slope << (minus.error[0].position - plus.error[0].position) / (2 * h),
                (minus.error[0].rotation - plus.error[0].rotation) / (2 * h);
            EXPECT_LT((jacobian.col(k) - slope).cwiseAbs().maxCoeff(), 2e-9)
                << to_string(type) << " " << to_string(kind) << " " << limited;
          }
        }
      }
    }
  }
}

TEST(Jacobian, PullIsTheGradientOfTheCostAnywhere) {
  Random random(2);
  int checked = 0;
  for (int trial = 0; trial < 60; ++trial) {
    Place s(test::random_rig(random, 8, 7), random, false, 0.8);
    const Eigen::Index n = s.state.x.size();
    EffectorLoad load(s.tree.nodes.size());
    effector_load(s.tree, s.goals, s.kinematics, load);
    compose_load(s.tree, load);
    Eigen::MatrixXd a(n, n);
    Eigen::VectorXd b(n);
    normal_equations(s.tree, s.kinematics, load, a, b);
    for (Eigen::Index k = 0; k < n; ++k) {
      const double h = 1e-6;
      // Where a step would leave the limits, moving is not differentiable.
      const auto clamped = [&](double d) {
        Eigen::VectorXd x = s.state.x;
        x[k] += d;
        s.tree.project(x);
        return std::abs(x[k] - s.state.x[k] - d) > 1e-15;
      };
      if (clamped(h) || clamped(-h)) continue;
      ++checked;
      const double slope = (s.moved(k, h).cost - s.moved(k, -h).cost) / (2 * h);
      EXPECT_NEAR(-2.0 * b[k], slope, 1e-6 * (1.0 + std::abs(slope)));
    }
  }
  EXPECT_GT(checked, 500);
}

TEST(Jacobian, CompositeInertiasGiveTheNormalEquationsOfTheRows) {
  Random random(3);
  for (int trial = 0; trial < 30; ++trial) {
    Place s(test::random_rig(random, 10, 8), random, false);
    const Eigen::Index n = s.state.x.size();
    Eigen::MatrixXd j(6 * s.goals.size(), n);
    effector_jacobian(s.tree, s.goals, s.kinematics, j);
    Eigen::VectorXd w(j.rows()), e(j.rows());
    for (std::size_t i = 0; i < s.goals.size(); ++i) {
      w.segment<3>(6 * i).setConstant(s.goals[i].mass);
      w.segment<3>(6 * i + 3).setConstant(s.goals[i].inertia);
      e.segment<3>(6 * i) = s.kinematics.error[i].position;
      e.segment<3>(6 * i + 3) = s.kinematics.error[i].rotation;
    }
    EffectorLoad load(s.tree.nodes.size());
    effector_load(s.tree, s.goals, s.kinematics, load);
    compose_load(s.tree, load);
    Eigen::MatrixXd a(n, n);
    Eigen::VectorXd b(n);
    normal_equations(s.tree, s.kinematics, load, a, b);
    EXPECT_LT((a - j.transpose() * w.asDiagonal() * j).cwiseAbs().maxCoeff(), 1e-12);
    EXPECT_LT((b - j.transpose() * w.asDiagonal() * e).cwiseAbs().maxCoeff(), 1e-12);
  }
}

TEST(Kinematics, CostIsTheDefinedObjective) {
  Random random(4);
  for (int trial = 0; trial < 50; ++trial) {
    const Rig rig = test::random_rig(random, 9, 6);
    const Pose pose = test::allowed_pose(random, rig);
    auto targets = test::targets_at(rig, test::allowed_pose(random, rig));
    for (EffectorTarget& target : targets) target.weight = random.uniform(0.0, 2.0);
    const double expected = test::objective(rig, targets, pose);
    EXPECT_NEAR(effector_cost(rig, targets, pose), expected, 1e-9 * (1.0 + expected));
    const IkTree tree(rig);
    IkState state = tree.make_state();
    IkKinematics kinematics = tree.make_kinematics();
    std::vector<IkGoal> goals(rig.effectors.size());
    tree.resolve(targets, goals);
    tree.load(pose, state);
    tree.evaluate(state, goals, kinematics);
    EXPECT_NEAR(kinematics.cost, expected, 1e-9 * (1.0 + expected));
  }
}

TEST(Kinematics, StoreUndoesLoad) {
  Random random(5);
  for (int trial = 0; trial < 50; ++trial) {
    const Rig rig = test::random_rig(random, 9, 6);
    const IkTree tree(rig);
    const Pose pose = test::allowed_pose(random, rig);
    Pose back = pose;
    IkState state = tree.make_state();
    tree.load(pose, state);
    tree.store(state, back);
    for (std::size_t i = 0; i < pose.size(); ++i) {
      EXPECT_LT((back[i].matrix() - pose[i].matrix()).norm(), 1e-12);
    }
  }
}

}  // namespace
}  // namespace limber
