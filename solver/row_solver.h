#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "solver/row.h"
#include "solver/tree_elimination.h"

namespace limber {

/// min 1/2 l'Gl + r'l with low <= l <= high; G symmetric, positive definite. By Gauss-Seidel
/// sweeps, projected, and between them the exact minimum over the l that no bound holds
/// (M. Silcowitz, S. Niebe, K. Erleben, VRIPHYS 2010: PGS with subspace minimisation).
class DualPgs {
 public:
  explicit DualPgs(std::size_t capacity);
  /// l: warm start in, solution out. Returns the sweeps. Until |l - P(l - diag^-1 (G l + r))| is at
  /// most `tolerance` times the largest of |l| and |r / diag|.
  int solve(const Eigen::Ref<const Eigen::MatrixXd>& g, const Eigen::Ref<const Eigen::VectorXd>& r,
            const Eigen::Ref<const Eigen::VectorXd>& low,
            const Eigen::Ref<const Eigen::VectorXd>& high, Eigen::Ref<Eigen::VectorXd> l,
            double tolerance = 1e-12);

 private:
  Eigen::MatrixXd factor_;
  Eigen::VectorXd part_;
  std::vector<std::int32_t> free_;
};

struct RowStats {
  EliminationStats tree;  ///< settled: limits and rows are
  int sweeps = 0;
  int rounds = 0;
  int active = 0;  ///< hard one-sided rows that press
};

/// The tree's limited problem with rows, see row_solver.cpp.
class RowSolver {
 public:
  /// At most `capacity` rows act at once, and no more than kMaxActive.
  RowSolver(const IkTree&, std::size_t capacity);

  /// The step, and every row's lambda (warm start in). Hard rows press with at most `most`, so that
  /// rows that contradict each other or the limits share what cannot be met.
  RowStats solve(TreeElimination&, const Eigen::VectorXd& x, double damping,
                 const Eigen::VectorXd& wish, std::span<Row> rows, double most,
                 Eigen::VectorXd& step);
  const RowPush& push() const { return push_; }

  static constexpr std::size_t kMaxActive = 256;

 private:
  void push_with(std::span<const Row> rows);
  double measure(std::span<const Row> rows, std::span<const Vector6> twist,
                 const Eigen::VectorXd& step, double most);
  void choose(std::span<const Row> rows);
  void couple(TreeElimination&, std::span<const Row> rows, double most, double caution);

  RowPush push_;
  DualPgs pgs_;
  std::vector<std::int32_t> chosen_;  ///< rows that act in this round
  Eigen::VectorXd slack_, way_;       ///< [row]
  Eigen::MatrixXd half_, g_;          ///< coordinates x chosen; chosen x chosen
  Eigen::VectorXd r_, low_, high_, lambda_;
};

}  // namespace limber
