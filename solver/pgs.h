#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>

#include "solver/swing_twist.h"

namespace limber {

/// Two neighbouring coordinates whose end must lie in an ellipse.
struct EllipseLimit {
  std::int32_t coordinate = 0;  ///< and the next one
  SwingEllipse swing{};
};

/// min 1/2 x'Ax - b'x with at + x within [min, max] and the ellipses; A symmetric, its diagonal
/// positive. Coordinates under an ellipse have an infinite box.
struct LimitedProblem {
  const Eigen::MatrixXd& a;
  const Eigen::VectorXd& b;
  const Eigen::VectorXd& at;
  const Eigen::VectorXd& min;
  const Eigen::VectorXd& max;
  std::span<const EllipseLimit> ellipses;  ///< by coordinate
};

struct PgsOptions {
  int max_sweeps = 3;
  double tolerance = 0.0;   ///< stop where the last sweep changed no coordinate by more
  double relaxation = 1.0;  ///< 1: Gauss-Seidel
};

struct PgsStats {
  int sweeps = 0;
  double change = 0.0;  ///< largest change in the last sweep
};

/// Projected Gauss-Seidel in fixed order. x: warm start in, solution out. Ends within limits.
PgsStats solve_pgs(const LimitedProblem&, Eigen::Ref<Eigen::VectorXd> x, const PgsOptions& = {});

/// |x - P(x - diag^-1 (Ax - b))|_inf: zero exactly at the solution. `gradient` = Ax - b.
double projected_residual(const Eigen::Ref<const Eigen::VectorXd>& end,
                          const Eigen::Ref<const Eigen::VectorXd>& gradient,
                          const Eigen::Ref<const Eigen::VectorXd>& diagonal,
                          const Eigen::VectorXd& min, const Eigen::VectorXd& max,
                          std::span<const EllipseLimit> ellipses);

}  // namespace limber
