#include "validation/ceres_refiner.h"

#include <ceres/ceres.h>

#include <algorithm>
#include <string>
#include <vector>

#include "validation/effector_problem.h"
#include "validation/limit_check.h"

namespace limber {
namespace {

constexpr double kOnBound = 1e-12;      // rad: this near, a coordinate is on its bound
constexpr double kSlope = 1e-13;        // gradient below which a bound neither holds nor lets go
constexpr double kInsideLimits = 1e-7;  // rad: a start this far inside counts as allowed

/// The coordinates that are free in one round, as Ceres sees them.
class FreeCoordinates : public ceres::CostFunction {
 public:
  FreeCoordinates(const EffectorProblem& problem, std::vector<int> free)
      : problem_(problem), free_(std::move(free)), x_(problem.chart().x()) {
    set_num_residuals(static_cast<int>(problem.residuals()));
    mutable_parameter_block_sizes()->push_back(static_cast<int>(free_.size()));
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    for (std::size_t k = 0; k < free_.size(); ++k) x_[free_[k]] = parameters[0][k];
    const bool wants_jacobian = jacobians != nullptr && jacobians[0] != nullptr;
    problem_.evaluate(x_, residual_, wants_jacobian ? &jacobian_ : nullptr);
    Eigen::VectorXd::Map(residuals, residual_.size()) = residual_;
    if (wants_jacobian) {
      using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
      Eigen::Map<RowMajor> out(jacobians[0], residual_.size(), free_.size());
      for (std::size_t k = 0; k < free_.size(); ++k) out.col(k) = jacobian_.col(free_[k]);
    }
    return residual_.allFinite();
  }

 private:
  const EffectorProblem& problem_;
  std::vector<int> free_;
  mutable Eigen::VectorXd x_, residual_;  // one thread
  mutable Eigen::MatrixXd jacobian_;
};

/// Ends a round when the cost is low enough, or when a coordinate has met a bound, so that the next
/// round can hold it there: Ceres's steps do not know which bounds are active, and creep along
/// them.
class StopAtNewBound : public ceres::IterationCallback {
 public:
  StopAtNewBound(const std::vector<double>& x, const std::vector<double>& lower,
                 const std::vector<double>& upper, double enough_cost)
      : x_(x), lower_(lower), upper_(upper), enough_cost_(enough_cost) {}

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override {
    if (summary.iteration == 0 || !summary.step_is_successful) return ceres::SOLVER_CONTINUE;
    if (2.0 * summary.cost <= enough_cost_) return ceres::SOLVER_TERMINATE_SUCCESSFULLY;
    for (std::size_t k = 0; k < x_.size(); ++k) {
      if (x_[k] <= lower_[k] + kOnBound || x_[k] >= upper_[k] - kOnBound) {
        return ceres::SOLVER_TERMINATE_SUCCESSFULLY;
      }
    }
    return ceres::SOLVER_CONTINUE;
  }

 private:
  const std::vector<double>&x_, &lower_, &upper_;
  double enough_cost_;
};

/// Coordinates that no bound holds: strictly inside, or pulled inwards by the gradient.
std::vector<int> free_coordinates(const EffectorProblem& problem) {
  Eigen::VectorXd residual;
  Eigen::MatrixXd jacobian;
  problem.evaluate(problem.chart().x(), residual, &jacobian);
  const Eigen::VectorXd gradient = jacobian.transpose() * residual;
  std::vector<int> free;
  for (int k = 0; k < gradient.size(); ++k) {
    const double x = problem.chart().x()[k], low = problem.chart().lower()[k],
                 high = problem.chart().upper()[k];
    const bool locked = high - low <= 2.0 * kOnBound;
    const bool held_low = x <= low + kOnBound && gradient[k] > -kSlope;
    const bool held_high = x >= high - kOnBound && gradient[k] < kSlope;
    if (!locked && !held_low && !held_high) free.push_back(k);
  }
  return free;
}

struct Round {
  int iterations = 0;
  double cost = 0.0;
  bool usable = false;
};

Round minimise(EffectorProblem& problem, const std::vector<int>& free, int max_iterations,
               double enough_cost) {
  std::vector<double> x, lower, upper;
  for (const int k : free) {
    x.push_back(problem.chart().x()[k]);
    lower.push_back(problem.chart().lower()[k]);
    upper.push_back(problem.chart().upper()[k]);
  }
  ceres::Problem ceres_problem;
  ceres_problem.AddResidualBlock(new FreeCoordinates(problem, free), nullptr, x.data());
  for (std::size_t k = 0; k < x.size(); ++k) {
    const int index = static_cast<int>(k);
    if (std::isfinite(lower[k])) ceres_problem.SetParameterLowerBound(x.data(), index, lower[k]);
    if (std::isfinite(upper[k])) ceres_problem.SetParameterUpperBound(x.data(), index, upper[k]);
  }
  StopAtNewBound stop(x, lower, upper, enough_cost);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
  options.logging_type = ceres::SILENT;
  options.num_threads = 1;
  options.max_num_iterations = max_iterations;
  options.function_tolerance = 1e-12;
  options.gradient_tolerance = 1e-14;
  options.parameter_tolerance = 1e-12;
  options.update_state_every_iteration = true;
  options.callbacks.push_back(&stop);
  ceres::Solver::Summary summary;
  ceres::Solve(options, &ceres_problem, &summary);

  Round round;
  round.usable = summary.IsSolutionUsable();
  round.iterations = static_cast<int>(summary.iterations.size()) - 1;
  if (!round.usable) return round;
  Eigen::VectorXd moved = problem.chart().x();
  for (std::size_t k = 0; k < free.size(); ++k) {
    moved[free[k]] = std::clamp(x[k], lower[k], upper[k]);
  }
  problem.chart().set_x(moved);
  round.cost = problem.cost(moved);
  return round;
}

Error bad_input(std::string message) {
  return {.code = "refine-input",
          .message = std::move(message),
          .hint = "give one target per rig effector and one transform per rig joint"};
}

bool within_limits(const Rig& rig, std::span<const DualQuaternion> parent_from_joint) {
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    if (limit_excess(rig.joints[i], parent_from_joint[i].rotation()) > kInsideLimits) return false;
  }
  return true;
}

}  // namespace

Result<RefineReport> refine_with_ceres(const Rig& rig, std::span<const EffectorTarget> targets,
                                       std::span<DualQuaternion> parent_from_joint,
                                       const RefineOptions& options) {
  if (targets.size() != rig.effectors.size()) return bad_input("targets and effectors differ");
  if (parent_from_joint.size() != rig.joints.size()) return bad_input("pose and rig differ");
  if (const char* lacking = EffectorProblem::lacks(rig)) {
    return Error{.code = "refine-rows",
                 .message = std::string("the refiner's objective has no ") + lacking,
                 .hint = "this rig can be solved but not measured against Ceres"};
  }
  EffectorProblem problem(rig, targets);
  RefineReport report;
  report.cost_before = problem.cost_of_pose(parent_from_joint);
  if (!std::isfinite(report.cost_before)) return bad_input("a pose or a target is not finite");
  problem.chart().start_from(parent_from_joint);

  double cost = problem.cost(problem.chart().x());
  // Couplings count too, where there are any: Ceres starts from what it would have to beat.
  const double to_beat = rig.couplings.empty() ? report.cost_before : cost;
  while (report.iterations < options.max_iterations && cost > options.enough_cost) {
    problem.chart().rechart();
    const std::vector<int> free = free_coordinates(problem);
    if (free.empty()) break;
    const Round round =
        minimise(problem, free, options.max_iterations - report.iterations, options.enough_cost);
    report.iterations += round.iterations;
    if (!round.usable || !(round.cost < cost * (1.0 - 1e-12))) break;
    cost = round.cost;
  }

  if (cost < to_beat || !within_limits(rig, parent_from_joint)) {
    problem.chart().pose(problem.chart().x(), parent_from_joint);
    report.cost_after = rig.couplings.empty() ? cost : problem.cost_of_pose(parent_from_joint);
  } else {
    report.cost_after = report.cost_before;
  }
  if (report.cost_before > options.stop_cost) {
    report.gap_percent = 100.0 * (report.cost_before - report.cost_after) /
                         std::max(report.cost_after, options.stop_cost);
  }
  return report;
}

}  // namespace limber
