// The linear problem of one relinearisation: plain projected Gauss-Seidel, the tree's elimination,
// and what both must agree on.
#include <gtest/gtest.h>

#include "solver/pgs.h"
#include "solver/tree_elimination.h"
#include "tests/solver/linearised.h"

namespace limber {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using test::Random;

MatrixXd random_spd(Random& random, int n, double floor) {
  MatrixXd m(n, n);
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) m(i, j) = random.normal();
  }
  return m * m.transpose() + floor * MatrixXd::Identity(n, n);
}

TEST(Pgs, WithoutLimitsItSolvesTheSystem) {
  Random random(1);
  const MatrixXd a = random_spd(random, 6, 1.0);
  const VectorXd b = VectorXd::Ones(6), at = VectorXd::Zero(6);
  const VectorXd low = VectorXd::Constant(6, -1e9), high = VectorXd::Constant(6, 1e9);
  VectorXd x = VectorXd::Zero(6);
  solve_pgs({a, b, at, low, high, {}}, x, {.max_sweeps = 20000, .tolerance = 1e-16});
  EXPECT_LT((x - a.ldlt().solve(b)).norm(), 1e-10);
}

TEST(Pgs, TwoCoordinatesInABoxByHand) {
  // min x^2 + y^2 + xy - 4x - y in [0, 1]^2: x at its bound 1; then 2y + 1 - 1 = 0, y = 0.
  MatrixXd a(2, 2);
  a << 2, 1, 1, 2;
  const VectorXd b = (VectorXd(2) << 4, 1).finished(), at = VectorXd::Zero(2);
  const VectorXd low = VectorXd::Zero(2), high = VectorXd::Ones(2);
  VectorXd x = VectorXd::Zero(2);
  solve_pgs({a, b, at, low, high, {}}, x, {.max_sweeps = 200});
  EXPECT_NEAR(x[0], 1.0, 1e-15);
  EXPECT_NEAR(x[1], 0.0, 1e-15);
}

struct Problem {
  MatrixXd a;
  VectorXd b, at, low, high;
  std::vector<EllipseLimit> ellipses;
  LimitedProblem view() const { return {a, b, at, low, high, ellipses}; }
  double value(const VectorXd& x) const { return 0.5 * x.dot(a * x) - b.dot(x); }
};

Problem random_problem(Random& random, int n) {
  Problem p;
  p.a = random_spd(random, n, 0.1);
  p.b = p.at = p.low = p.high = VectorXd::Zero(n);
  for (int i = 0; i < n; ++i) {
    p.b[i] = 3.0 * random.normal();
    p.low[i] = -random.uniform(0.05, 1.0);
    p.high[i] = random.uniform(0.05, 1.0);
    p.at[i] = random.uniform(p.low[i], p.high[i]);
  }
  for (int i = 0; i + 1 < n; i += 3) {
    p.ellipses.push_back({i, {p.low[i], p.high[i], p.low[i + 1], p.high[i + 1]}});
    p.low.segment<2>(i).setConstant(-1e300);
    p.high.segment<2>(i).setConstant(1e300);
    const Eigen::Vector2d inside = p.ellipses.back().swing.project({p.at[i], p.at[i + 1]});
    p.at.segment<2>(i) = inside;
  }
  return p;
}

TEST(Pgs, EverySweepLowersTheObjectiveAndEndsWithinLimits) {
  Random random(2);
  for (int trial = 0; trial < 50; ++trial) {
    const Problem p = random_problem(random, 8);
    VectorXd x = VectorXd::Zero(8);
    double value = p.value(x);
    for (int sweep = 0; sweep < 30; ++sweep) {
      solve_pgs(p.view(), x, {.max_sweeps = 1});
      EXPECT_LE(p.value(x), value + 1e-13);
      value = p.value(x);
      for (const EllipseLimit& e : p.ellipses) {
        const Eigen::Vector2d s = (p.at + x).segment<2>(e.coordinate);
        EXPECT_LE(e.swing.level(s), 1.0 + 1e-12);
      }
    }
  }
}

TEST(Pgs, ItsFixedPointBeatsEveryOtherAllowedPoint) {
  Random random(3);
  for (int trial = 0; trial < 20; ++trial) {
    const Problem p = random_problem(random, 5);
    VectorXd x = VectorXd::Zero(5);
    solve_pgs(p.view(), x, {.max_sweeps = 100000, .tolerance = 1e-15});
    const VectorXd gradient = p.a * x - p.b;
    const auto residual = [&](const VectorXd& step) {
      return projected_residual(p.at + step, p.a * step - p.b, p.a.diagonal(), p.low, p.high,
                                p.ellipses);
    };
    EXPECT_LT(residual(x), 1e-10);
    EXPECT_GT(residual(VectorXd::Zero(5)), 1e-3);
    for (int i = 0; i < 2000; ++i) {
      VectorXd other(5);
      for (int k = 0; k < 5; ++k) other[k] = random.uniform(-1.0, 1.0);
      other = other.cwiseMax(p.low).cwiseMin(p.high);
      for (const EllipseLimit& e : p.ellipses) {
        other.segment<2>(e.coordinate) =
            e.swing.project(Eigen::Vector2d(other.segment<2>(e.coordinate)));
      }
      EXPECT_GE(gradient.dot(other - p.at - x), -1e-8);  // the variational inequality
    }
  }
}

/// A relinearisation of a random rig, dense beside the tree's.
struct Linearised : test::Linearised {
  MatrixXd a;
  VectorXd b;
  std::vector<EllipseLimit> ellipses;

  Linearised(Rig source, Random& random, double damping, double fill)
      : test::Linearised(std::move(source), random, fill) {
    normal_equations(damping, a, b);
    for (const IkNode& node : tree.nodes) {
      if (node.ellipse) ellipses.push_back({node.coordinate, node.swing});
    }
  }
};

TEST(TreeElimination, WithoutLimitsItIsTheDenseSolution) {
  Random random(4);
  for (int trial = 0; trial < 40; ++trial) {
    Rig rig = test::random_rig(random, 12, 9);
    for (RigJoint& joint : rig.joints) joint.limits = {};
    const Linearised p(rig, random, 1e-2, 1.0);
    TreeElimination elimination(p.tree);
    elimination.reset(p.state.x);
    elimination.linearise(p.state.x, p.kinematics, p.load);
    VectorXd step(p.b.size());
    const EliminationStats stats =
        elimination.solve(p.state.x, 1e-2, VectorXd::Zero(p.b.size()), step);
    EXPECT_EQ(stats.passes, 1);
    const VectorXd dense = p.a.ldlt().solve(p.b);
    EXPECT_LT((step - dense).norm(), 1e-10 * (1.0 + dense.norm()));
    // The node twists are those of the step.
    for (std::size_t e = 0; e < p.goals.size(); ++e) {
      const std::int32_t node = p.tree.effectors[e].node;
      if (node < 0) continue;
      Vector6 twist = Vector6::Zero();
      for (std::int32_t n = node; n >= 0; n = p.tree.nodes[n].parent) {
        for (int i = 0; i < p.tree.nodes[n].coordinates; ++i) {
          const std::int32_t k = p.tree.nodes[n].coordinate + i;
          twist += step[k] * p.kinematics.axis[k];
        }
      }
      EXPECT_LT((elimination.node_twist()[node] - twist).norm(), 1e-9 * (1.0 + twist.norm()));
    }
  }
}

TEST(TreeElimination, AtLimitsItReachesTheFixedPointOfTheSweeps) {
  Random random(5);
  int active = 0;
  for (int trial = 0; trial < 60; ++trial) {
    const double damping = 0.05;  // so that the plain sweeps arrive at all
    const Linearised p(test::random_rig(random, 10, 8), random, damping, 1.0);
    TreeElimination elimination(p.tree);
    elimination.reset(p.state.x);
    elimination.linearise(p.state.x, p.kinematics, p.load);
    VectorXd step = VectorXd::Zero(p.b.size());
    // Swings end on the tangent: repeat from where the border was taken up until that is exact.
    const VectorXd wish = VectorXd::Constant(p.b.size(), 0.01);
    for (int i = 0; i < 60; ++i) elimination.solve(p.state.x, damping, wish, step);
    const VectorXd b = p.b + damping * p.tree.damping.cwiseProduct(wish);
    VectorXd end = p.state.x + step;
    p.tree.project(end);
    step = end - p.state.x;
    VectorXd sweeps = VectorXd::Zero(p.b.size());
    solve_pgs({p.a, b, p.state.x, p.tree.min, p.tree.max, p.ellipses}, sweeps,
              {.max_sweeps = 400000, .tolerance = 1e-15});
    EXPECT_LT(projected_residual(p.state.x + sweeps, p.a * sweeps - b, p.a.diagonal(), p.tree.min,
                                 p.tree.max, p.ellipses),
              1e-9);
    EXPECT_LT((step - sweeps).cwiseAbs().maxCoeff(), 1e-8) << trial;
    for (Eigen::Index k = 0; k < end.size(); ++k) {
      active += end[k] == p.tree.max[k] || end[k] == p.tree.min[k];
    }
    for (const EllipseLimit& e : p.ellipses) {
      active += e.swing.level(end.segment<2>(e.coordinate)) > 1.0 - 1e-9;
    }
  }
  EXPECT_GT(active, 100);  // the limits had a say
}

TEST(TreeElimination, CurvedProblemIsNewtonsOwn) {
  // With H the Hessian of half the cost: (H + damping) d = J'We. H d is measured by moving along d
  // and watching J'We. Hinges only: their coordinates are the angles themselves.
  Random random(6);
  int checked = 0;
  for (int trial = 0; trial < 40; ++trial) {
    Rig rig;
    for (int i = 0; i < 7; ++i) {
      const JointType type = i % 3 == 2 ? JointType::universal : JointType::hinge;
      RigJoint joint = test::random_joint(random, type, i == 0 ? -1 : random.integer(0, i - 1), i);
      joint.limits = {};
      rig.joints.push_back(joint);
    }
    for (int e = 0; e < 5; ++e) {
      const EffectorKind kinds[] = {EffectorKind::pose, EffectorKind::position,
                                    EffectorKind::orientation};
      rig.effectors.push_back({.name = std::to_string(e),
                               .joint = random.integer(0, 6),
                               .offset = random.vector(0.2),
                               .kind = kinds[e % 3]});
    }
    const double damping = 0.3;
    Linearised p(rig, random, damping, 1.0);
    EffectorLoad curved(p.tree.nodes.size());
    effector_load(p.tree, p.goals, p.kinematics, curved, true);
    TreeElimination elimination(p.tree);
    elimination.reset(p.state.x);
    elimination.linearise(p.state.x, p.kinematics, curved);
    const Eigen::Index n = p.b.size();
    VectorXd step(n);
    if (!elimination.solve(p.state.x, damping, VectorXd::Zero(n), step).definite) continue;
    ++checked;
    const auto pull_at = [&](double along) {
      IkState state = p.tree.make_state();
      IkKinematics kinematics = p.tree.make_kinematics();
      p.tree.move(p.state, along * step, state);
      p.tree.evaluate(state, p.goals, kinematics);
      p.tree.linearise(state, kinematics);
      EffectorLoad load(p.tree.nodes.size());
      effector_load(p.tree, p.goals, kinematics, load);
      compose_load(p.tree, load);
      MatrixXd a(n, n);
      VectorXd b(n);
      normal_equations(p.tree, kinematics, load, a, b);
      return b;
    };
    const double h = 1e-5;
    const VectorXd hessian_step = (pull_at(-h) - pull_at(h)) / (2.0 * h);
    EXPECT_LT((hessian_step + damping * step - p.b).norm(), 1e-7 * (1.0 + p.b.norm())) << trial;
  }
  EXPECT_GT(checked, 20);
}

}  // namespace
}  // namespace limber
