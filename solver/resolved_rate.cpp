// Resolved-rate control. A coordinate's axis is a screw S (a line that is turned about, or a
// direction to slide along), so that at unit velocity a point p moves by S.dual + S.real x p and a
// line L by S x L: the columns of J. With v the targets' velocity and e the error,
//   x = J+ (v + k1 e) + (1 - J+ J) w,   q <- q exp(x dt)          (eqs. 24 to 26)
// where J+ comes from the singular values s of J: 1/s, or s / (s^2 + k0) if damped (appendix G.4),
// and 0 below the rank. One step of the error is e <- (1 - k1 dt) e + O(dt^2), hence the bound on
// k1.
//
// The paper takes three velocities per joint and adds the rows axis x velocity = 0 for a hinge.
// Here a hinge is one column. Those rows have rank 2 and leave just that column open, so the answer
// is the same and the rank of its matrix is ours plus 2 per hinge: its nine rows for a line
// (appendix H.1) have rank 4 + 2 = 6, not 8, a line having four degrees of freedom, not six.
#include "solver/resolved_rate.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace limber {

namespace {

using Eigen::Vector3d;

Eigen::Index row_count(const RigEffector& effector) {
  return effector.kind == EffectorKind::line ? 6 : 3;
}

DualVector line_of(const DualQuaternion& world_from_effector, const Vector3d& axis) {
  return DualVector::line(world_from_effector.translation(),
                          world_from_effector.transform_direction(axis));
}

void put(const DualVector& v, Eigen::Ref<Eigen::VectorXd> rows) {
  rows.head<3>() = v.real;
  rows.tail<3>() = v.dual;
}

}  // namespace

ResolvedRate::ResolvedRate(const Rig& rig, const ResolvedRateOptions& options, Eigen::Index rows)
    : rig_(rig),
      options_(options),
      skeleton_(skeleton_of(rig)),
      begin_(dof_begin(rig)),
      world_(rig.joints.size()),
      axis_(begin_.back()),
      jacobian_(rows, begin_.back()),
      wanted_(rows),
      along_(std::min<Eigen::Index>(rows, begin_.back())),
      velocity_(begin_.back()),
      svd_(rows, begin_.back(), Eigen::ComputeThinU | Eigen::ComputeThinV) {}

Result<ResolvedRate> ResolvedRate::create(const Rig& rig, const ResolvedRateOptions& options) {
  if (Result<void> valid = validate(rig); !valid) return valid.error();
  const auto refuse = [](std::string message, std::string hint) {
    return Error{.code = "solver-options", .message = std::move(message), .hint = std::move(hint)};
  };
  Eigen::Index rows = 0;
  for (const RigEffector& effector : rig.effectors) {
    if (effector.kind != EffectorKind::position && effector.kind != EffectorKind::line) {
      return refuse("effector '" + effector.name + "' is neither a position nor a line",
                    "resolved-rate control follows points and lines");
    }
    rows += row_count(effector);
  }
  if (rows == 0 || dof_count(rig) == 0) {
    return refuse("there is nothing to control", "give the rig a joint that moves and an effector");
  }
  if (!(options.step_s > 0.0) || !(options.feedback >= 0.0) || !(options.damping >= 0.0) ||
      !(options.rank_tolerance > 0.0)) {
    return refuse("step and rank tolerance must be positive, feedback and damping at least zero",
                  "leave the option out to get its default");
  }
  return ResolvedRate(rig, options, rows);
}

ResolvedRateReport ResolvedRate::step(std::span<const MovingTransform> targets,
                                      std::span<DualQuaternion> parent_from_joint,
                                      std::span<const double> wish) {
  assert(targets.size() == rig_.effectors.size());
  assert(wish.empty() || wish.size() == axis_.size());
  ResolvedRateReport report;
  place_axes(parent_from_joint);
  fill_rows(targets, report);
  report.rank = solve(wish);
  advance(parent_from_joint);
  return report;
}

void ResolvedRate::place_axes(std::span<const DualQuaternion> parent_from_joint) {
  model_from_local(skeleton_, parent_from_joint, world_);
  for (std::int32_t i = 0; i < rig_.size(); ++i) {
    const RigJoint& joint = rig_.joints[i];
    const Vector3d centre = world_[i].translation();
    DualVector* axis = axis_.data() + begin_[i];
    const auto parent_direction = [&](const Vector3d& d) {
      return joint.parent == kNoJoint ? d : world_[joint.parent].transform_direction(d);
    };
    if (joint.type == JointType::hinge) {
      *axis++ = DualVector::line(centre, world_[i].transform_direction(joint.axes[0]));
    } else if (joint.type == JointType::universal) {
      *axis++ = DualVector::line(centre, parent_direction(joint.rest * joint.axes[0]));
      *axis++ = DualVector::line(centre, world_[i].transform_direction(joint.axes[1]));
    } else if (joint.type == JointType::ball || joint.type == JointType::free) {
      for (int k = 0; joint.type == JointType::free && k < 3; ++k) {
        *axis++ = {Vector3d::Zero(), parent_direction(Vector3d::Unit(k))};
      }
      for (int k = 0; k < 3; ++k) {
        *axis++ = DualVector::line(centre, world_[i].transform_direction(Vector3d::Unit(k)));
      }
    }
  }
}

void ResolvedRate::fill_rows(std::span<const MovingTransform> targets, ResolvedRateReport& report) {
  jacobian_.setZero();
  Eigen::Index row = 0;
  for (std::size_t e = 0; e < rig_.effectors.size(); ++e) {
    const RigEffector& effector = rig_.effectors[e];
    const MovingTransform& target = targets[e];
    const Eigen::Index rows = row_count(effector);
    const bool is_line = effector.kind == EffectorKind::line;
    const DualQuaternion now =
        world_[effector.joint] * DualQuaternion::from_translation(effector.offset);
    const Vector3d point = now.translation(), goal = target.a_from_b.translation();
    const DualVector line = line_of(now, effector.axis);
    if (is_line) {
      const DualVector wanted = line_of(target.a_from_b, effector.axis);
      put(cross(target.twist, wanted) + options_.feedback * (wanted - line),
          wanted_.segment(row, rows));
      report.line_error = std::max(report.line_error, (wanted.real - line.real).norm());
    } else {
      wanted_.segment<3>(row) = target.twist.velocity_at(goal) + options_.feedback * (goal - point);
      report.point_error = std::max(report.point_error, (goal - point).norm());
    }
    for (std::int32_t i = effector.joint; i != kNoJoint; i = rig_.joints[i].parent) {
      for (std::int32_t k = begin_[i]; k < begin_[i + 1]; ++k) {
        if (is_line) {
          put(cross(axis_[k], line), jacobian_.col(k).segment(row, rows));
        } else {
          jacobian_.col(k).segment<3>(row) = axis_[k].velocity_at(point);
        }
      }
    }
    row += rows;
  }
}

int ResolvedRate::solve(std::span<const double> wish) {
  svd_.compute(jacobian_);
  const auto& s = svd_.singularValues();
  int rank = 0;
  while (rank < s.size() && s[rank] > options_.rank_tolerance * s[0]) ++rank;
  const auto u = svd_.matrixU().leftCols(rank);
  const auto v = svd_.matrixV().leftCols(rank);
  auto along = along_.head(rank);
  along.noalias() = u.transpose() * wanted_;
  for (int i = 0; i < rank; ++i) along[i] *= s[i] / (s[i] * s[i] + options_.damping);
  velocity_.noalias() = v * along;
  if (!wish.empty()) {
    const Eigen::Map<const Eigen::VectorXd> w(wish.data(), velocity_.size());
    along.noalias() = v.transpose() * w;
    velocity_ += w;
    velocity_.noalias() -= v * along;
  }
  return rank;
}

void ResolvedRate::advance(std::span<DualQuaternion> parent_from_joint) const {
  const auto turn = [](const Vector3d& v) { return DualQuaternion::exp({v, Vector3d::Zero()}); };
  for (std::int32_t i = 0; i < rig_.size(); ++i) {
    const RigJoint& joint = rig_.joints[i];
    const auto x = options_.step_s * velocity_.segment(begin_[i], begin_[i + 1] - begin_[i]);
    DualQuaternion& q = parent_from_joint[i];
    switch (joint.type) {
      case JointType::fixed:
        continue;
      case JointType::hinge:
        q = q * turn(x[0] * joint.axes[0]);
        break;
      case JointType::universal: {  // between offset and rotation, and after it
        const DualQuaternion home = DualQuaternion::from_translation(q.translation());
        const DualQuaternion first = turn(joint.rest * Vector3d(x[0] * joint.axes[0]));
        q = home * first * home.conjugate() * q * turn(x[1] * joint.axes[1]);
        break;
      }
      case JointType::ball:
        q = q * turn(x);
        break;
      case JointType::free:
        q = DualQuaternion::from_translation(x.head<3>()) * q * turn(x.tail<3>());
        break;
    }
    q = q.normalized();
  }
}

}  // namespace limber
