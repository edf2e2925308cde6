// Rows on top of the tree: its linear problem against a dense method that knows neither trees nor
// duals, and the half responses against dense inverses.
#include "solver/row_solver.h"

#include <gtest/gtest.h>

#include "solver/pgs.h"
#include "tests/solver/linearised.h"

namespace limber {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using test::Random;

/// A relinearisation of a random rig, dense beside the tree's, with a step that is allowed.
struct Linearised : test::Linearised {
  MatrixXd a;
  VectorXd b, allowed;
  std::vector<Row> rows;

  Linearised(Rig source, Random& random, double damping)
      : test::Linearised(std::move(source), random, 1.0) {
    normal_equations(damping, a, b);
    VectorXd wish(b.size());
    for (double& w : wish) w = random.uniform(-0.5, 0.5);
    allowed = state.x + wish;
    tree.project(allowed);
    allowed -= state.x;
  }

  /// J of a row from the definition: what the row's nodes do under a unit step of a coordinate.
  VectorXd jacobian(const Row& row) const {
    VectorXd j = VectorXd::Zero(b.size());
    const auto chain = [&](std::int32_t node, const Vector6& wrench, double sign) {
      for (; node >= 0; node = tree.nodes[node].parent) {
        for (int i = 0; i < tree.nodes[node].coordinates; ++i) {
          const std::int32_t k = tree.nodes[node].coordinate + i;
          j[k] += sign * wrench.dot(kinematics.axis[k]);
        }
      }
    };
    chain(row.node_a, row.wrench, 1.0);
    chain(row.node_b, row.counter, -1.0);
    for (const Row::Term& term : row.terms) {
      if (term.node >= 0) j[term.coordinate] += term.coefficient;
    }
    return j;
  }

  /// A row of any kind; hard ones hold at `allowed`, one-sided ones there or beyond.
  void add_row(Random& random) {
    Row row;
    row.id = static_cast<std::int64_t>(rows.size());
    const int last = static_cast<int>(tree.nodes.size()) - 1;
    const int kind = random.integer(0, 3);
    if (kind < 3) {
      row.node_a = random.integer(0, last);
      row.node_b = random.integer(-1, last);
      row.force = random.vector();
      row.torque = kind == 0 ? random.vector(0.3) : Eigen::Vector3d(Eigen::Vector3d::Zero());
      row.point = random.vector();
      row.anchor(kinematics.origin);
    } else {
      for (Row::Term& term : row.terms) {
        term.node = random.integer(0, last);
        const IkNode& node = tree.nodes[term.node];
        term = {term.node, node.coordinate + random.integer(0, node.coordinates - 1),
                random.uniform(-2.0, 2.0)};
      }
    }
    row.one_sided = random.integer(0, 1) == 0;
    const double there = jacobian(row).dot(allowed);
    row.value = -there + (row.one_sided ? random.uniform(0.0, 0.1) : 0.0);
    if (!row.one_sided && random.integer(0, 1) == 0) {
      row.compliance = random.uniform(0.3, 2.0);
      row.value = random.uniform(-0.5, 0.5);
    }
    rows.push_back(row);
  }
};

/// The alternating direction method of multipliers on the dense problem: the step is split into
/// copies within the limits and on the rows, which are projected one by one.
VectorXd dense_answer(const Linearised& p) {
  const Eigen::Index n = p.b.size(), m = static_cast<Eigen::Index>(p.rows.size());
  MatrixXd a = p.a, j(m, n);
  VectorXd b = p.b;
  const double rho = 0.3;
  MatrixXd system = a;
  for (Eigen::Index i = 0; i < m; ++i) {
    const Row& row = p.rows[i];
    j.row(i) = p.jacobian(row);
    if (row.hard()) {
      system += rho * j.row(i).transpose() * j.row(i);
    } else {
      system += j.row(i).transpose() * j.row(i) / row.compliance;
      b -= j.row(i).transpose() * row.value / row.compliance;
    }
  }
  system.diagonal().array() += rho;
  const Eigen::LDLT<MatrixXd> factor(system);
  VectorXd d = VectorXd::Zero(n), z = d, u = d, w = VectorXd::Zero(m), v = w;
  for (int i = 0; i < 200000; ++i) {
    VectorXd right = b + rho * (z - u);
    for (Eigen::Index r = 0; r < m; ++r) {
      if (p.rows[r].hard()) right += rho * j.row(r).transpose() * (w[r] - p.rows[r].value - v[r]);
    }
    const VectorXd next = factor.solve(right);
    VectorXd end = p.state.x + next + u;
    p.tree.project(end);
    const double change = (next - d).norm() + (end - p.state.x - next).norm();
    d = next;
    z = end - p.state.x;
    u += d - z;
    for (Eigen::Index r = 0; r < m; ++r) {
      const double reach = j.row(r).dot(d) + p.rows[r].value;
      w[r] = p.rows[r].one_sided ? std::max(0.0, reach + v[r]) : 0.0;
      v[r] += reach - w[r];
    }
    if (change < 1e-13) break;
  }
  return d;
}

struct Solved {
  VectorXd step;
  RowStats stats;
};

Solved solve(Linearised& p, double damping) {
  TreeElimination elimination(p.tree);
  elimination.reset(p.state.x);
  elimination.linearise(p.state.x, p.kinematics, p.load);
  RowSolver solver(p.tree, p.rows.size());
  Solved out{VectorXd::Zero(p.b.size()), {}};
  const VectorXd wish = out.step;
  out.stats = solver.solve(elimination, p.state.x, damping, wish, p.rows, 1e6, out.step);
  return out;
}

/// Without ellipses: balls with limits twist, and swing not at all.
Rig boxed_rig(Random& random, int joints, int effectors) {
  Rig rig = test::random_rig(random, joints, effectors);
  for (RigJoint& joint : rig.joints) {
    if (joint.type == JointType::ball && joint.limited()) joint.limits[0] = {0.0, 0.0};
  }
  return rig;
}

TEST(RowSolver, LimitsAndRowsTogetherReachTheDenseAnswer) {
  Random random(1);
  int pressing = 0, at_limits = 0;
  for (int trial = 0; trial < 60; ++trial) {
    const double damping = 0.05;
    Linearised p(boxed_rig(random, 10, 8), random, damping);
    for (int i = random.integer(1, 8); i > 0; --i) p.add_row(random);
    const Solved solved = solve(p, damping);
    const VectorXd dense = dense_answer(p);
    VectorXd end = p.state.x + solved.step;
    p.tree.project(end);
    EXPECT_LT((end - p.state.x - solved.step).norm(), 2e-8) << trial;
    EXPECT_LT((solved.step - dense).cwiseAbs().maxCoeff(), 1e-8) << trial;
    pressing += solved.stats.active;
    for (Eigen::Index k = 0; k < end.size(); ++k) {
      at_limits += end[k] == p.tree.max[k] || end[k] == p.tree.min[k];
    }
  }
  EXPECT_GT(pressing, 30);  // rows and limits both had a say
  EXPECT_GT(at_limits, 60);
}

TEST(RowSolver, SwingsEndOnTheirBorderWhereTheDenseAnswerDoes) {
  // Tangents close in on the border: its depth is known to 1e-6 rad, the place along it to about
  // the root of that, and the objective to first order in the depth.
  Random random(7);
  int on_border = 0;
  for (int trial = 0; trial < 40; ++trial) {
    const double damping = 0.05;
    Linearised p(test::random_rig(random, 10, 8), random, damping);
    for (int i = random.integer(1, 4); i > 0; --i) p.add_row(random);
    const Solved solved = solve(p, damping);
    const VectorXd dense = dense_answer(p);
    const auto objective = [&](const VectorXd& d) {
      double sum = 0.5 * d.dot(p.a * d) - p.b.dot(d);
      for (const Row& row : p.rows) {
        const double value = p.jacobian(row).dot(d) + row.value;
        if (!row.hard()) sum += 0.5 * value * value / row.compliance;
      }
      return sum;
    };
    EXPECT_NEAR(objective(solved.step), objective(dense), 1e-4 * (1.0 + std::abs(objective(dense))))
        << trial;
    EXPECT_LT((solved.step - dense).cwiseAbs().maxCoeff(), 1e-2) << trial;
    const VectorXd end = p.state.x + solved.step;
    for (const IkNode& node : p.tree.nodes) {
      if (!node.ellipse) continue;
      const Eigen::Vector2d swing = end.segment<2>(node.coordinate);
      EXPECT_LT((swing - node.swing.project(swing)).norm(), 1.1e-6);
      on_border += node.swing.level(swing) > 1.0 - 1e-6;
    }
  }
  EXPECT_GT(on_border, 20);
}

TEST(RowSolver, MultipliersAreThoseOfTheOptimum) {
  // Stationarity with limits, signs and complementarity: what makes the step the one minimum.
  Random random(2);
  for (int trial = 0; trial < 60; ++trial) {
    const double damping = 1e-3;
    Linearised p(boxed_rig(random, 12, 10), random, damping);
    for (int i = 0; i < 10; ++i) p.add_row(random);
    const Solved solved = solve(p, damping);
    VectorXd gradient = p.a * solved.step - p.b;
    for (const Row& row : p.rows) {
      const VectorXd j = p.jacobian(row);
      gradient -= row.lambda * j;
      const double slack = j.dot(solved.step) + row.value + row.compliance * row.lambda;
      if (row.one_sided) {
        EXPECT_GE(row.lambda, 0.0);
        EXPECT_GT(slack, -1e-9);
        EXPECT_LT(std::min(row.lambda, slack), 1e-9);
      } else {
        EXPECT_LT(std::abs(slack), 1e-9);
      }
    }
    std::vector<EllipseLimit> ellipses;
    for (const IkNode& node : p.tree.nodes) {
      if (node.ellipse) ellipses.push_back({node.coordinate, node.swing});
    }
    VectorXd end = p.state.x + solved.step;
    p.tree.project(end);
    EXPECT_LT(projected_residual(end, gradient, p.a.diagonal(), p.tree.min, p.tree.max, ellipses),
              1e-8)
        << trial;
  }
}

TEST(RowSolver, HalfResponsesAreTheInverse) {
  Random random(3);
  for (int trial = 0; trial < 20; ++trial) {
    Rig rig = test::random_rig(random, 12, 9);
    for (RigJoint& joint : rig.joints) joint.limits = {};
    Linearised p(std::move(rig), random, 1e-2);
    for (int i = 0; i < 6; ++i) p.add_row(random);
    TreeElimination elimination(p.tree);
    elimination.reset(p.state.x);
    elimination.linearise(p.state.x, p.kinematics, p.load);
    VectorXd step(p.b.size());
    elimination.solve(p.state.x, 1e-2, VectorXd::Zero(p.b.size()), step);
    MatrixXd half(p.b.size(), 6), j(6, p.b.size());
    for (int i = 0; i < 6; ++i) {
      elimination.respond(p.rows[i], half.col(i));
      j.row(i) = p.jacobian(p.rows[i]);
    }
    const MatrixXd dense = j * p.a.ldlt().solve(j.transpose());
    EXPECT_LT((half.transpose() * half - dense).norm(), 1e-10 * (1.0 + dense.norm()));
  }
}

TEST(RowSolver, TwoRowsByHand) {
  // A hinge about z at the origin, damping 1: min 1/2 d^2 - 0 with d >= 0.3 and 2 d >= 0.4.
  Rig rig;
  rig.joints.resize(1);
  rig.joints[0].name = "hinge";
  rig.joints[0].type = JointType::hinge;
  rig.joints[0].axes[0] = Eigen::Vector3d::UnitZ();
  rig.effectors.push_back({.name = "tip", .weight_pos = 0.0, .weight_rot = 0.0});
  Random random(4);
  Linearised p(rig, random, 1.0);
  for (const auto& [coefficient, value] : {std::pair{1.0, -0.3}, std::pair{2.0, -0.4}}) {
    Row row;
    row.terms[0] = {0, 0, coefficient};
    row.value = value;
    row.one_sided = true;
    p.rows.push_back(row);
  }
  const Solved solved = solve(p, 1.0);
  EXPECT_NEAR(solved.step[0], 0.3, 1e-9);
  EXPECT_NEAR(p.rows[0].lambda, 0.3, 1e-9);
  EXPECT_EQ(p.rows[1].lambda, 0.0);
  EXPECT_EQ(solved.stats.active, 1);
}

TEST(RowSolver, RowsThatContradictEachOtherStayBounded) {
  Random random(5);
  for (int trial = 0; trial < 30; ++trial) {
    Linearised p(test::random_rig(random, 10, 8), random, 1e-2);
    for (int i = 0; i < 4; ++i) p.add_row(random);
    for (int i = 0; i < 4; ++i) {
      Row twin = p.rows[i];
      twin.id += 100;
      twin.value += 0.05;
      if (!twin.one_sided) twin.compliance = 0.0;
      p.rows.push_back(twin);
    }
    TreeElimination elimination(p.tree);
    elimination.reset(p.state.x);
    elimination.linearise(p.state.x, p.kinematics, p.load);
    RowSolver solver(p.tree, p.rows.size());
    VectorXd step = VectorXd::Zero(p.b.size());
    solver.solve(elimination, p.state.x, 1e-2, VectorXd::Zero(p.b.size()), p.rows, 100.0, step);
    EXPECT_TRUE(step.allFinite());
    for (const Row& row : p.rows) EXPECT_LE(std::abs(row.lambda), 100.0 * (1.0 + 1e-12));
  }
}

TEST(DualPgs, MeetsPlainSweeps) {
  Random random(6);
  for (int trial = 0; trial < 50; ++trial) {
    const int n = random.integer(1, 12);
    MatrixXd m(n, n);
    for (double& v : m.reshaped()) v = random.normal();
    const MatrixXd g = m * m.transpose() + 0.1 * MatrixXd::Identity(n, n);
    VectorXd r(n), low(n), high(n);
    for (int i = 0; i < n; ++i) {
      r[i] = 2.0 * random.normal();
      low[i] = -random.uniform(0.0, 1.0);
      high[i] = random.uniform(0.0, 1.0);
    }
    VectorXd l = VectorXd::Zero(n), plain = l;
    DualPgs pgs(12);
    pgs.solve(g, r, low, high, l);
    const VectorXd b = -r, at = VectorXd::Zero(n);
    solve_pgs({g, b, at, low, high, {}}, plain, {.max_sweeps = 200000, .tolerance = 1e-16});
    EXPECT_LT((l - plain).cwiseAbs().maxCoeff(), 1e-9) << trial;
  }
}

}  // namespace
}  // namespace limber
