// What rows make of a rig: hands together, fingers that move together, levels, speeds, capsules.
#include "solver/rows.h"

#include <gtest/gtest.h>

#include "tests/solver/test_rigs.h"

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;
using test::Random;

TEST(Rows, NoneWhereTheRigAsksForNone) {
  const Rig rig = test::shipped_rig("biped-hands");
  const IkTree tree(rig);
  EXPECT_TRUE(IkRows(rig, tree, {}).none());
  EXPECT_TRUE(IkRows(rig, tree, {}).make_place().rows.empty());
}

/// Every row's J against what its value does when a coordinate moves.
void expect_rows_match_differences(Random& random, const Rig& rig, const IkOptions& options,
                                   int* checked) {
  const IkTree tree(rig, options.collision);
  IkRows rows(rig, tree, options);
  IkState state = tree.make_state(), moved = state;
  IkKinematics here = tree.make_kinematics(), there = here;
  std::vector<IkGoal> goals(rig.effectors.size());
  tree.load(test::allowed_pose(random, rig, 0.7), state);
  auto targets = test::targets_at(rig, test::allowed_pose(random, rig));
  rows.set_previous(state);
  tree.evaluate(state, goals, here);
  rows.aim(targets, 1, here, goals);
  // Speeds have a way to tell once the place differs from the frame before.
  tree.move(state, Eigen::VectorXd::Constant(tree.coordinate_count(), 1e-4), moved);
  std::swap(state, moved);
  tree.evaluate(state, goals, here);
  tree.linearise(state, here);
  RowPlace place = rows.make_place(), ahead = place, behind = place;
  rows.build(state, here, place);
  rows.anchor(here, place);
  const double h = 1e-6;
  std::vector<Vector6> twist(tree.nodes.size());
  for (std::int32_t k = 0; k < tree.coordinate_count(); ++k) {
    if (state.x[k] - tree.min[k] < 1e-3 || tree.max[k] - state.x[k] < 1e-3) continue;
    Eigen::VectorXd step = Eigen::VectorXd::Zero(tree.coordinate_count());
    step[k] = 1.0;
    for (std::size_t n = 0; n < tree.nodes.size(); ++n) {
      const IkNode& node = tree.nodes[n];
      twist[n] = node.parent < 0 ? Vector6(Vector6::Zero()) : twist[node.parent];
      if (k >= node.coordinate && k < node.coordinate + node.coordinates) twist[n] += here.axis[k];
    }
    const auto at = [&](double size, RowPlace& out) {
      tree.move(state, size * step, moved);
      tree.evaluate(moved, goals, there);
      rows.build(moved, there, out);
    };
    at(h, ahead);
    at(-h, behind);
    for (const Row& row : place.rows) {
      const auto same = [&](const Row& other) { return other.id == row.id; };
      const auto a = std::find_if(ahead.rows.begin(), ahead.rows.end(), same);
      const auto b = std::find_if(behind.rows.begin(), behind.rows.end(), same);
      if (a == ahead.rows.end() || b == behind.rows.end()) continue;  // out of sight, another end
      const double difference = (a->value - b->value) / (2.0 * h);
      // A rotation error changes by the turn itself near zero only, where held rows are.
      const bool turn = !row.torque.isZero();
      if (turn && !row.hard()) continue;
      const bool near = turn || row.terms[0].node >= 0;
      EXPECT_NEAR(row.rate(twist, step), difference, near ? 1e-3 : 2e-5) << row.id << " " << k;
      ++*checked;
    }
  }
}

TEST(Rows, JacobiansMatchDifferences) {
  Random random(1);
  int checked = 0;
  for (int trial = 0; trial < 10; ++trial) {
    Rig rig = test::random_rig(random, 9, 0);
    const EffectorKind kinds[] = {EffectorKind::pose, EffectorKind::position};
    for (int e = 0; e < 4; ++e) {
      rig.effectors.push_back({.name = "e" + std::to_string(e),
                               .joint = 8 - e,
                               .offset = random.vector(0.2),
                               .kind = kinds[e % 2],
                               .relative_to = e < 2 ? random.integer(0, 3) : kNoJoint,
                               .priority = e % 3 == 2 ? 0 : 1});
    }
    for (RigJoint& joint : rig.joints) {
      joint.max_speed = 1.0;
      joint.capsules = {{random.vector(0.1), random.vector(0.1), 0.1}};
    }
    expect_rows_match_differences(random, rig, {.collision = true, .dt = 0.1}, &checked);
  }
  EXPECT_GT(checked, 1000);
}

}  // namespace
}  // namespace limber
