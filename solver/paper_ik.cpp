// Kenwright 2013, equation by equation.
//
// Joints hold exponential maps w (eqs. 7, 16), here by JointChart. Forward kinematics multiplies
// unit dual quaternions, each a translation and a rotation (eqs. 13, 15), from the root:
//   e = f(w)                                                                       (18)
// Six rows per effector. With de = J dw (eqs. 19, 20) a step is sought by
//   A x = b,  A = J'J + delta 1,  b = J' de,  de = e_target - e_current,  x = dw   (23, 28-30)
// delta = 1e-4. (The paper's eq. 26 has the opposite sign of eq. 23 for the same difference; with
// it every step would lead away. Eq. 23 stands.) Rotations have no difference: the rotation vector
// of target current* stands for it, and J's rotation rows are the joint's world axes, its
// derivative to first order. The column of J for one coordinate follows from the joint's twist as
// a dual vector, carried to the world by the parent's dual quaternion: an effector at r turns by
// its real part and moves by dual + real x r. (Figure 8, which derives it, is a picture that the
// paper's text lacks.) Metres and radians are weighed against each other by the effectors' weights,
// which scale the rows of J and de alike.
//
// Gauss-Seidel (algorithm 1) updates x_i by (b_i - sum_j A_ij x_j) / A_ii, and every update is
// clamped, w + x into the limits of swing and twist (eq. 31; pgs.cpp). Then
//   w <- w + x                                                                     (25)
// and an exponential map beyond pi is replaced by (1 - 2 pi / |w|) w (section VII.A.2).
//
// Sweeps start at x = 0. The warm start (section VIII) is w itself, the last frame's solution: the
// pose that is passed in.
//
// The four rules that stop (section VII.B), for one sweep per relinearisation:
//  1. the iterations reach their limit;
//  2. |Ax - b| is small. On a new linear problem x = 0 and this is J' de; where a limit holds, what
//     is left after projecting, |w - P(w + diag^-1 b)|. An acceptable answer, every strong effector
//     within its tolerance, counts as well (section IX);
//  3. the step |x| is small;
//  4. the step is as large as the one before: a pose that swings to and fro.
// Nothing bounds a step's length, so the cost may rise on the way; the best pose met is returned.
#include "solver/paper_ik.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "solver/effector_rows.h"
#include "solver/swing_twist.h"

namespace limber {

namespace {

constexpr double kSameStep = 1e-6;   // relative; slow convergence changes its steps by more
constexpr double kRounding = 1e-12;  // relative; a rise of the cost by that much is none

}  // namespace

PaperIk::PaperIk(const Rig& rig, const IkOptions& options)
    : rig_(rig),
      options_(options),
      skeleton_(skeleton_of(rig)),
      goals_(rig.effectors.size()),
      errors_(rig.effectors.size()),
      local_(rig.joints.size()),
      world_(rig.joints.size()) {
  std::vector<char> felt(rig.joints.size(), 0);
  for (const RigEffector& effector : rig.effectors) {
    effectors_.push_back(make_effector(effector, effector.joint, DualQuaternion::identity()));
    for (std::int32_t j = effector.joint; j >= 0; j = rig.joints[j].parent) felt[j] = 1;
  }
  std::vector<std::int32_t> first(rig.joints.size(), 0);
  std::int32_t count = 0;
  for (std::int32_t j = 0; j < rig.size(); ++j) {
    first[j] = count;
    const JointChart chart(rig.joints[j]);
    if (!felt[j] || chart.size() == 0) continue;
    joints_.push_back({j, count, chart});
    add_limits(joints_.back());
    count += chart.size();
  }
  for (const RigEffector& effector : rig.effectors) {
    std::vector<std::int32_t>& chain = chains_.emplace_back();
    for (std::int32_t j = effector.joint; j >= 0; j = rig.joints[j].parent) {
      for (int i = 0; i < dof_count(rig.joints[j].type); ++i) chain.push_back(first[j] + i);
    }
    std::sort(chain.begin(), chain.end());
  }
  const auto rows = static_cast<Eigen::Index>(6 * rig.effectors.size());
  twists_.resize(static_cast<std::size_t>(count));
  w_ = at_ = best_ = step_ = end_ = b_ = gradient_ = diagonal_ = Eigen::VectorXd::Zero(count);
  error_ = Eigen::VectorXd::Zero(rows);
  jacobian_ = Eigen::MatrixXd::Zero(rows, count);
  a_ = Eigen::MatrixXd::Zero(count, count);
}

void PaperIk::add_limits(const MovingJoint& m) {
  min_.conservativeResize(m.first + m.chart.size());
  max_.conservativeResize(m.first + m.chart.size());
  for (int i = 0; i < m.chart.size(); ++i) {
    min_[m.first + i] = m.chart.range(i).min;
    max_[m.first + i] = m.chart.range(i).max;
  }
  if (m.chart.has_ellipse()) ellipses_.push_back({m.first, m.chart.swing()});
}

void PaperIk::load(std::span<const EffectorTarget> targets, std::span<DualQuaternion> pose) {
  for (std::size_t e = 0; e < goals_.size(); ++e) goals_[e] = make_goal(effectors_[e], targets[e]);
  project_into_limits(rig_, pose);
  std::copy(pose.begin(), pose.end(), local_.begin());
  for (const MovingJoint& m : joints_) m.chart.coordinates(pose[m.joint], of(m));
  at_ = w_;
  step_.setZero();
  move();  // rounding may have left coordinates a hair outside
  evaluate();
}

/// Forward kinematics (eqs. 13, 15), the errors (eq. 23) and their cost.
void PaperIk::evaluate() {
  for (const MovingJoint& m : joints_) local_[m.joint] = m.chart.parent_from_joint(of(m));
  model_from_local(skeleton_, local_, world_);
  cost_ = 0.0;
  for (std::size_t e = 0; e < effectors_.size(); ++e) {
    const DualQuaternion& joint = world_[rig_.effectors[e].joint];
    measure_error(effectors_[e], goals_[e], joint.rotation(),
                  joint.transform_point(effectors_[e].offset), errors_[e]);
    cost_ += goals_[e].mass * errors_[e].position.squaredNorm();
    cost_ += goals_[e].inertia * errors_[e].rotation.squaredNorm();
  }
}

/// J and de (eqs. 20, 23), rows weighted.
void PaperIk::differentiate() {
  for (const MovingJoint& m : joints_) {
    const auto twists = std::span(twists_).subspan(m.first, m.chart.size());
    m.chart.twists(of(m), twists);
    const std::int32_t parent = rig_.joints[m.joint].parent;
    if (parent < 0) continue;
    for (DualVector& twist : twists) twist = world_[parent].transform_line(twist);
  }
  for (std::size_t e = 0; e < effectors_.size(); ++e) {
    const IkEffector& effector = effectors_[e];
    const IkError& error = errors_[e];
    const double wp = std::sqrt(goals_[e].mass);
    const double wr = std::sqrt(turning_weight(effector, goals_[e], error));
    const auto row = static_cast<Eigen::Index>(6 * e);
    error_.segment<3>(row) = wp * error.position;
    error_.segment<3>(row + 3) = wr * error.rotation;
    for (const std::int32_t k : chains_[e]) {
      const Eigen::Vector3d turn = twists_[k].real, move = twists_[k].velocity_at(error.point);
      jacobian_.block<3, 1>(row, k) = wp * seen_move(effector, goals_[e], move);
      jacobian_.block<3, 1>(row + 3, k) = wr * seen_turn(effector, error, turn, move);
    }
  }
}

/// A = J'J + delta 1 and b = J'de (eqs. 28-30), effector by effector: a column of J is zero where
/// its joint is not on the way to the effector.
void PaperIk::multiply() {
  a_.setZero();
  b_.setZero();
  for (std::size_t e = 0; e < effectors_.size(); ++e) {
    const auto row = static_cast<Eigen::Index>(6 * e);
    for (const std::int32_t k : chains_[e]) {
      const Eigen::Matrix<double, 6, 1> column = jacobian_.block<6, 1>(row, k);
      b_[k] += column.dot(error_.segment<6>(row));
      for (const std::int32_t l : chains_[e]) {
        if (l > k) break;
        a_(l, k) += column.dot(jacobian_.block<6, 1>(row, l));
      }
    }
  }
  a_.triangularView<Eigen::StrictlyLower>() = a_.transpose();
  a_.diagonal().array() += options_.damping;
}

/// w = at + step (eq. 25), within limits, exponential maps shifted.
void PaperIk::move() {
  w_ = (at_ + step_).cwiseMax(min_).cwiseMin(max_);
  for (const EllipseLimit& e : ellipses_) {
    w_.segment<2>(e.coordinate) = e.swing.project(Eigen::Vector2d(w_.segment<2>(e.coordinate)));
  }
  for (const MovingJoint& m : joints_) m.chart.shift(of(m));
}

bool PaperIk::acceptable() const {
  if (cost_ <= options_.stop_cost) return true;
  return options_.stop_at_tolerance && within_tolerance();
}

bool PaperIk::within_tolerance() const {
  for (std::size_t e = 0; e < goals_.size(); ++e) {
    if (!effectors_[e].strong) continue;
    const bool off = goals_[e].mass > 0.0 && errors_[e].position.norm() > options_.stop_position_m;
    const bool turned =
        goals_[e].inertia > 0.0 && errors_[e].rotation.norm() > options_.stop_orientation_rad;
    if (off || turned) return false;
  }
  return true;
}

/// Of the linear problem at the step: zero where no coordinate would be updated.
double PaperIk::residual() {
  gradient_.noalias() = a_ * step_;
  gradient_ -= b_;
  diagonal_ = a_.diagonal();
  end_ = at_ + step_;
  return projected_residual(end_, gradient_, diagonal_, min_, max_, ellipses_);
}

void PaperIk::keep_best() {
  if (cost_ > best_cost_ * (1.0 + kRounding)) return;
  best_ = w_;
  best_cost_ = std::min(best_cost_, cost_);
}

void PaperIk::set_up_linear_problem() {
  differentiate();
  multiply();
  at_ = w_;
  step_.setZero();
}

void PaperIk::linearise(std::span<const EffectorTarget> targets, std::span<DualQuaternion> pose) {
  load(targets, pose);
  set_up_linear_problem();
}

/// The rules 2 to 4 end it, or the iterations do (1).
void PaperIk::descend(IkReport& report) {
  best_cost_ = std::numeric_limits<double>::infinity();
  keep_best();
  double last_change = 0.0;
  report.converged = acceptable() || joints_.empty();
  while (!report.converged && report.relinearisations < options_.max_relinearisations) {
    ++report.relinearisations;
    set_up_linear_problem();
    report.residual = residual();
    if (report.residual <= options_.stop_step) report.converged = true;
    if (report.converged) break;
    const PgsStats swept = solve_pgs(problem(), step_,
                                     {.max_sweeps = options_.sweeps,
                                      .tolerance = options_.stop_step,
                                      .relaxation = options_.relaxation});
    report.sweeps += swept.sweeps;
    report.residual = residual();
    move();
    evaluate();
    keep_best();
    const double change = step_.cwiseAbs().maxCoeff();
    const bool same = std::abs(change - last_change) <= kSameStep * change;
    report.converged = acceptable() || change <= options_.stop_step || same;
    last_change = change;
  }
}

IkReport PaperIk::solve(std::span<const EffectorTarget> targets, std::span<DualQuaternion> pose) {
  IkReport report;
  load(targets, pose);
  descend(report);
  if (report.sweeps > 0) {  // else what is inside its limits stays bit for bit
    std::swap(w_, best_);
    evaluate();
    for (const MovingJoint& m : joints_) pose[m.joint] = local_[m.joint];
  }
  report.cost = cost_;
  report.reached = within_tolerance();
  return report;
}

}  // namespace limber
