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
constexpr double kCentreReach = 0.7;      // the square inside the unit disc
constexpr double kPolarFrom = 0.5;        // disc radius from which the polar chart is used
constexpr double kPolarReach = 0.2;       // and how far in it may go
const double kInfinity = std::numeric_limits<double>::infinity();

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

/// Left Jacobian of SO(3): exp(v + dv) = exp(Jl dv) exp(v) to first order.
Eigen::Matrix3d left_jacobian(const Eigen::Vector3d& v) {
  const double t2 = v.squaredNorm(), t = std::sqrt(t2);
  const double b = t < 1e-4 ? 0.5 - t2 / 24.0 : (1.0 - std::cos(t)) / t2;
  const double c = t < 1e-4 ? 1.0 / 6.0 - t2 / 120.0 : (t - std::sin(t)) / (t2 * t);
  const Eigen::Matrix3d k = cross_matrix(v);
  return Eigen::Matrix3d::Identity() + b * k + c * k * k;
}

/// Inverse right Jacobian of SO(3): log(exp(v) exp(dw)) = v + Jr^-1 dw to first order.
Eigen::Matrix3d inverse_right_jacobian(const Eigen::Vector3d& v) {
  const double t2 = v.squaredNorm(), t = std::sqrt(t2);
  const double c = t < 1e-4 ? 1.0 / 12.0 + t2 / 720.0 : 1.0 / t2 - 0.5 / (t * std::tan(0.5 * t));
  const Eigen::Matrix3d k = cross_matrix(v);
  return Eigen::Matrix3d::Identity() + 0.5 * k + c * k * k;
}

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

bool unlimited_rotation(const RigJoint& joint) {
  return joint.type == JointType::free || (joint.type == JointType::ball && !joint.limited());
}

}  // namespace

EffectorProblem::EffectorProblem(const Rig& rig, std::span<const EffectorTarget> targets)
    : rig_(rig), targets_(targets), begin_(dof_begin(rig)) {
  chart_.assign(rig.joints.size(), Chart::none);
  reference_.assign(rig.joints.size(), Eigen::Quaterniond::Identity());
  x_ = Eigen::VectorXd::Zero(begin_.back());
  lower_ = Eigen::VectorXd::Constant(begin_.back(), -kInfinity);
  upper_ = -lower_;
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    const RigJoint& joint = rig.joints[i];
    if (!joint.limited()) continue;
    // A ball's first two are set with its chart.
    for (int k = joint.type == JointType::ball ? 2 : 0; k < dof_count(joint.type); ++k) {
      lower_[begin_[i] + k] = joint.limits[k].min;
      upper_[begin_[i] + k] = joint.limits[k].max;
    }
  }
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

void EffectorProblem::choose_chart(std::int32_t joint, const Eigen::Vector2d& disc) {
  const std::int32_t k = begin_[joint];
  const double radius = disc.norm();
  if (radius < kPolarFrom) {
    chart_[joint] = Chart::centre;
    x_.segment<2>(k) = disc;
    lower_.segment<2>(k).setConstant(-kCentreReach);
    upper_.segment<2>(k).setConstant(kCentreReach);
  } else {
    chart_[joint] = Chart::polar;
    x_[k] = std::min(radius, 1.0);
    x_[k + 1] = std::atan2(disc[1], disc[0]);
    lower_[k] = kPolarReach;
    upper_[k] = 1.0;
    lower_[k + 1] = -kInfinity;
    upper_[k + 1] = kInfinity;
  }
}

Eigen::Vector2d EffectorProblem::disc_point(std::int32_t joint, const double* x) const {
  if (chart_[joint] == Chart::centre) return {x[0], x[1]};
  return {x[0] * std::cos(x[1]), x[0] * std::sin(x[1])};
}

void EffectorProblem::start_from(std::span<const DualQuaternion> parent_from_joint) {
  for (std::int32_t i = 0; i < rig_.size(); ++i) {
    const RigJoint& joint = rig_.joints[i];
    const std::int32_t k = begin_[i];
    const Eigen::Quaterniond local = parent_from_joint[i].rotation();
    if (unlimited_rotation(joint)) {
      reference_[i] = (joint.rest.conjugate() * local).normalized();
      x_.segment(k, dof_count(joint.type)).setZero();
      if (joint.type == JointType::free) {
        x_.segment<3>(k) = parent_from_joint[i].translation() - joint.offset;
      }
      continue;
    }
    const Eigen::Vector3d angles = joint_angles(joint, joint_rotation(joint, local));
    if (joint.type == JointType::ball) {
      const Eigen::Vector2d swing = nearest_swing(joint, angles.head<2>());
      Eigen::Vector2d disc;
      for (int d = 0; d < 2; ++d) {
        const double bound = swing_bound(joint.limits[d], swing[d]);
        disc[d] = bound > 0.0 ? swing[d] / bound : 0.0;
      }
      choose_chart(i, disc);
      x_[k + 2] = nearest_in_range(joint.limits[2], angles[2]);
    } else {
      for (int d = 0; d < dof_count(joint.type); ++d) {
        x_[k + d] = nearest_in_range(joint.limits[d], angles[d]);
      }
    }
  }
}

void EffectorProblem::rechart() {
  for (std::int32_t i = 0; i < rig_.size(); ++i) {
    if (chart_[i] != Chart::none) choose_chart(i, disc_point(i, &x_[begin_[i]]));
  }
}

int EffectorProblem::ball_rotation(std::int32_t i, const double* x, Eigen::Quaterniond& r,
                                   Eigen::Matrix3d* columns) const {
  const RigJoint& joint = rig_.joints[i];
  const Eigen::Vector2d disc = disc_point(i, x);
  const Eigen::Vector2d bound(swing_bound(joint.limits[0], disc[0]),
                              swing_bound(joint.limits[1], disc[1]));
  const Eigen::Vector2d s = bound.cwiseProduct(disc);
  const Eigen::Vector3d swing = s[0] * joint.axes[0] + s[1] * joint.axes[1];
  const Eigen::Quaterniond swing_rotation = rotation_exp(swing);
  r = swing_rotation * rotation_exp(Eigen::Vector3d(x[2] * joint.axes[2]));
  if (columns) {
    Eigen::Matrix2d ds = bound.asDiagonal();
    if (chart_[i] == Chart::polar) {
      const double c = std::cos(x[1]), sn = std::sin(x[1]);
      Eigen::Matrix2d chart;
      chart << c, -x[0] * sn, sn, x[0] * c;
      ds = ds * chart;
    }
    Eigen::Matrix<double, 3, 2> axes;
    axes << joint.axes[0], joint.axes[1];
    columns->leftCols<2>() = left_jacobian(swing) * axes * ds;
    columns->col(2) = swing_rotation * joint.axes[2];
  }
  return 3;
}

int EffectorProblem::rotation(std::int32_t i, const double* x, Eigen::Quaterniond& r,
                              Eigen::Matrix3d* columns) const {
  const RigJoint& joint = rig_.joints[i];
  if (unlimited_rotation(joint)) {
    const Eigen::Vector3d v = Eigen::Map<const Eigen::Vector3d>(x + dof_count(joint.type) - 3);
    r = reference_[i] * rotation_exp(v);
    if (columns) *columns = reference_[i].toRotationMatrix() * left_jacobian(v);
    return 3;
  }
  if (joint.type == JointType::ball) return ball_rotation(i, x, r, columns);
  r.setIdentity();
  if (joint.type == JointType::fixed) return 0;
  r = rotation_exp(Eigen::Vector3d(x[0] * joint.axes[0]));
  if (columns) columns->col(0) = joint.axes[0];
  if (joint.type == JointType::hinge) return 1;
  if (columns) columns->col(1) = r * joint.axes[1];
  r = r * rotation_exp(Eigen::Vector3d(x[1] * joint.axes[1]));
  return 2;
}

void EffectorProblem::pose(const Eigen::VectorXd& x,
                           std::span<DualQuaternion> parent_from_joint) const {
  for (std::int32_t i = 0; i < rig_.size(); ++i) {
    const RigJoint& joint = rig_.joints[i];
    const double* xi = x.data() + begin_[i];
    Eigen::Quaterniond r;
    rotation(i, xi, r, nullptr);
    Eigen::Vector3d t = joint.offset;
    if (joint.type == JointType::free) t += Eigen::Map<const Eigen::Vector3d>(xi);
    parent_from_joint[i] =
        DualQuaternion::from_rotation_translation((joint.rest * r).normalized(), t);
  }
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
  pose(x, local);
  model_pose(local, world);
  residual.resize(residuals_);
  // World angular velocity per coordinate; free joints: three translations come before.
  Eigen::Matrix3Xd turns;
  if (jacobian) {
    jacobian->setZero(residuals_, x.size());
    turns.setZero(3, x.size());
    for (std::int32_t i = 0; i < rig_.size(); ++i) {
      const RigJoint& joint = rig_.joints[i];
      Eigen::Quaterniond r, parent = Eigen::Quaterniond::Identity();
      if (joint.parent != kNoJoint) parent = world[joint.parent].rotation();
      Eigen::Matrix3d columns;
      const int count = rotation(i, x.data() + begin_[i], r, &columns);
      turns.middleCols(begin_[i + 1] - count, count) =
          (parent * joint.rest).toRotationMatrix() * columns.leftCols(count);
    }
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
        for (std::int32_t k = begin_[i]; k < begin_[i + 1]; ++k) {
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
    for (std::int32_t k = begin_[i]; k < begin_[i + 1]; ++k) {
      Eigen::Matrix<double, 6, 1> motion;
      if (moves && k < begin_[i] + 3) {
        const Eigen::Vector3d along = Eigen::Vector3d::Unit(k - begin_[i]);
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
    const std::int32_t from = begin_[c.from_joint] + c.from_dof;
    const std::int32_t to = begin_[c.to_joint] + c.to_dof;
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
