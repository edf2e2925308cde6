#include "validation/pose_chart.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "validation/joint_angles.h"

namespace limber {
namespace {

constexpr double kCentreReach = 0.7;  // the square inside the unit disc
constexpr double kPolarFrom = 0.5;    // disc radius from which the polar chart is used
constexpr double kPolarReach = 0.2;   // and how far in it may go
const double kInfinity = std::numeric_limits<double>::infinity();

bool unlimited_rotation(const RigJoint& joint) {
  return joint.type == JointType::free || (joint.type == JointType::ball && !joint.limited());
}

}  // namespace

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

Eigen::Matrix3d left_jacobian(const Eigen::Vector3d& v) {
  const double t2 = v.squaredNorm(), t = std::sqrt(t2);
  const double b = t < 1e-4 ? 0.5 - t2 / 24.0 : (1.0 - std::cos(t)) / t2;
  const double c = t < 1e-4 ? 1.0 / 6.0 - t2 / 120.0 : (t - std::sin(t)) / (t2 * t);
  const Eigen::Matrix3d k = cross_matrix(v);
  return Eigen::Matrix3d::Identity() + b * k + c * k * k;
}

Eigen::Matrix3d inverse_right_jacobian(const Eigen::Vector3d& v) {
  const double t2 = v.squaredNorm(), t = std::sqrt(t2);
  const double c = t < 1e-4 ? 1.0 / 12.0 + t2 / 720.0 : 1.0 / t2 - 0.5 / (t * std::tan(0.5 * t));
  const Eigen::Matrix3d k = cross_matrix(v);
  return Eigen::Matrix3d::Identity() + 0.5 * k + c * k * k;
}

PoseChart::PoseChart(const Rig& rig) : rig_(&rig), begin_(dof_begin(rig)) {
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
}

void PoseChart::choose_chart(std::int32_t joint, const Eigen::Vector2d& disc) {
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

Eigen::Vector2d PoseChart::disc_point(std::int32_t joint, const double* x) const {
  if (chart_[joint] == Chart::centre) return {x[0], x[1]};
  return {x[0] * std::cos(x[1]), x[0] * std::sin(x[1])};
}

void PoseChart::start_from(std::span<const DualQuaternion> parent_from_joint) {
  for (std::int32_t i = 0; i < rig_->size(); ++i) {
    const RigJoint& joint = rig_->joints[i];
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

void PoseChart::rechart() {
  for (std::int32_t i = 0; i < rig_->size(); ++i) {
    if (chart_[i] != Chart::none) choose_chart(i, disc_point(i, &x_[begin_[i]]));
    if (!unlimited_rotation(rig_->joints[i])) continue;
    auto v = x_.segment<3>(begin_[i + 1] - 3);
    reference_[i] = (reference_[i] * rotation_exp(Eigen::Vector3d(v))).normalized();
    v.setZero();
  }
}

int PoseChart::ball_rotation(std::int32_t i, const double* x, Eigen::Quaterniond& r,
                             Eigen::Matrix3d* columns) const {
  const RigJoint& joint = rig_->joints[i];
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

int PoseChart::rotation(std::int32_t i, const double* x, Eigen::Quaterniond& r,
                        Eigen::Matrix3d* columns) const {
  const RigJoint& joint = rig_->joints[i];
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

void PoseChart::pose(const Eigen::VectorXd& x, std::span<DualQuaternion> parent_from_joint) const {
  for (std::int32_t i = 0; i < rig_->size(); ++i) {
    const RigJoint& joint = rig_->joints[i];
    const double* xi = x.data() + begin_[i];
    Eigen::Quaterniond r;
    rotation(i, xi, r, nullptr);
    Eigen::Vector3d t = joint.offset;
    if (joint.type == JointType::free) t += Eigen::Map<const Eigen::Vector3d>(xi);
    parent_from_joint[i] =
        DualQuaternion::from_rotation_translation((joint.rest * r).normalized(), t);
  }
}

void PoseChart::turns(const Eigen::VectorXd& x, std::span<const DualQuaternion> world,
                      Eigen::Matrix3Xd& turns) const {
  turns.setZero(3, x.size());
  for (std::int32_t i = 0; i < rig_->size(); ++i) {
    const RigJoint& joint = rig_->joints[i];
    Eigen::Quaterniond r, parent = Eigen::Quaterniond::Identity();
    if (joint.parent != kNoJoint) parent = world[joint.parent].rotation();
    Eigen::Matrix3d columns;
    const int count = rotation(i, x.data() + begin_[i], r, &columns);
    turns.middleCols(begin_[i + 1] - count, count) =
        (parent * joint.rest).toRotationMatrix() * columns.leftCols(count);
  }
}

}  // namespace limber
