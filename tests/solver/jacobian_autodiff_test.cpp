// Both analytic Jacobians, the tree's and the paper's (its figure 8), against automatic
// differentiation of dual quaternion kinematics written here: every joint, every effector, on
// limits and near a half turn.
#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "solver/jacobian.h"
#include "solver/paper_ik.h"
#include "tests/solver/test_rigs.h"

namespace limber {
namespace {

using test::Random;

constexpr double kRelative = 1e-9;
constexpr int kMostCoordinates = 12;
using Jet = ceres::Jet<double, kMostCoordinates>;
using Vector3J = Eigen::Matrix<Jet, 3, 1>;
using QuaternionJ = Eigen::Quaternion<Jet>;
using Columns = Eigen::Matrix<double, 3, kMostCoordinates>;

/// How a rotation without limits takes a step: the paper adds to the rotation vector, the tree
/// multiplies from the left.
enum class Step { add, multiply };

QuaternionJ exp_of(const Vector3J& v) {
  return DualQuaternionT<Jet>::exp({v, Vector3J::Zero()}).real;
}

Vector3J along(const Eigen::Vector3d& axis, const Jet& x) { return axis.cast<Jet>() * x; }

QuaternionJ free_rotation(const double* w, const Jet* x, Step step) {
  const Vector3J here(x[0], x[1], x[2]);
  if (step == Step::add) return exp_of(here);
  const Eigen::Vector3d at(w[0], w[1], w[2]);
  return exp_of(here - at.cast<Jet>()) * rotation_exp(at).cast<Jet>();
}

/// The joint's local transform from its definition (assets/model/rig.h).
DualQuaternionT<Jet> local_transform(const RigJoint& joint, const double* w, const Jet* x,
                                     Step step) {
  QuaternionJ r(Jet(1), Jet(0), Jet(0), Jet(0));
  Vector3J offset = joint.offset.cast<Jet>();
  if (joint.type == JointType::hinge) {
    r = exp_of(along(joint.axes[0], x[0]));
  } else if (joint.type == JointType::universal) {
    r = exp_of(along(joint.axes[0], x[0])) * exp_of(along(joint.axes[1], x[1]));
  } else if (joint.type == JointType::ball && joint.limited()) {
    const Vector3J swing = along(joint.axes[0], x[0]) + along(joint.axes[1], x[1]);
    r = exp_of(swing) * exp_of(along(joint.axes[2], x[2]));
  } else if (joint.type == JointType::ball) {
    r = free_rotation(w, x, step);
  } else if (joint.type == JointType::free) {
    offset += Vector3J(x[0], x[1], x[2]);
    r = free_rotation(w + 3, x + 3, step);
  }
  const QuaternionJ turned = joint.rest.cast<Jet>() * r;
  return DualQuaternionT<Jet>::from_rotation_translation(turned, offset);
}

Columns derivative(const Vector3J& v) {
  Columns out;
  for (int i = 0; i < 3; ++i) out.row(i) = v[i].v.transpose();
  return out;
}

/// World angular velocity per coordinate: vec(2 dq q*).
Columns turning(const QuaternionJ& q) {
  const Eigen::Quaterniond here(q.w().a, q.x().a, q.y().a, q.z().a);
  Columns out;
  for (int k = 0; k < kMostCoordinates; ++k) {
    const Eigen::Quaterniond rate(q.w().v[k], q.x().v[k], q.y().v[k], q.z().v[k]);
    out.col(k) = 2.0 * (rate * here.conjugate()).vec();
  }
  return out;
}

/// Six rows of the rig's only effector, which sits on the last joint of a chain.
Eigen::MatrixXd expected_rows(const Rig& rig, const Eigen::VectorXd& w,
                              const EffectorTarget& target, Step step) {
  std::vector<Jet> x;
  for (Eigen::Index k = 0; k < w.size(); ++k) x.emplace_back(w[k], static_cast<int>(k));
  DualQuaternionT<Jet> world = DualQuaternionT<Jet>::identity();
  std::size_t first = 0;
  for (const RigJoint& joint : rig.joints) {
    world = world * local_transform(joint, w.data() + first, x.data() + first, step);
    first += static_cast<std::size_t>(dof_count(joint.type));
  }
  const RigEffector& effector = rig.effectors[0];
  const bool axial =
      effector.kind == EffectorKind::direction || effector.kind == EffectorKind::line;
  Columns move = derivative(world.transform_point(effector.offset.cast<Jet>()));
  Columns turn = turning(world.real);
  if (axial) {  // n x dn, the turn across the axis
    const Vector3J axis = world.transform_direction(effector.axis.cast<Jet>());
    const Columns rate = derivative(axis);
    const Eigen::Vector3d n(axis[0].a, axis[1].a, axis[2].a);
    for (int k = 0; k < kMostCoordinates; ++k) turn.col(k) = n.cross(Eigen::Vector3d(rate.col(k)));
  }
  if (effector.kind == EffectorKind::line) {
    const Eigen::Vector3d n = target.pose.rotation() * effector.axis;
    move -= (n * n.transpose() * move).eval();
  }
  if (effector.kind == EffectorKind::orientation || effector.kind == EffectorKind::direction) {
    move.setZero();
  }
  if (effector.kind == EffectorKind::position) turn.setZero();
  Eigen::MatrixXd rows(6, w.size());
  rows << move.leftCols(w.size()), turn.leftCols(w.size());
  return rows;
}

/// A joint that moves, a fixed one, another that moves, and an effector at the end.
Rig chain(Random& random, const RigJoint& base, const RigJoint& tip, EffectorKind kind) {
  Rig rig;
  rig.joints = {base, test::random_joint(random, JointType::fixed, 0, 1), tip};
  rig.joints[2].parent = 1;
  rig.joints[2].name = "tip";
  rig.effectors.push_back({.name = "effector",
                           .joint = 2,
                           .offset = random.vector(0.2),
                           .kind = kind,
                           .axis = random.unit()});
  return rig;
}

double worst(const Eigen::MatrixXd& got, const Eigen::MatrixXd& expected) {
  return (got - expected).cwiseAbs().maxCoeff() / (1.0 + expected.cwiseAbs().maxCoeff());
}

void expect_both_jacobians(const Rig& rig, const Pose& at, const EffectorTarget& target) {
  const std::vector<EffectorTarget> targets{target};
  PaperIk paper(rig, {});
  Pose pose = at;
  paper.linearise(targets, pose);
  const Eigen::VectorXd w = paper.coordinates();
  Eigen::MatrixXd rows = paper.jacobian();
  rows.bottomRows<3>() *= 10.0;  // 0.1 m/rad
  const std::string label = std::string(to_string(rig.joints[0].type)) + ", " +
                            to_string(rig.joints[2].type) + ", " + to_string(rig.effectors[0].kind);
  EXPECT_LT(worst(rows, expected_rows(rig, w, target, Step::add)), kRelative) << label;

  const IkTree tree(rig);
  IkState state = tree.make_state();
  IkKinematics kinematics = tree.make_kinematics();
  std::vector<IkGoal> goals(1);
  tree.load(pose, state);
  tree.resolve(targets, goals);
  tree.evaluate(state, goals, kinematics);
  tree.linearise(state, kinematics);
  Eigen::MatrixXd by_tree(6, tree.coordinate_count());
  effector_jacobian(tree, goals, kinematics, by_tree);
  EXPECT_LT(worst(by_tree, expected_rows(rig, w, target, Step::multiply)), kRelative) << label;
}

const EffectorKind kKinds[] = {EffectorKind::pose, EffectorKind::position,
                               EffectorKind::orientation, EffectorKind::direction,
                               EffectorKind::line};

std::vector<RigJoint> joints_of_every_kind(Random& random) {
  std::vector<RigJoint> all;
  for (const JointType type :
       {JointType::hinge, JointType::universal, JointType::ball, JointType::free}) {
    all.push_back(test::random_joint(random, type, -1, 0));
    all.push_back(all.back());
    all.back().limits = {};
  }
  return all;
}

TEST(JacobianByAutodiff, EveryPairOfJointsAndEveryEffectorWithinLimits) {
  Random random(1);
  const std::vector<RigJoint> joints = joints_of_every_kind(random);
  for (const RigJoint& base : joints) {
    for (const RigJoint& tip : joints) {
      for (const EffectorKind kind : kKinds) {
        const Rig rig = chain(random, base, tip, kind);
        expect_both_jacobians(rig, test::allowed_pose(random, rig, 0.95), {random.motion()});
      }
    }
  }
}

/// The local transform of a limited joint in a corner: every coordinate on one of its bounds.
DualQuaternion corner(Random& random, const RigJoint& joint) {
  const auto bound = [&](int k) {
    return random.integer(0, 1) == 0 ? joint.limits[k].min : joint.limits[k].max;
  };
  Eigen::Quaterniond r;
  if (joint.type == JointType::hinge) {
    r = test::about(joint.axes[0], bound(0));
  } else if (joint.type == JointType::universal) {
    r = test::about(joint.axes[0], bound(0)) * test::about(joint.axes[1], bound(1));
  } else {
    const double angle = random.uniform(0.0, 2.0 * M_PI);
    const double u = std::cos(angle), v = std::sin(angle);
    const double s0 = u * (u < 0 ? -joint.limits[0].min : joint.limits[0].max);
    const double s1 = v * (v < 0 ? -joint.limits[1].min : joint.limits[1].max);
    r = compose({s0, s1, bound(2)}, joint.axes);
  }
  return DualQuaternion::from_rotation_translation(joint.rest * r, joint.offset);
}

TEST(JacobianByAutodiff, OnLimits) {
  Random random(2);
  for (const JointType type : {JointType::hinge, JointType::universal, JointType::ball}) {
    for (const EffectorKind kind : kKinds) {
      for (int trial = 0; trial < 10; ++trial) {
        const RigJoint joint = test::random_joint(random, type, -1, 0);
        const RigJoint tip = test::random_joint(random, type, -1, 0);
        const Rig rig = chain(random, joint, tip, kind);
        Pose pose = test::allowed_pose(random, rig);
        pose[0] = corner(random, rig.joints[0]);
        pose[2] = corner(random, rig.joints[2]);
        expect_both_jacobians(rig, pose, {random.motion()});
      }
    }
  }
}

TEST(JacobianByAutodiff, SwingsAndTwistsUpToTheirBoundNearPi) {
  Random random(3);
  for (const double short_of_pi : {1e-3, 2e-3, 0.01, 0.1}) {
    for (const EffectorKind kind : kKinds) {
      for (int trial = 0; trial < 10; ++trial) {
        RigJoint ball = test::random_joint(random, JointType::ball, -1, 0);
        for (Range& range : ball.limits) range = {-M_PI, M_PI};
        RigJoint tip = ball;
        tip.limits[2] = {-0.5, 3.0};
        const Rig rig = chain(random, ball, tip, kind);
        Pose pose = test::allowed_pose(random, rig);
        for (const int j : {0, 2}) {
          const double a = random.uniform(-M_PI, M_PI), size = M_PI - short_of_pi;
          const double twist = j == 0 ? random.uniform(-M_PI, M_PI) : 3.0;
          const SwingTwist st{size * std::cos(a), size * std::sin(a), twist};
          pose[j] = DualQuaternion::from_rotation_translation(
              rig.joints[j].rest * compose(st, rig.joints[j].axes), rig.joints[j].offset);
        }
        expect_both_jacobians(rig, pose, {random.motion()});
      }
    }
  }
}

TEST(JacobianByAutodiff, RotationVectorsUpToPiAndNearZero) {
  Random random(4);
  for (const double angle : {0.0, 1e-9, 1e-6, 0.0099, 0.0101, 3.0, M_PI - 1e-6, M_PI}) {
    for (const JointType type : {JointType::ball, JointType::free}) {
      for (const EffectorKind kind : kKinds) {
        RigJoint joint = test::random_joint(random, type, -1, 0);
        joint.limits = {};
        const Rig rig = chain(random, joint, joint, kind);
        Pose pose = test::allowed_pose(random, rig);
        for (const int j : {0, 2}) {
          pose[j] = DualQuaternion::from_rotation_translation(
              rig.joints[j].rest * test::about(random.unit(), angle), pose[j].translation());
        }
        expect_both_jacobians(rig, pose, {random.motion()});
      }
    }
  }
}

}  // namespace
}  // namespace limber
