// Projected Gauss-Seidel (Kenwright 2013, algorithm 1 with eq. 31).
//
// One coordinate: x_i <- clamp(x_i + (b - A x)_i / A_ii), the exact minimum along it within its
// range. A swing is bounded by an ellipse over two coordinates. Where the plain updates of both
// stay inside they stand; where they leave, clamping them one by one would stop at points that are
// no minimum. Then both move together along the block's gradient g by 1 / L and are projected,
// L >= the block's largest eigenvalue: (g, L) majorises the objective, so the step descends and
// rests only at the block's limited minimum. Every update lowers the objective; with A positive
// definite the sweeps converge to the one solution, whose test is projected_residual = 0.
#include "solver/pgs.h"

#include <algorithm>
#include <cmath>

namespace limber {

namespace {

double largest_eigenvalue(double a00, double a01, double a11) {
  return 0.5 * (a00 + a11) + std::hypot(0.5 * (a00 - a11), a01);
}

/// Returns the larger of the two changes.
double update_swing(const LimitedProblem& p, const EllipseLimit& limit,
                    Eigen::Ref<Eigen::VectorXd> x, double relaxation) {
  const std::int32_t i = limit.coordinate;
  const double a00 = p.a(i, i), a01 = p.a(i, i + 1), a11 = p.a(i + 1, i + 1);
  const Eigen::Vector2d g(p.a.col(i).dot(x) - p.b[i], p.a.col(i + 1).dot(x) - p.b[i + 1]);
  const Eigen::Vector2d at(p.at[i], p.at[i + 1]), old(x[i], x[i + 1]);
  Eigen::Vector2d next;
  next.x() = old.x() - relaxation * g.x() / a00;
  next.y() = old.y() - relaxation * (g.y() + a01 * (next.x() - old.x())) / a11;
  if (limit.swing.level(at + next) > 1.0) {
    const double l = largest_eigenvalue(a00, a01, a11);
    next = limit.swing.project(at + old - g / l) - at;
  }
  x[i] = next.x();
  x[i + 1] = next.y();
  return (next - old).cwiseAbs().maxCoeff();
}

}  // namespace

PgsStats solve_pgs(const LimitedProblem& p, Eigen::Ref<Eigen::VectorXd> x,
                   const PgsOptions& options) {
  PgsStats stats;
  while (stats.sweeps < options.max_sweeps) {
    ++stats.sweeps;
    stats.change = 0.0;
    auto ellipse = p.ellipses.begin();
    for (Eigen::Index i = 0; i < x.size(); ++i) {
      if (ellipse != p.ellipses.end() && ellipse->coordinate == i) {
        stats.change = std::max(stats.change, update_swing(p, *ellipse, x, options.relaxation));
        ++ellipse;
        ++i;
        continue;
      }
      const double old = x[i];
      const double free = old + options.relaxation * (p.b[i] - p.a.col(i).dot(x)) / p.a(i, i);
      x[i] = std::clamp(free, p.min[i] - p.at[i], p.max[i] - p.at[i]);
      stats.change = std::max(stats.change, std::abs(x[i] - old));
    }
    if (stats.change <= options.tolerance) break;
  }
  return stats;
}

double projected_residual(const Eigen::Ref<const Eigen::VectorXd>& end,
                          const Eigen::Ref<const Eigen::VectorXd>& gradient,
                          const Eigen::Ref<const Eigen::VectorXd>& diagonal,
                          const Eigen::VectorXd& min, const Eigen::VectorXd& max,
                          std::span<const EllipseLimit> ellipses) {
  double residual = 0.0;
  auto ellipse = ellipses.begin();
  for (Eigen::Index i = 0; i < end.size(); ++i) {
    if (ellipse != ellipses.end() && ellipse->coordinate == i) {
      // One scale for both coordinates: the projection is Euclidean.
      const double scale = std::max(diagonal[i], diagonal[i + 1]);
      const Eigen::Vector2d at(end[i], end[i + 1]), g(gradient[i], gradient[i + 1]);
      const Eigen::Vector2d d = at - ellipse->swing.project(at - g / scale);
      residual = std::max(residual, d.cwiseAbs().maxCoeff());
      ++ellipse;
      ++i;
      continue;
    }
    const double next = std::clamp(end[i] - gradient[i] / diagonal[i], min[i], max[i]);
    residual = std::max(residual, std::abs(end[i] - next));
  }
  return residual;
}

}  // namespace limber
