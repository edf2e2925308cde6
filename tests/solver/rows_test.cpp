// What rows make of a rig: hands together, fingers that move together, levels, speeds, capsules,
// points that stay apart.
#include "solver/rows.h"

#include <gtest/gtest.h>

#include "solver/swing_twist.h"
#include "tests/solver/allocation_count.h"
#include "tests/solver/test_rigs.h"

namespace limber {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;
using test::make_solver;
using test::Random;
using test::rest_pose;

TEST(Rows, NoneWhereTheRigAsksForNone) {
  const Rig rig = test::shipped_rig("biped-hands");
  const IkTree tree(rig);
  EXPECT_TRUE(IkRows(rig, tree, {}).none());
  EXPECT_TRUE(IkRows(rig, tree, {}).make_place().rows.empty());
}

/// Every row's J against what its value does when a coordinate moves. `met`: near the targets,
/// where rotation errors change by the turn itself.
void expect_rows_match_differences(Random& random, const Rig& rig, const IkOptions& options,
                                   int* checked, bool met = false,
                                   std::span<const Separation> apart = {}) {
  const IkTree tree(rig, options.collision || !apart.empty());
  IkRows rows(rig, tree, options);
  rows.keep_apart(apart);
  IkState state = tree.make_state(), moved = state;
  IkKinematics here = tree.make_kinematics(), there = here;
  std::vector<IkGoal> goals(rig.effectors.size());
  const Pose pose = test::allowed_pose(random, rig, 0.7);
  tree.load(pose, state);
  auto targets = test::targets_at(rig, met ? pose : test::allowed_pose(random, rig));
  const Pose world = test::world_of(rig, pose);
  for (std::size_t e = 0; e < targets.size() && met; ++e) {
    const std::int32_t base = rig.effectors[e].relative_to;
    if (base != kNoJoint) targets[e].pose = world[base].conjugate() * targets[e].pose;
  }
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
      // Of rotations, held rows are near zero.
      const bool turn = !row.torque.isZero();
      if (turn && !row.hard() && !met) continue;
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

TEST(Rows, JacobiansOfEveryKindMatchDifferencesWhereTheyAreMet) {
  Random random(9);
  const EffectorKind kinds[] = {EffectorKind::pose,      EffectorKind::position,
                                EffectorKind::gaze,      EffectorKind::orientation,
                                EffectorKind::direction, EffectorKind::line};
  int checked = 0;
  for (int trial = 0; trial < 20; ++trial) {
    Rig rig = test::random_rig(random, 9, 0);
    for (int e = 0; e < 12; ++e) {
      // Each kind relative, and each held; some are both.
      rig.effectors.push_back({.name = "e" + std::to_string(e),
                               .joint = 8 - e % 4,
                               .offset = random.vector(0.2),
                               .kind = kinds[e % 6],
                               .axis = random.unit(),
                               .relative_to = e < 6 ? random.integer(0, 4) : kNoJoint,
                               .priority = e >= 6 ? 0 : random.integer(0, 1)});
    }
    expect_rows_match_differences(random, rig, {}, &checked, true);
  }
  EXPECT_GT(checked, 1000);
}

TEST(Rows, AHeldGazeThatMissesMatchesDifferences) {
  Random random(10);
  int checked = 0;
  for (int trial = 0; trial < 20; ++trial) {
    Rig rig = test::random_rig(random, 9, 0);
    for (int e = 0; e < 4; ++e) {
      rig.effectors.push_back({.name = "e" + std::to_string(e),
                               .joint = 8 - e,
                               .offset = random.vector(0.2),
                               .kind = EffectorKind::gaze,
                               .axis = random.unit(),
                               .relative_to = e < 2 ? random.integer(0, 3) : kNoJoint,
                               .priority = 0});
    }
    rig.effectors.push_back({.name = "weak", .joint = 8, .priority = 1});
    expect_rows_match_differences(random, rig, {}, &checked);
  }
  EXPECT_GT(checked, 500);
}

/// What a target asks for, in world space.
DualQuaternion goal_of(const RigEffector& effector, const EffectorTarget& target,
                       const Pose& world) {
  return effector.relative_to == kNoJoint ? target.pose : world[effector.relative_to] * target.pose;
}

double miss_of(const RigEffector& effector, const EffectorTarget& target, const Pose& world) {
  return (world[effector.joint].transform_point(effector.offset) -
          goal_of(effector, target, world).translation())
      .norm();
}

/// The angle of a hinge, from the definition.
double hinge_angle(const Rig& rig, const Pose& pose, std::int32_t joint) {
  double q = 0.0;
  angles_from_rotation(rig.joints[joint],
                       rig.joints[joint].rest.conjugate() * pose[joint].rotation(), &q);
  return q;
}

std::size_t effector_named(const Rig& rig, const std::string& name) {
  for (std::size_t e = 0; e < rig.effectors.size(); ++e) {
    if (rig.effectors[e].name == name) return e;
  }
  throw std::runtime_error(name);
}

TEST(RelativeEffectors, HandsStayTogetherWhereverTheyGo) {
  Random random(2);
  Rig rig = test::shipped_rig("biped-full");
  const std::size_t right = effector_named(rig, "r_hand");
  rig.effectors[right].relative_to = rig.find_role("leftHand");
  IkSolver solver = make_solver(rig);
  int reached = 0;
  for (int trial = 0; trial < 20; ++trial) {
    const Pose truth = test::allowed_pose(random, rig, 0.6);
    auto targets = test::targets_at(rig, truth);
    const Pose at_truth = test::world_of(rig, truth);
    const DualQuaternion left = at_truth[rig.effectors[right].relative_to];
    targets[right].pose = left.conjugate() * targets[right].pose;
    Pose pose = truth;
    for (DualQuaternion& q : pose) {
      q = DualQuaternion::from_rotation_translation(q.rotation() * random.small_rotation(0.05),
                                                    q.translation());
    }
    project_into_limits(rig, pose);
    const IkReport report = solver.solve(targets, pose);
    const Pose world = test::world_of(rig, pose);
    EXPECT_LT(test::worst_excess(rig, pose), 1e-7);
    EXPECT_NEAR(report.cost, effector_cost(rig, targets, pose), 1e-12 + 1e-6 * report.cost);
    if (!report.reached) continue;
    ++reached;
    EXPECT_LT(miss_of(rig.effectors[right], targets[right], world), 1e-4);
    EXPECT_LT(rotation_angle(world[rig.effectors[right].joint].rotation(),
                             goal_of(rig.effectors[right], targets[right], world).rotation()),
              1e-3);
  }
  EXPECT_GE(reached, 19);
}

TEST(RelativeEffectors, OfAFixedPropTheyAreWorldEffectors) {
  // A joint that cannot move stands still: relative to it is the world, moved.
  Random random(3);
  Rig rig = test::shipped_rig("arm3");
  RigJoint prop;
  prop.name = "prop";
  prop.parent = -1;
  prop.offset = {0.2, 0.1, -0.3};
  prop.rest = random.rotation();
  rig.joints.push_back(prop);
  Rig relative = rig;
  relative.effectors[0].relative_to = rig.size() - 1;
  const DualQuaternion base = DualQuaternion::from_rotation_translation(prop.rest, prop.offset);
  IkSolver world_solver = make_solver(rig, {.stop_at_tolerance = false});
  IkSolver relative_solver = make_solver(relative, {.stop_at_tolerance = false});
  for (int trial = 0; trial < 10; ++trial) {
    const Pose truth = test::allowed_pose(random, rig, 0.7);
    auto targets = test::targets_at(rig, truth);
    Pose a = rest_pose(rig), b = a;
    world_solver.solve(targets, a);
    targets[0].pose = base.conjugate() * targets[0].pose;
    relative_solver.solve(targets, b);
    // The same objective: where both arrive, they arrive at the same cost.
    const double by_relative = effector_cost(relative, targets, b);
    targets[0].pose = base * targets[0].pose;
    EXPECT_NEAR(by_relative, effector_cost(rig, targets, b), 1e-12);
  }
}

Rig coupled_hand() {
  Rig rig = test::shipped_rig("hand");
  for (const std::string finger : {"Index", "Middle", "Ring", "Little"}) {
    rig.couplings.push_back({.from_joint = rig.find_role("right" + finger + "Intermediate"),
                             .to_joint = rig.find_role("right" + finger + "Distal"),
                             .ratio = 2.0 / 3.0});
  }
  return rig;
}

TEST(Couplings, HoldWithinATenthOfADegreeAlsoAtLimits) {
  Random random(4);
  Rig rig = coupled_hand();
  // The follower stops at 40 degrees; the leader could go to 105, and with the follower to 60 only.
  for (const Coupling& c : rig.couplings)
    rig.joints[c.to_joint].limits[0].max = 40.0 * M_PI / 180.0;
  IkSolver solver = make_solver(rig, {.stop_at_tolerance = false});
  int at_limit = 0;
  for (int trial = 0; trial < 40; ++trial) {
    const auto targets = test::targets_at(rig, test::allowed_pose(random, rig));
    Pose pose = rest_pose(rig);
    const IkReport report = solver.solve(targets, pose);
    EXPECT_LT(test::worst_excess(rig, pose), 1.8e-7);
    EXPECT_LT(report.row_violation, 1e-4);
    for (const Coupling& c : rig.couplings) {
      const double from = hinge_angle(rig, pose, c.from_joint);
      const double to = hinge_angle(rig, pose, c.to_joint);
      EXPECT_NEAR(to, c.ratio * from, 0.1 * M_PI / 180.0) << trial;
      at_limit += to > rig.joints[c.to_joint].limits[0].max - 1e-6;
    }
  }
  EXPECT_GT(at_limit, 5);
}

TEST(Weights, StiffJointsMoveLess) {
  // Two equal hinges in a row reach sideways; the first is made stiff.
  Rig rig;
  for (int i = 0; i < 3; ++i) {
    RigJoint joint;
    joint.name = std::to_string(i);
    joint.parent = i - 1;
    joint.type = JointType::hinge;
    joint.axes[0] = Vector3d::UnitZ();
    joint.offset = i == 0 ? Vector3d(Vector3d::Zero()) : Vector3d(Vector3d::UnitX());
    rig.joints.push_back(joint);
  }
  rig.effectors.resize(1);
  rig.effectors[0].joint = 2;
  rig.effectors[0].offset = Vector3d::UnitX();
  rig.effectors[0].kind = EffectorKind::position;
  const std::vector<EffectorTarget> targets{
      {.pose = DualQuaternion::from_translation({2.9, 0.5, 0.0})}};
  Pose even = rest_pose(rig), stiff = even;
  make_solver(rig, {.damping = 1.0}).solve(targets, even);
  rig.joints[0].weight = 100.0;
  make_solver(rig, {.damping = 1.0}).solve(targets, stiff);
  EXPECT_LT(std::abs(hinge_angle(rig, stiff, 0)), 0.5 * std::abs(hinge_angle(rig, even, 0)));
}

TEST(Priorities, TheStrongerIsAsGoodAsAlone) {
  Random random(5);
  for (int trial = 0; trial < 12; ++trial) {
    Rig rig = test::shipped_rig("biped-full");
    for (RigEffector& effector : rig.effectors) {
      effector.priority = effector.name == "r_hand" || effector.name == "pelvis" ? 0 : 1;
    }
    Rig alone = rig;
    std::erase_if(alone.effectors, [](const RigEffector& e) { return e.priority != 0; });
    // Contradicting: what is weaker pulls elsewhere, and far.
    auto targets = test::targets_at(rig, test::allowed_pose(random, rig, 0.8));
    for (std::size_t e = 0; e < targets.size(); ++e) {
      if (rig.effectors[e].priority == 0 && trial % 2 == 0) continue;
      targets[e].pose = DualQuaternion::from_translation(0.5 * random.unit()) * targets[e].pose;
    }
    std::vector<EffectorTarget> strong;
    for (std::size_t e = 0; e < targets.size(); ++e) {
      if (rig.effectors[e].priority == 0) strong.push_back(targets[e]);
    }
    const IkOptions options{
        .stop_at_tolerance = false, .stop_cost_decrease = 1e-12, .max_relinearisations = 200};
    // The strong alone, to the end; then all of them from there.
    Pose by_itself = rest_pose(rig);
    make_solver(alone, options).solve(strong, by_itself);
    Pose together = by_itself;
    make_solver(rig, options).solve(targets, together);
    EXPECT_LT(test::worst_excess(rig, together), 1.8e-7);
    const Pose a = test::world_of(rig, together), b = test::world_of(rig, by_itself);
    double weak = 0.0;
    for (std::size_t e = 0, s = 0; e < targets.size(); ++e) {
      const RigEffector& effector = rig.effectors[e];
      if (effector.priority != 0) {
        weak += miss_of(effector, targets[e], b) - miss_of(effector, targets[e], a);
        continue;
      }
      EXPECT_LT(miss_of(effector, targets[e], a), miss_of(effector, strong[s], b) + 1e-6) << trial;
      EXPECT_LT(rotation_angle(a[effector.joint].rotation(), targets[e].pose.rotation()),
                rotation_angle(b[effector.joint].rotation(), strong[s].pose.rotation()) + 1e-5);
      ++s;
    }
    EXPECT_GT(weak, 0.05) << trial;  // the weaker ones had what was left
  }
}

TEST(Speeds, NoCoordinateMovesFasterThanItMay) {
  Random random(6);
  for (int trial = 0; trial < 15; ++trial) {
    Rig rig = test::random_rig(random, 10, 6);
    const double dt = 1.0 / 30.0, speed = 1.5, reach = speed * dt;
    for (RigJoint& joint : rig.joints) joint.max_speed = speed;
    IkSolver solver = make_solver(rig, {.dt = dt});
    const Pose before = test::allowed_pose(random, rig);
    const auto targets = test::targets_at(rig, test::allowed_pose(random, rig));
    Pose pose = before;
    solver.solve(targets, pose, before);
    EXPECT_LT(test::worst_excess(rig, pose), 1e-7);
    const IkTree tree(rig);
    for (const IkNode& node : tree.nodes) {
      const DualQuaternion &a = before[node.joint], &b = pose[node.joint];
      // Per coordinate at most `reach`: two of them turn by no more than its root-two-fold, three
      // by its root-three-fold; a ball's twist and swing add up at most so.
      const double most = std::sqrt(3.0) * reach + 1e-5;
      EXPECT_LT(rotation_angle(a.rotation(), b.rotation()), 1.3 * most) << to_string(node.type);
      EXPECT_LT((a.translation() - b.translation()).norm(), most);
      if (node.type == JointType::hinge) {
        EXPECT_LT(rotation_angle(a.rotation(), b.rotation()), reach + 1e-6);
      }
    }
  }
}

/// Two hinged rods side by side, 5 cm apart, 3 cm thick.
Rig two_rods() {
  Rig rig;
  rig.joints.resize(3);
  rig.joints[0].name = "palm";
  rig.effectors.resize(2);
  for (int i = 0; i < 2; ++i) {
    RigJoint& joint = rig.joints[i + 1];
    joint.name = std::to_string(i);
    joint.parent = 0;
    joint.type = JointType::hinge;
    joint.axes[0] = Vector3d::UnitZ();
    joint.offset = {0.0, 0.05 * i, 0.0};
    joint.capsules = {{{0, 0, 0}, {0.3, 0, 0}, 0.015}};
    rig.effectors[i].name = "tip" + std::to_string(i);
    rig.effectors[i].joint = i + 1;
    rig.effectors[i].offset = {0.3, 0, 0};
    rig.effectors[i].kind = EffectorKind::position;
  }
  return rig;
}

/// Pulls both rods across each other.
std::vector<EffectorTarget> crossing_tips() {
  return {{.pose = DualQuaternion::from_translation({0.28, 0.125, 0})},
          {.pose = DualQuaternion::from_translation({0.28, -0.075, 0})}};
}

TEST(Capsules, FingersStopWhereTheyTouch) {
  const Rig rig = two_rods();
  const auto targets = crossing_tips();
  Pose pose = rest_pose(rig);
  const IkReport report =
      make_solver(rig, {.stop_at_tolerance = false, .collision = true}).solve(targets, pose);
  const Pose world = test::world_of(rig, pose);
  const Vector3d a = world[1].transform_point({0.3, 0, 0}),
                 b = world[2].transform_point({0.3, 0, 0});
  // By symmetry the tips meet in the middle, touching.
  EXPECT_NEAR((b - a).norm(), 0.03, 1e-4);
  EXPECT_NEAR(0.5 * (a.y() + b.y()), 0.025, 1e-4);
  EXPECT_GT(report.active_rows, 0);
  EXPECT_LT(report.row_violation, 1e-4);
}

/// Directions aslant to the way between the points too: what turns must not seem to move.
TEST(Separations, JacobiansMatchDifferences) {
  Random random(12);
  int checked = 0;
  for (int trial = 0; trial < 5; ++trial) {
    Rig rig = test::random_rig(random, 9, 3);
    for (RigJoint& joint : rig.joints) joint.capsules = {{{0, 0, 0}, {0.1, 0, 0}, 0.01}};
    std::vector<Separation> apart;
    for (int i = 0; i < 4; ++i) {
      apart.push_back({random.integer(5, 8), random.integer(1, 4), random.vector(0.3),
                       random.vector(0.3), random.vector(1.0).normalized(), 0.1});
    }
    expect_rows_match_differences(random, rig, {.separations = 4}, &checked, false, apart);
  }
  EXPECT_GT(checked, 100);
}

TEST(Separations, PointsStayApartAlongTheirDirection) {
  const Rig rig = two_rods();
  const auto targets = crossing_tips();
  const Vector3d tip(0.3, 0, 0);
  IkSolver solver = make_solver(rig, {.stop_at_tolerance = false, .separations = 2});
  const auto tips_apart = [&](double least) {
    const Separation apart{2, 1, tip, tip, Vector3d::UnitY(), least};
    solver.keep_apart({&apart, 1});
    solver.forget();
    Pose pose = rest_pose(rig);
    solver.solve(targets, pose);
    const Pose world = test::world_of(rig, pose);
    return std::pair(world[1].transform_point(tip), world[2].transform_point(tip));
  };
  // By symmetry about y = 2.5 cm each gives way by half; one that asks for less than there is,
  // none.
  for (const double least : {0.04, 0.0, -0.06}) {
    const auto [a, b] = tips_apart(least);
    EXPECT_NEAR(b.y() - a.y(), least, 2e-5);
    EXPECT_NEAR(0.5 * (a.y() + b.y()), 0.025, 1e-4);
  }
  const auto [a, b] = tips_apart(-1.0);
  EXPECT_LT(b.y() - a.y(), -0.1);
}

TEST(Rows, SolvingAllocatesNothing) {
  Random random(8);
  Rig rig = coupled_hand();
  rig.effectors[1].relative_to = rig.effectors[0].joint;
  rig.effectors[2].priority = 1;
  for (RigJoint& joint : rig.joints) joint.max_speed = 20.0;
  IkSolver solver = make_solver(rig, {.collision = true, .dt = 0.03});
  auto targets = test::targets_at(rig, test::allowed_pose(random, rig));
  Pose pose = rest_pose(rig);
  const std::size_t before = test::allocation_count();
  for (int i = 0; i < 5; ++i) solver.solve(targets, pose);
  EXPECT_EQ(test::allocation_count(), before);
}

TEST(Rows, PaperModeRefusesThem) {
  EXPECT_EQ(IkSolver::create(coupled_hand(), {.method = IkMethod::pgs_paper}).error().code,
            "solver-options");
}

}  // namespace
}  // namespace limber
