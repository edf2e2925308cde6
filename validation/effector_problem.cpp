#include "validation/effector_problem.h"

#include <algorithm>
#include <cmath>

#include "assets/model/eye_head_shoulder.h"
#include "validation/joint_angles.h"

// Derivation of the Jacobian. A joint coordinate turns everything below the joint with the world
// angular velocity w about the joint's origin c (and moves it with v, for free joints). For an
// effector point p: dp = v + w x (p - c). For rotation residuals e = log(R_t R') (the rotation
// vector from now to the target): R becomes exp(w) R, so exp(e) becomes exp(e) exp(-w), and
// de = -Jr^-1(e) w with Jr the right Jacobian of SO(3). For directions, e = angle(a, d) along
// a x d, and a moves by w x a: de = D w. A gaze's d, the direction n to the target at distance r,
// turns by u = -(n x v) / r as the eye moves by v. Turning a and d alike turns e, so turning d
// alone gives de = (u x e) - D u, that is ([e] + D) [n] v / r.
//
// A relative target moves with its base. Moving the base by a twist is moving the effector by the
// opposite one, and then everything, residuals included, by the twist: for a residual e the base's
// column is minus what the twist, taken at the effector's point, does to e, plus w x e.

namespace limber {
namespace {

constexpr double kMetresPerRadian = 0.1;  // of the objective: (0.1 m/rad weight_rot |dtheta|)^2

/// Rotation vector of the smallest turn from unit a to unit d, and its change when a moves by
/// w x a: de = D w.
Eigen::Vector3d turn_between(const Eigen::Vector3d& a, const Eigen::Vector3d& d,
                             Eigen::Matrix3d* by_turn) {
  const Eigen::Vector3d u = a.cross(d);
  const double s = u.norm(), c = a.dot(d), angle = std::atan2(s, c);
  if (s < 1e-9 && c < 0.0) {  // opposite: any perpendicular axis; the turn about it is known
    const Eigen::Vector3d n = a.unitOrthogonal();
    if (by_turn) *by_turn = -n * n.transpose();
    return M_PI * n;
  }
  const double k = s < 1e-6 ? 1.0 + s * s / 6.0 : angle / s;
  if (by_turn) {
    // du = (w x a) x d = a (w.d) - w (a.d); dangle = -w.n with n = u/s.
    const Eigen::Matrix3d du = a * d.transpose() - c * Eigen::Matrix3d::Identity();
    *by_turn = k * du;
    if (s >= 1e-6) {
      const Eigen::Vector3d n = u / s;
      *by_turn += n * (-n.transpose() - k * (n.transpose() * du));
    }
  }
  return k * u;
}

bool has_position(EffectorKind kind) {
  return kind == EffectorKind::pose || kind == EffectorKind::position || kind == EffectorKind::line;
}
bool has_rotation(EffectorKind kind) { return kind != EffectorKind::position; }

Eigen::Index row_count(EffectorKind kind) {
  return (has_position(kind) ? 3 : 0) + (has_rotation(kind) ? 3 : 0);
}

}  // namespace

EffectorProblem::EffectorProblem(const Rig& rig, std::span<const EffectorTarget> targets)
    : rig_(rig), targets_(targets), chart_(rig) {
  for (const RigEffector& effector : rig.effectors) residuals_ += row_count(effector.kind);
  residuals_ += static_cast<Eigen::Index>(rig.couplings.size());
}

const char* EffectorProblem::lacks(const Rig& rig) {
  for (const RigEffector& effector : rig.effectors) {
    if (effector.priority != rig.effectors[0].priority) return "strict priorities";
  }
  const auto is_swing = [&](std::int32_t joint, std::int32_t dof) {
    return rig.joints[joint].type == JointType::ball && dof < 2;
  };
  for (const Coupling& c : rig.couplings) {
    if (is_swing(c.from_joint, c.from_dof) || is_swing(c.to_joint, c.to_dof)) {
      return "couplings of a ball's swing";
    }
  }
  return nullptr;
}

void EffectorProblem::model_pose(std::span<const DualQuaternion> parent_from_joint,
                                 std::vector<DualQuaternion>& world) const {
  world.resize(rig_.joints.size());
  for (std::int32_t i = 0; i < rig_.size(); ++i) {
    const std::int32_t parent = rig_.joints[i].parent;
    world[i] = parent == kNoJoint ? parent_from_joint[i] : world[parent] * parent_from_joint[i];
  }
}

void EffectorProblem::effector_rows(std::size_t e, std::span<const DualQuaternion> world,
                                    Eigen::Index row, Eigen::VectorXd& residual,
                                    Eigen::Matrix<double, 6, 6>* by_motion) const {
  // by_motion: residual rows against (velocity of the effector point, angular velocity).
  const RigEffector& effector = rig_.effectors[e];
  const DualQuaternion& world_from_joint = world[effector.joint];
  EffectorTarget target = targets_[e];
  if (effector.relative_to != kNoJoint) target.pose = world[effector.relative_to] * target.pose;
  const double wp = effector.weight_pos * target.weight;
  const double wr = kMetresPerRadian * effector.weight_rot * target.weight;
  const Eigen::Quaterniond now = world_from_joint.rotation(), goal = target.pose.rotation();
  const Eigen::Vector3d axis = now * effector.axis, goal_axis = goal * effector.axis;
  if (by_motion) by_motion->setZero();
  if (has_position(effector.kind)) {
    const Eigen::Vector3d dp =
        world_from_joint.transform_point(effector.offset) - target.pose.translation();
    Eigen::Matrix3d seen = wp * Eigen::Matrix3d::Identity();
    // A point may slide along the target's line.
    if (effector.kind == EffectorKind::line) seen -= wp * goal_axis * goal_axis.transpose();
    residual.segment<3>(row) = seen * dp;
    if (by_motion) by_motion->topLeftCorner<3, 3>() = seen;
    row += 3;
  }
  if (!has_rotation(effector.kind)) return;
  const int first = has_position(effector.kind) ? 3 : 0;
  Eigen::Matrix3d by_turn;
  if (effector.kind == EffectorKind::gaze) {
    residual.segment<3>(row).setZero();
    const Eigen::Vector3d sight =
        target.pose.translation() - world_from_joint.transform_point(effector.offset);
    const double distance = sight.norm();
    if (distance <= kNearestGaze) return;
    const Eigen::Vector3d n = sight / distance;
    const Eigen::Vector3d turn = turn_between(axis, n, by_motion ? &by_turn : nullptr);
    residual.segment<3>(row) = wr * turn;
    if (by_motion) {
      by_motion->topLeftCorner<3, 3>() =
          (wr / distance) * (cross_matrix(turn) + by_turn) * cross_matrix(n);
    }
  } else if (effector.kind == EffectorKind::direction || effector.kind == EffectorKind::line) {
    residual.segment<3>(row) = wr * turn_between(axis, goal_axis, by_motion ? &by_turn : nullptr);
  } else {
    const Eigen::Vector3d turn = rotation_log(Eigen::Quaterniond(goal * now.conjugate()));
    residual.segment<3>(row) = wr * turn;
    if (by_motion) by_turn = -inverse_right_jacobian(turn);
  }
  if (by_motion) by_motion->block<3, 3>(first, 3) = wr * by_turn;
}

void EffectorProblem::evaluate(const Eigen::VectorXd& x, Eigen::VectorXd& residual,
                               Eigen::MatrixXd* jacobian) const {
  std::vector<DualQuaternion> local(rig_.joints.size()), world;
  chart_.pose(x, local);
  model_pose(local, world);
  residual.resize(residuals_);
  // World angular velocity per coordinate; free joints: three translations come before.
  Eigen::Matrix3Xd turns;
  if (jacobian) {
    jacobian->setZero(residuals_, x.size());
    chart_.turns(x, world, turns);
  }
  Eigen::Index row = 0;
  for (std::size_t e = 0; e < rig_.effectors.size(); ++e) {
    const RigEffector& effector = rig_.effectors[e];
    const Eigen::Index rows = row_count(effector.kind);
    Eigen::Matrix<double, 6, 6> by_motion;
    effector_rows(e, world, row, residual, jacobian ? &by_motion : nullptr);
    const Eigen::Vector3d point = world[effector.joint].transform_point(effector.offset);
    if (jacobian != nullptr) {
      chain_columns(effector.joint, point, world, turns, by_motion, row, rows, *jacobian);
      const Eigen::Matrix<double, 6, 6> opposite = -by_motion;
      const std::int32_t base = effector.relative_to;
      if (base != kNoJoint) {
        chain_columns(base, point, world, turns, opposite, row, rows, *jacobian);
      }
      for (std::int32_t i = base; i != kNoJoint; i = rig_.joints[i].parent) {
        for (std::int32_t k = chart_.begin()[i]; k < chart_.begin()[i + 1]; ++k) {
          const Eigen::Vector3d turn = turns.col(k);  // zero for translations
          for (Eigen::Index r = row; r < row + rows; r += 3) {
            jacobian->block<3, 1>(r, k) += turn.cross(residual.segment<3>(r));
          }
        }
      }
    }
    row += rows;
  }
  coupling_rows(x, row, residual, jacobian);
}

void EffectorProblem::chain_columns(std::int32_t joint, const Eigen::Vector3d& point,
                                    std::span<const DualQuaternion> world,
                                    const Eigen::Matrix3Xd& turns,
                                    const Eigen::Matrix<double, 6, 6>& by_motion, Eigen::Index row,
                                    Eigen::Index rows, Eigen::MatrixXd& jacobian) const {
  for (std::int32_t i = joint; i != kNoJoint; i = rig_.joints[i].parent) {
    const Eigen::Vector3d arm = point - world[i].translation();
    const std::int32_t parent = rig_.joints[i].parent;
    const bool moves = rig_.joints[i].type == JointType::free;
    for (std::int32_t k = chart_.begin()[i]; k < chart_.begin()[i + 1]; ++k) {
      Eigen::Matrix<double, 6, 1> motion;
      if (moves && k < chart_.begin()[i] + 3) {
        const Eigen::Vector3d along = Eigen::Vector3d::Unit(k - chart_.begin()[i]);
        motion << (parent == kNoJoint ? along : world[parent].transform_direction(along)),
            Eigen::Vector3d::Zero();
      } else {
        motion << turns.col(k).cross(arm), turns.col(k);
      }
      jacobian.block(row, k, rows, 1) += by_motion.topRows(rows) * motion;
    }
  }
}

void EffectorProblem::coupling_rows(const Eigen::VectorXd& x, Eigen::Index row,
                                    Eigen::VectorXd& residual, Eigen::MatrixXd* jacobian) const {
  for (const Coupling& c : rig_.couplings) {
    const std::int32_t from = chart_.begin()[c.from_joint] + c.from_dof;
    const std::int32_t to = chart_.begin()[c.to_joint] + c.to_dof;
    residual[row] = kCouplingWeight * (x[to] - c.ratio * x[from] - c.offset);
    if (jacobian != nullptr) {
      (*jacobian)(row, to) += kCouplingWeight;
      (*jacobian)(row, from) -= kCouplingWeight * c.ratio;
    }
    ++row;
  }
}

double EffectorProblem::cost(const Eigen::VectorXd& x) const {
  Eigen::VectorXd residual;
  evaluate(x, residual, nullptr);
  return residual.squaredNorm();
}

double EffectorProblem::cost_of_pose(std::span<const DualQuaternion> parent_from_joint) const {
  std::vector<DualQuaternion> world;
  model_pose(parent_from_joint, world);
  Eigen::VectorXd residual = Eigen::VectorXd::Zero(residuals_);  // couplings stay zero
  Eigen::Index row = 0;
  for (std::size_t e = 0; e < rig_.effectors.size(); ++e) {
    effector_rows(e, world, row, residual, nullptr);
    row += row_count(rig_.effectors[e].kind);
  }
  return residual.squaredNorm();
}

}  // namespace limber
