// A clip's cost is the integral that follows, as a sum over frames:
//
//   J = sum_f E(x_f) + C(x_f) + |w (m(f-1) - 2 m(f) + m(f+1))|^2.
//
// E is the solver's own effector cost of each frame. C holds what stands where it stands: for every
// point in contact, contact^2 times its squared horizontal distance from the contact's place.
//
// The last term is smoothness: of how the clip departs from a reference, the solver's own answer
// without what is faster than a short window. Bending as the reference does costs nothing, so a
// kick stays a kick; what the solver's frames did each for itself, where a limit or a contact took
// hold, is spread. m are the departures, of effector points p and of joints' turns,
//
//   m = (p - p_ref, r log(R_ref' R)),
//
// r a radius in m per rad. With w = (s rate)^2 the sum is that of |s^2 m''|^2, whatever the rate: a
// departure a sin(t / s) costs as much by its bends as an effector of weight 1 would cost by being
// a away. Slower ones are hardly felt, faster ones fall with the fourth power of their frequency: a
// smoothing spline (Reinsch 1967), with limits.
//
// The rotation row's Jacobian: R = rest R_x, and R_x becomes exp(w) R_x, so R_ref' R becomes
// R_ref' R exp(R_x' w) and its logarithm d changes by Jr^-1(d) R_x' w. All the other rows are those
// of effectors (effector_problem.cpp): contacts and points are effectors that are added to the rig.
#include "validation/clip_problem.h"

#include <algorithm>
#include <cmath>

namespace limber {
namespace {

using Eigen::Vector3d;

/// A vertical line is where a standing point may be: its height is the effectors' business.
RigEffector standing_effector(const StandingPoint& point, double weight) {
  RigEffector effector;
  effector.joint = point.joint;
  effector.offset = point.offset;
  effector.kind = EffectorKind::line;
  effector.axis = Vector3d::UnitY();
  effector.weight_pos = weight;
  effector.weight_rot = 0.0;
  return effector;
}

RigEffector point_effector(std::int32_t joint, const Vector3d& offset, double weight) {
  RigEffector effector;
  effector.joint = joint;
  effector.offset = offset;
  effector.kind = EffectorKind::position;
  effector.weight_pos = weight;
  return effector;
}

bool has_place(EffectorKind kind) {
  return kind == EffectorKind::pose || kind == EffectorKind::position;
}

bool turns(const RigJoint& joint) { return joint.type != JointType::fixed; }

void model_pose(const Rig& rig, std::span<const DualQuaternion> local,
                std::vector<DualQuaternion>& world) {
  world.resize(local.size());
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    const std::int32_t parent = rig.joints[i].parent;
    world[i] = parent == kNoJoint ? local[i] : world[parent] * local[i];
  }
}

}  // namespace

ClipProblem::ClipProblem(const Rig& rig, const ClipGoals& goals, const ClipWeights& weights,
                         const Clip& clip)
    : rig_(rig),
      reference_(goals.reference),
      standing_(goals.standing),
      frames_(clip.frames()),
      smooth_(std::pow(weights.smooth_s * goals.rate_hz, 2)),
      turn_radius_(weights.turn_radius) {
  std::vector<std::uint8_t> carries(rig.joints.size(), 0);
  for (const RigEffector& effector : rig.effectors) {
    for (std::int32_t i = effector.joint; i != kNoJoint; i = rig.joints[i].parent) carries[i] = 1;
  }
  const std::vector<std::int32_t> begin = dof_begin(rig);
  moves_.assign(static_cast<std::size_t>(begin.back()), 0);
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    if (carries[i] == 0 || !turns(rig.joints[i])) continue;
    turning_.push_back(i);
    std::fill(moves_.begin() + begin[i], moves_.begin() + begin[i + 1], 1);
  }
  effector_rows_ = EffectorProblem(rig_, {}).residuals();
  add_points(goals, weights);
  place_targets(goals, clip);
}

/// Contacts first, then what is smoothed: the places of strong effectors.
void ClipProblem::add_points(const ClipGoals& goals, const ClipWeights& weights) {
  const std::vector<RigEffector> effectors = rig_.effectors;
  for (const StandingPoint& point : goals.standing) {
    rig_.effectors.push_back(standing_effector(point, weights.contact));
  }
  const Eigen::Index with_contacts = EffectorProblem(rig_, {}).residuals();
  contact_rows_ = with_contacts - effector_rows_;
  for (const RigEffector& effector : effectors) {
    if (!effector.strong || effector.relative_to != kNoJoint) continue;
    const bool placed = has_place(effector.kind);
    rig_.effectors.push_back(
        point_effector(effector.joint, placed ? effector.offset : Vector3d::Zero(), smooth_));
  }
  point_rows_ = EffectorProblem(rig_, {}).residuals() - with_contacts;
}

std::vector<Vector3d> ClipProblem::standing_places(const StandingPoint& point,
                                                   const Clip& clip) const {
  std::vector<Vector3d> places;
  std::vector<DualQuaternion> world;
  for (const FrameInterval& contact : point.contacts) {
    Vector3d sum = Vector3d::Zero();
    for (std::int64_t f = contact.begin; f < contact.end; ++f) {
      model_pose(rig_, clip.frame(f), world);
      sum += world[point.joint].transform_point(point.offset);
    }
    places.push_back(sum / static_cast<double>(contact.end - contact.begin));
  }
  return places;
}

void ClipProblem::place_targets(const ClipGoals& goals, const Clip& clip) {
  const std::size_t all = rig_.effectors.size();
  const std::size_t given = goals.targets.size() / static_cast<std::size_t>(frames_);
  const std::size_t points = given + standing_.size();
  targets_.resize(static_cast<std::size_t>(frames_) * all);
  std::vector<DualQuaternion> world;
  for (std::int64_t f = 0; f < frames_; ++f) {
    EffectorTarget* row = targets_.data() + f * std::int64_t(all);
    std::copy_n(goals.targets.begin() + f * std::int64_t(given), given, row);
    for (std::size_t e = given; e < points; ++e) row[e].weight = 0.0;
    model_pose(rig_, reference_.subspan(std::size_t(f) * rig_.joints.size(), rig_.joints.size()),
               world);
    for (std::size_t e = points; e < all; ++e) {
      const RigEffector& point = rig_.effectors[e];
      row[e].pose =
          DualQuaternion::from_translation(world[point.joint].transform_point(point.offset));
    }
  }
  for (std::size_t s = 0; s < standing_.size(); ++s) {
    const std::vector<Vector3d> places = standing_places(standing_[s], clip);
    for (std::size_t c = 0; c < places.size(); ++c) {
      const FrameInterval& contact = standing_[s].contacts[c];
      for (std::int64_t f = contact.begin; f < contact.end; ++f) {
        targets_[std::size_t(f) * all + given + s] = {DualQuaternion::from_translation(places[c]),
                                                      1.0};
      }
    }
  }
}

EffectorProblem ClipProblem::frame(std::int64_t frame,
                                   std::span<const DualQuaternion> parent_from_joint) const {
  const std::size_t all = rig_.effectors.size();
  EffectorProblem problem(rig_, std::span(targets_).subspan(std::size_t(frame) * all, all));
  problem.chart().start_from(parent_from_joint);
  return problem;
}

void ClipProblem::evaluate(const EffectorProblem& problem, std::int64_t frame,
                           const Eigen::VectorXd& x, bool with_jacobian, Rows& rows) const {
  Eigen::VectorXd all;
  Eigen::MatrixXd all_by_x;
  problem.evaluate(x, all, with_jacobian ? &all_by_x : nullptr);
  // Effectors, contacts, points, couplings.
  const Eigen::Index before = effector_rows_ - static_cast<Eigen::Index>(rig_.couplings.size());
  const Eigen::Index first = before + contact_rows_;
  const Eigen::Index couplings = all.size() - first - point_rows_;
  rows.pull.resize(first + couplings);
  rows.pull << all.head(first), all.tail(couplings);
  rows.motion.resize(point_rows_ + 3 * static_cast<Eigen::Index>(turning_.size()));
  rows.motion.head(point_rows_) = all.segment(first, point_rows_);
  if (with_jacobian) {
    rows.pull_by_x.resize(rows.pull.size(), x.size());
    rows.pull_by_x << all_by_x.topRows(first), all_by_x.bottomRows(couplings);
    rows.motion_by_x.setZero(rows.motion.size(), x.size());
    rows.motion_by_x.topRows(point_rows_) = all_by_x.middleRows(first, point_rows_);
  }
  turn_rows(problem.chart(), frame, x, with_jacobian, rows);
}

void ClipProblem::turn_rows(const PoseChart& chart, std::int64_t frame, const Eigen::VectorXd& x,
                            bool with_jacobian, Rows& rows) const {
  const double weight = smooth_ * turn_radius_;
  Eigen::Index row = point_rows_;
  for (const std::int32_t i : turning_) {
    Eigen::Quaterniond r;
    Eigen::Matrix3d columns;
    const int count =
        chart.rotation(i, x.data() + chart.begin()[i], r, with_jacobian ? &columns : nullptr);
    const Eigen::Quaterniond wanted =
        reference_[std::size_t(frame) * rig_.joints.size() + std::size_t(i)].rotation();
    const Vector3d d = rotation_log(wanted.conjugate() * rig_.joints[i].rest * r);
    rows.motion.segment<3>(row) = weight * d;
    if (with_jacobian) {
      rows.motion_by_x.block(row, chart.begin()[i + 1] - count, 3, count) =
          weight * inverse_right_jacobian(d) * r.toRotationMatrix().transpose() *
          columns.leftCols(count);
    }
    row += 3;
  }
}

ClipCost ClipProblem::cost(const Clip& clip) const {
  ClipCost cost;
  Eigen::VectorXd before, last;
  for (std::int64_t f = 0; f < frames_; ++f) {
    const EffectorProblem problem = frame(f, clip.frame(f));
    Rows rows;
    evaluate(problem, f, problem.chart().x(), false, rows);
    const Eigen::Index effectors =
        effector_rows_ - static_cast<Eigen::Index>(rig_.couplings.size());
    const double contacts = rows.pull.segment(effectors, contact_rows_).squaredNorm();
    cost.contacts += contacts;
    cost.effectors += rows.pull.squaredNorm() - contacts;
    if (f > 1) cost.smoothness += (before - 2.0 * last + rows.motion).squaredNorm();
    before = std::move(last);
    last = std::move(rows.motion);
  }
  return cost;
}

}  // namespace limber
