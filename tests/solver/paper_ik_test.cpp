// The paper's method: the fixed point it shares with the tree's elimination, its stopping rules,
// and those of its claims that a count can settle (figures: tests/bench/paper_claims_bench.cpp).
#include "solver/paper_ik.h"

#include <gtest/gtest.h>

#include "solver/tree_elimination.h"
#include "tests/solver/linearised.h"
#include "tests/solver/seeded_motion.h"

namespace limber {
namespace {

using Eigen::Vector3d;
using Eigen::VectorXd;
using test::make_solver;
using test::Random;

constexpr double kVisible[] = {5e-3, 2.0 * M_PI / 180.0};  // m, rad: acceptable to the eye

double apart(const Pose& a, const Pose& b) {
  double most = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    most = std::max(most, rotation_angle(a[i].rotation(), b[i].rotation()));
    most = std::max(most, (a[i].translation() - b[i].translation()).norm());
  }
  return most;
}

// ---- one fixed point

TEST(PaperIk, OneLinearProblemItsSweepsEndWhereTheEliminationEnds) {
  Random random(1);
  int active = 0;
  for (int trial = 0; trial < 60; ++trial) {
    const double damping = 0.05;  // so that plain sweeps arrive at all
    const Rig rig = test::random_rig(random, 10, 8);
    Pose pose = test::allowed_pose(random, rig);
    for (std::int32_t j = 0; j < rig.size(); ++j) {
      // A rotation without limits is added to here and multiplied there: the same only at rest.
      if (rig.joints[j].limited() || rig.joints[j].type == JointType::fixed) continue;
      if (rig.joints[j].type != JointType::ball && rig.joints[j].type != JointType::free) continue;
      pose[j] =
          DualQuaternion::from_rotation_translation(rig.joints[j].rest, pose[j].translation());
    }
    auto targets = test::targets_at(rig, test::allowed_pose(random, rig));
    for (EffectorTarget& target : targets) {
      if (random.integer(0, 2) == 0) target.pose = random.motion();
    }
    PaperIk paper(rig, {.damping = damping});
    paper.linearise(targets, pose);
    const LimitedProblem p = paper.problem();
    VectorXd sweeps = VectorXd::Zero(p.b.size());
    solve_pgs(p, sweeps, {.max_sweeps = 400000, .tolerance = 1e-15});
    EXPECT_LT(projected_residual(p.at + sweeps, p.a * sweeps - p.b, p.a.diagonal(), p.min, p.max,
                                 p.ellipses),
              1e-9);

    const test::Linearised here(rig, pose, targets);
    TreeElimination elimination(here.tree);
    elimination.reset(here.state.x);
    elimination.linearise(here.state.x, here.kinematics, here.load);
    VectorXd step = VectorXd::Zero(p.b.size());
    const VectorXd wish = step;
    // Swings end on the tangent: repeat from where the border was taken up until that is exact.
    for (int i = 0; i < 60; ++i) elimination.solve(here.state.x, damping, wish, step);
    VectorXd end = here.state.x + step;
    here.tree.project(end);
    ASSERT_EQ(end.size(), sweeps.size());
    EXPECT_LT((end - p.at - sweeps).cwiseAbs().maxCoeff(), 1e-8) << trial;
    for (Eigen::Index k = 0; k < end.size(); ++k)
      active += end[k] == p.min[k] || end[k] == p.max[k];
    for (const EllipseLimit& e : p.ellipses) {
      active += e.swing.level(end.segment<2>(e.coordinate)) > 1.0 - 1e-9;
    }
  }
  EXPECT_GT(active, 100);  // the limits had a say
}

int active_limits(const Rig& rig, const Pose& pose) {
  int active = 0;
  for (std::int32_t j = 0; j < rig.size(); ++j) {
    const RigJoint& joint = rig.joints[j];
    if (!joint.limited()) continue;
    double w[JointChart::kMost] = {};
    const JointChart chart(joint);
    chart.coordinates(pose[j], w);
    for (int k = 0; k < chart.size(); ++k) {
      active += std::abs(w[k] - chart.range(k).min) < 1e-7;
      active += std::abs(w[k] - chart.range(k).max) < 1e-7;
    }
    active += chart.has_ellipse() && chart.swing().level({w[0], w[1]}) > 1.0 - 1e-7;
  }
  return active;
}

Rig wider(Rig rig, double scale) {
  for (RigJoint& joint : rig.joints) {
    for (Range& range : joint.limits) range = {scale * range.min, scale * range.max};
  }
  return rig;
}

TEST(PaperIk, BothMethodsReachTheSameOptimumAtActiveLimits) {
  Random random(2);
  IkOptions to_the_end{.stop_at_tolerance = false,
                       .stop_step = 1e-13,
                       .stop_cost_decrease = 0.0,
                       .stop_cost = 0.0,
                       .max_relinearisations = 2000};
  IkOptions paper_to_the_end = to_the_end;
  paper_to_the_end.method = IkMethod::pgs_paper;
  paper_to_the_end.max_relinearisations = 20000;
  paper_to_the_end.sweeps = 200;
  int active = 0;
  for (const char* name : {"arm2", "arm3", "hand", "biped-foot-root", "biped-full"}) {
    const Rig rig = test::with_posture(test::shipped_rig(name));
    IkSolver pgs = make_solver(rig, to_the_end), paper = make_solver(rig, paper_to_the_end);
    for (int trial = 0; trial < 12; ++trial) {
      // Targets of a pose that wider limits would allow; a start that these do.
      const Pose beyond = test::allowed_pose(random, wider(rig, 1.1));
      Pose start = beyond;
      project_into_limits(rig, start);
      const auto targets = test::targets_at(rig, beyond);
      Pose a = start, b = start;
      pgs.solve(targets, a);
      paper.solve(targets, b);
      EXPECT_LT(apart(a, b), 1e-8) << name << " " << trial;
      EXPECT_LT(test::worst_excess(rig, b), 1e-10);
      active += active_limits(rig, b);
    }
  }
  EXPECT_GT(active, 60);
}

// ---- stopping rules (section VII.B)

Rig one_hinge() {
  Rig rig;
  RigJoint hinge;
  hinge.name = "hinge";
  hinge.type = JointType::hinge;
  hinge.axes[0] = Vector3d::UnitZ();
  rig.joints.push_back(hinge);
  rig.effectors.push_back(
      {.name = "tip", .joint = 0, .offset = Vector3d::UnitX(), .kind = EffectorKind::position});
  return rig;
}

std::vector<EffectorTarget> at_point(const Vector3d& point) {
  return {{.pose = DualQuaternion::from_translation(point)}};
}

Pose hinge_at(double angle) {
  return {DualQuaternion::from_rotation(test::about(Vector3d::UnitZ(), angle))};
}

double angle_of(const Pose& pose) {
  const Vector3d x = pose[0].rotation() * Vector3d::UnitX();
  return std::atan2(x.y(), x.x());
}

TEST(PaperIk, Rule1TheIterationsEnd) {
  Random random(3);
  const Rig rig = test::shipped_rig("hand");
  PaperIk ik(rig, {.max_relinearisations = 4, .sweeps = 2});
  Pose pose = test::allowed_pose(random, rig);
  const auto report = ik.solve(test::targets_at(rig, test::allowed_pose(random, rig)), pose);
  EXPECT_EQ(report.relinearisations, 4);
  EXPECT_EQ(report.sweeps, 8);
  EXPECT_FALSE(report.converged);
}

TEST(PaperIk, Rule2NothingIsSweptAtAnOptimumOutOfReach) {
  PaperIk ik(one_hinge(), {});
  const Pose best = hinge_at(0.3);
  Pose pose = best;
  const auto report = ik.solve(at_point(1.5 * Vector3d(std::cos(0.3), std::sin(0.3), 0.0)), pose);
  EXPECT_TRUE(report.converged);
  EXPECT_FALSE(report.reached);
  EXPECT_EQ(report.sweeps, 0);
  EXPECT_EQ(pose[0].real.coeffs(), best[0].real.coeffs());
}

TEST(PaperIk, Rule3ASmallStepEnds) {
  // Two hinges in a row, J = (1, 0.5) across, an error of 0.01: alone they would step by 0.01 and
  // 0.02. Swept in turn, the first takes all of it, and 0.01 is small here.
  Rig rig = one_hinge();
  rig.joints.push_back(rig.joints[0]);
  rig.joints[1].name = "second";
  rig.joints[1].parent = 0;
  rig.joints[1].offset = 0.5 * Vector3d::UnitX();
  rig.effectors[0].joint = 1;
  rig.effectors[0].offset = 0.5 * Vector3d::UnitX();
  PaperIk ik(rig, {.stop_position_m = 0.0, .stop_step = 0.015, .stop_cost = 0.0});
  Pose pose{DualQuaternion::identity(), DualQuaternion::from_translation(rig.joints[1].offset)};
  const auto report = ik.solve(at_point({1.0, 0.01, 0.0}), pose);
  EXPECT_TRUE(report.converged);
  EXPECT_EQ(report.relinearisations, 1);
  EXPECT_NEAR(angle_of(pose), 0.01, 1e-5);
}

TEST(PaperIk, Rule4AStepThatRepeatsEndsASwingToAndFro) {
  // One hinge, radius 1, a target at distance d straight ahead: x = -d sin(angle) / (1 + damping).
  // Beyond d = 2 (1 + damping) the middle repels and the hinge swings between +a and -a with
  // 2 a (1 + damping) = d sin(a). The step then repeats, and that is seen.
  PaperIk ik(one_hinge(), {.stop_at_tolerance = false, .max_relinearisations = 100000});
  Pose pose = hinge_at(0.4);
  const auto report = ik.solve(at_point({2.5, 0.0, 0.0}), pose);
  EXPECT_TRUE(report.converged);
  EXPECT_LT(report.relinearisations, 1000);
  EXPECT_LE(std::abs(angle_of(pose)), 0.4);  // the best pose met, the start included
}

// ---- exponential maps beyond pi

TEST(PaperIk, AJointWithoutLimitsTurnsOnAndOn) {
  Rig rig;
  RigJoint ball;
  ball.name = "ball";
  ball.type = JointType::ball;
  rig.joints.push_back(ball);
  rig.effectors.push_back({.name = "tip", .joint = 0, .offset = Vector3d(0.3, 0.1, 0.0)});
  PaperIk ik(rig, {});
  const Vector3d axis = Vector3d(1.0, 2.0, -0.5).normalized();
  Pose pose{DualQuaternion::identity()};
  for (int f = 1; f <= 400; ++f) {  // ten turns
    const Pose goal{DualQuaternion::from_rotation(test::about(axis, f * M_PI / 20.0))};
    const auto report = ik.solve(test::targets_at(rig, goal), pose);
    EXPECT_TRUE(report.reached) << f;
    EXPECT_LE(ik.coordinates().norm(), M_PI + 1e-12);
  }
}

// ---- claims (section IX)

/// Iterations per frame, each frame starting at the last one's solution.
std::vector<int> iterations_of(const Rig& rig, const std::vector<Pose>& motion, double* reached) {
  IkSolver solver = make_solver(rig, {.method = IkMethod::pgs_paper,
                                      .stop_position_m = kVisible[0],
                                      .stop_orientation_rad = kVisible[1]});
  std::vector<int> iterations;
  Pose pose = motion[0];
  int there = 0;
  for (const Pose& truth : motion) {
    const IkReport report = solver.solve(test::targets_at(rig, truth), pose);
    EXPECT_EQ(report.sweeps, report.relinearisations);
    iterations.push_back(report.relinearisations);
    there += report.reached;
  }
  *reached = static_cast<double>(there) / static_cast<double>(motion.size());
  std::sort(iterations.begin(), iterations.end());
  return iterations;
}

TEST(PaperIk, CoherentHandMotionTakesTwoOrThreeIterations) {
  const Rig rig = test::shipped_rig("hand");
  for (const unsigned seed : {1U, 2U, 3U}) {
    double reached = 0.0;
    const auto count = iterations_of(rig, test::seeded_motion(rig, seed, 600), &reached);
    EXPECT_LE(count[count.size() / 2], 3);
    EXPECT_GT(reached, 0.95);
  }
}

TEST(PaperIk, LittleMovementTakesOneOrTwo) {
  const test::MotionOptions slow{.slowest_hz = 0.02, .fastest_hz = 0.05};
  const Rig rig = test::shipped_rig("hand");
  double reached = 0.0;
  const auto count = iterations_of(rig, test::seeded_motion(rig, 4, 600, slow), &reached);
  EXPECT_LE(count[count.size() * 9 / 10], 2);
  EXPECT_GT(reached, 0.95);
}

TEST(PaperIk, BestReachIsStableUnderRepeatedSolves) {
  Random random(5);
  for (const auto& [name, beyond] : {std::pair{"hand", 0.1}, std::pair{"arm3", 0.6}}) {
    const Rig rig = test::shipped_rig(name);
    IkSolver solver = make_solver(
        rig, {.method = IkMethod::pgs_paper, .stop_step = 1e-9, .max_relinearisations = 20000});
    for (int trial = 0; trial < 12; ++trial) {
      auto targets = test::targets_at(rig, test::allowed_pose(random, rig, 0.8));
      for (EffectorTarget& target : targets) {
        const Vector3d far = beyond * target.pose.translation().normalized();
        target.pose = DualQuaternion::from_translation(far) * target.pose;
      }
      Pose pose = test::allowed_pose(random, rig, 0.5);
      EXPECT_FALSE(solver.solve(targets, pose).reached);
      const Pose first = pose;
      for (int again = 0; again < 20; ++again) solver.solve(targets, pose);
      EXPECT_LT(apart(first, pose), 1e-6) << name << " " << trial;
    }
  }
}

}  // namespace
}  // namespace limber
