// The gaze effector against the eye-head-shoulder transformation: what the solver aims an eye at
// is on its fovea, and its Jacobian is the slip of the image.
#include <gtest/gtest.h>

#include "assets/model/eye_head_shoulder.h"
#include "solver/jacobian.h"
#include "tests/solver/test_rigs.h"

namespace limber {
namespace {

using Eigen::Vector3d;
using test::Random;

constexpr std::int32_t kHead = 1, kEye = 2;

/// A head on shoulders and an eye in it that looks along +Z, well off both centres of rotation.
Rig looking_rig() {
  RigJoint shoulder, head, eye;
  shoulder.name = "shoulder";
  head.name = "head";
  head.parent = 0;
  head.type = JointType::ball;
  head.offset = {0.02, 0.25, 0.01};
  head.limits = {Range{-0.7, 0.7}, Range{-0.8, 0.8}, Range{-0.5, 0.5}};
  eye.name = "eye";
  eye.parent = kHead;
  eye.type = JointType::ball;
  eye.offset = {0.03, 0.08, 0.09};
  eye.limits = {Range{-0.5, 0.4}, Range{-0.6, 0.6}, Range{-0.1, 0.1}};
  Rig rig;
  rig.name = "looking";
  rig.joints = {shoulder, head, eye};
  rig.effectors = {
      {.name = "gaze", .joint = kEye, .kind = EffectorKind::gaze, .axis = Vector3d::UnitZ()}};
  return rig;
}

EyeHeadShoulder body_of(const Pose& pose) {
  return {.head_in_shoulder = pose[kHead].translation(),
          .eye_in_head = pose[kEye].translation(),
          .shoulder_from_head = pose[kHead].rotation(),
          .head_from_eye = pose[kEye].rotation()};
}

EffectorTarget looked_at(const Vector3d& point) {
  return {.pose = DualQuaternion::from_translation(point)};
}

TEST(Gaze, PutsTheTargetOnTheFovea) {
  const Rig rig = looking_rig();
  for (const IkMethod method : {IkMethod::pgs, IkMethod::pgs_paper}) {
    auto solver = IkSolver::create(rig, {.method = method, .stop_orientation_rad = 1e-6});
    ASSERT_TRUE(solver.ok());
    Random random(1);
    for (int trial = 0; trial < 50; ++trial) {
      // In reach of eye and head together, near enough that the eye's own travel counts.
      const Pose truth = test::allowed_pose(random, rig, 0.8);
      const Vector3d target =
          test::world_of(rig, truth)[kEye].transform_point({0.0, 0.0, random.uniform(0.2, 3.0)});
      const std::vector<EffectorTarget> targets{looked_at(target)};
      Pose pose = test::allowed_pose(random, rig, 0.8);
      EXPECT_TRUE(solver->solve(targets, pose).reached);
      const auto image = retinal_image(body_of(pose), {target, Vector3d::Zero()});
      ASSERT_TRUE(image.ok());
      EXPECT_LT((image->direction - Vector3d::UnitZ()).norm(), 1.1e-6);
      const Vector3d eye = test::world_of(rig, pose)[kEye].translation();
      EXPECT_NEAR(image->depth, (target - eye).norm(), 1e-12);
    }
  }
}

TEST(Gaze, JacobianIsTheSlipOfTheImage) {
  // Head and eye turn, the target stands still: the image slips as the error grows.
  const Rig rig = looking_rig();
  const IkTree tree(rig);
  Random random(2);
  for (int trial = 0; trial < 50; ++trial) {
    const Pose pose = test::allowed_pose(random, rig, 0.8);
    const Vector3d target =
        test::world_of(rig, pose)[kEye].transform_point({0.0, 0.0, random.uniform(0.1, 2.0)});
    IkState state = tree.make_state();
    IkKinematics kinematics = tree.make_kinematics();
    std::vector<IkGoal> goals(1);
    tree.resolve(std::vector<EffectorTarget>{looked_at(target)}, goals);
    tree.load(pose, state);
    tree.evaluate(state, goals, kinematics);
    tree.linearise(state, kinematics);
    Eigen::MatrixXd jacobian(6, tree.coordinate_count());
    effector_jacobian(tree, goals, kinematics, jacobian);
    const Eigen::VectorXd rate = Eigen::VectorXd::NullaryExpr(
        tree.coordinate_count(), [&] { return random.uniform(-2.0, 2.0); });
    EyeHeadShoulder body = body_of(pose);
    for (const IkNode& node : tree.nodes) {
      Vector3d turn = Vector3d::Zero();
      for (int i = 0; i < node.coordinates; ++i) {
        turn += rate[node.coordinate + i] * kinematics.axis[node.coordinate + i].head<3>();
      }
      (node.joint == kHead ? body.head_turn : body.eye_turn) +=
          node.joint == kHead ? turn : Vector3d(body.shoulder_from_head.conjugate() * turn);
    }
    const RetinalImage image = retinal_image(body, {target, Vector3d::Zero()}).value();
    const Vector3d growth = shoulder_from_eye(body).a_from_b.transform_direction(
        Vector3d::UnitZ().cross(image.velocity));
    EXPECT_LT((growth + (jacobian * rate).tail<3>()).norm(), 1e-12);
  }
}

TEST(Gaze, AtATargetInTheEyeStaysWhereItIs) {
  const Rig rig = looking_rig();
  Random random(3);
  for (const IkMethod method : {IkMethod::pgs, IkMethod::pgs_paper}) {
    auto solver = IkSolver::create(rig, {.method = method, .stop_at_tolerance = false});
    ASSERT_TRUE(solver.ok());
    for (const double off : {0.0, 1e-12, 0.5 * kNearestGaze}) {
      const Pose start = test::allowed_pose(random, rig, 0.8);
      const Vector3d eye = test::world_of(rig, start)[kEye].translation();
      const std::vector<EffectorTarget> targets{looked_at(eye + off * random.unit())};
      Pose pose = start;
      EXPECT_EQ(solver->solve(targets, pose).cost, 0.0);
      for (std::size_t i = 0; i < pose.size(); ++i) {
        EXPECT_LT((pose[i].matrix() - start[i].matrix()).norm(), 1e-12);
      }
    }
  }
}

TEST(Gaze, BesideOrBehindTheEyeEndsWithinLimits) {
  const Rig rig = looking_rig();
  auto solver = IkSolver::create(rig);
  ASSERT_TRUE(solver.ok());
  Random random(4);
  for (int trial = 0; trial < 100; ++trial) {
    const Pose start = test::allowed_pose(random, rig, 0.8);
    const DualQuaternion eye = test::world_of(rig, start)[kEye];
    const double distance = std::pow(10.0, random.uniform(-4.5, 6.0));
    const Vector3d place = trial % 5 == 0 ? Vector3d(0, 0, -distance)  // exactly behind
                                          : Vector3d(distance * random.unit());
    const std::vector<EffectorTarget> targets{looked_at(eye.transform_point(place))};
    Pose pose = start;
    const IkReport report = solver->solve(targets, pose);
    EXPECT_TRUE(std::isfinite(report.cost));
    EXPECT_LE(report.cost, effector_cost(rig, targets, start) + 1e-12);
    EXPECT_LT(test::worst_excess(rig, pose), 1e-7);
  }
}

/// The angle between where a gaze looks and where its target is.
double angle_off(const Rig& rig, const Pose& pose, std::size_t gaze, const Vector3d& target) {
  const RigEffector& effector = rig.effectors[gaze];
  const DualQuaternion eye = test::world_of(rig, pose)[effector.joint];
  const Vector3d axis = eye.rotation() * effector.axis;
  const Vector3d sight = target - eye.transform_point(effector.offset);
  return std::atan2(axis.cross(sight).norm(), axis.dot(sight));
}

/// biped-full with an eye in its head, the last effector.
Rig watching_rig() {
  Rig rig = test::shipped_rig("biped-full");
  RigEffector gaze{.name = "gaze",
                   .joint = rig.find_role("head"),
                   .offset = {0.0, 0.1, 0.08},
                   .kind = EffectorKind::gaze,
                   .axis = Vector3d::UnitZ()};
  std::erase_if(rig.effectors, [](const RigEffector& e) { return e.name == "head"; });
  rig.effectors.push_back(gaze);
  return rig;
}

TEST(Gaze, RelativeToAHandFollowsIt) {
  Random random(5);
  Rig rig = watching_rig();
  const std::size_t gaze = rig.effectors.size() - 1;
  rig.effectors[gaze].relative_to = rig.find_role("rightHand");
  IkSolver solver = test::make_solver(rig, {.stop_orientation_rad = 1e-5});
  int reached = 0;
  for (int trial = 0; trial < 20; ++trial) {
    const Pose truth = test::allowed_pose(random, rig, 0.5);
    auto targets = test::targets_at(rig, truth);
    const DualQuaternion hand = test::world_of(rig, truth)[rig.effectors[gaze].relative_to];
    targets[gaze].pose = hand.conjugate() * targets[gaze].pose;
    Pose pose = truth;
    for (DualQuaternion& q : pose) {
      q = DualQuaternion::from_rotation_translation(q.rotation() * random.small_rotation(0.05),
                                                    q.translation());
    }
    project_into_limits(rig, pose);
    if (!solver.solve(targets, pose).reached) continue;
    ++reached;
    const DualQuaternion held = test::world_of(rig, pose)[rig.effectors[gaze].relative_to];
    const Vector3d thing = held.transform_point(targets[gaze].pose.translation());
    EXPECT_LT(angle_off(rig, pose, gaze, thing), 1.1e-5) << trial;
    EXPECT_LT(test::worst_excess(rig, pose), 1e-7);
  }
  EXPECT_GE(reached, 19);
}

TEST(Gaze, RelativeToAFixedPropIsOneInTheWorld) {
  // Near, and against a hand that pulls elsewhere: the balance of both counts the eye's own travel.
  Random random(6);
  Rig rig = looking_rig();
  rig.effectors.push_back({.name = "brow",
                           .joint = kHead,
                           .offset = {0.0, 0.1, 0.1},
                           .kind = EffectorKind::position,
                           .weight_pos = 0.3});
  rig.joints[kHead].limits = {};
  rig.joints[kEye].type = JointType::fixed;  // the head alone looks
  RigJoint prop;
  prop.name = "prop";
  prop.offset = {0.2, 0.1, -0.3};
  prop.rest = random.rotation();
  rig.joints.push_back(prop);
  Rig relative = rig;
  relative.effectors[0].relative_to = rig.size() - 1;
  const DualQuaternion base = DualQuaternion::from_rotation_translation(prop.rest, prop.offset);
  const IkOptions to_the_end{
      .stop_at_tolerance = false, .stop_cost_decrease = 1e-13, .max_relinearisations = 300};
  IkSolver world_solver = test::make_solver(rig, to_the_end);
  IkSolver relative_solver = test::make_solver(relative, to_the_end);
  for (int trial = 0; trial < 20; ++trial) {
    const Pose truth = test::allowed_pose(random, rig, 0.2);
    auto targets = test::targets_at(rig, truth);
    const DualQuaternion eye = test::world_of(rig, truth)[kEye];
    targets[0] = looked_at(eye.transform_point({0.05, 0.0, random.uniform(0.05, 0.15)}));
    Pose a = truth, b = truth;
    world_solver.solve(targets, a);
    std::vector<EffectorTarget> seen_from_prop = targets;
    seen_from_prop[0].pose = base.conjugate() * targets[0].pose;
    relative_solver.solve(seen_from_prop, b);
    EXPECT_NEAR(angle_off(rig, a, 0, targets[0].pose.translation()),
                angle_off(rig, b, 0, targets[0].pose.translation()), 1e-5)
        << trial;
    EXPECT_NEAR(effector_cost(rig, targets, a), effector_cost(rig, targets, b), 1e-10) << trial;
  }
}

TEST(Gaze, OfHigherPriorityStaysWhileTheWeakerPull) {
  Random random(7);
  int missed = 0;
  for (int trial = 0; trial < 8; ++trial) {
    Rig rig = watching_rig();
    rig.joints[0].type = JointType::fixed;  // so it cannot turn round
    const std::size_t gaze = rig.effectors.size() - 1;
    for (std::size_t e = 0; e < gaze; ++e) rig.effectors[e].priority = 1;
    Rig alone = rig;
    alone.effectors = {rig.effectors[gaze]};
    const Pose truth = test::allowed_pose(random, rig, 0.5);
    auto targets = test::targets_at(rig, truth);
    // What is weaker pulls elsewhere; every other time what is looked at is behind.
    for (std::size_t e = 0; e < gaze; ++e) {
      targets[e].pose = DualQuaternion::from_translation(0.2 * random.unit()) * targets[e].pose;
    }
    const DualQuaternion eye = test::world_of(rig, truth)[rig.effectors[gaze].joint];
    const Vector3d ahead = eye.transform_point({0.3, 0.2, 0.5}),
                   behind = eye.transform_point({0.05, -0.1, -0.8});
    const Vector3d target = trial % 2 == 0 ? ahead : behind;
    targets[gaze] = looked_at(target);
    const IkOptions options{
        .stop_at_tolerance = false, .stop_cost_decrease = 1e-12, .max_relinearisations = 200};
    Pose by_itself = truth;
    test::make_solver(alone, options).solve(std::vector<EffectorTarget>{targets[gaze]}, by_itself);
    const double best = angle_off(rig, by_itself, gaze, target);
    missed += best > 0.01;
    Pose together = by_itself;
    test::make_solver(rig, options).solve(targets, together);
    EXPECT_LT(angle_off(rig, together, gaze, target), best + 1e-5) << trial;
    EXPECT_LT(test::worst_excess(rig, together), 1.8e-7);
    EXPECT_LT(effector_cost(rig, targets, together), effector_cost(rig, targets, by_itself))
        << trial;  // the weaker ones had what was left
  }
  EXPECT_GE(missed, 3);
  EXPECT_LE(missed, 5);
}

}  // namespace
}  // namespace limber
