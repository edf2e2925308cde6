#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "solver/row.h"
#include "solver/tree_elimination.h"

namespace limber {

/// min 1/2 l'Gl + r'l with low <= l <= high; G symmetric, positive definite. Gauss-Seidel sweeps,
/// projected, guess which bounds hold; block principal pivoting settles it exactly (J. Kim, H.
/// Park, SIAM J. Sci. Comput. 33, 2011, after L. F. Portugal, J. J. Judice, L. N. Vicente, Math.
/// Comp. 63, 1994): what left its range goes to its bound, what its bound's gradient pulls inwards
/// is freed, all at once while that helps, else one at a time.
class DualPgs {
 public:
  struct Stats {
    int sweeps = 0, pivots = 0;
    bool settled = false;
  };
  explicit DualPgs(std::size_t capacity);
  /// l: warm start in, solution out.
  Stats solve(const Eigen::Ref<const Eigen::MatrixXd>& g,
              const Eigen::Ref<const Eigen::VectorXd>& r,
              const Eigen::Ref<const Eigen::VectorXd>& low,
              const Eigen::Ref<const Eigen::VectorXd>& high, Eigen::Ref<Eigen::VectorXd> l);

 private:
  enum class At : std::int8_t { low, inside, high };
  bool solve_inside(const Eigen::Ref<const Eigen::MatrixXd>& g,
                    const Eigen::Ref<const Eigen::VectorXd>& r, Eigen::Ref<Eigen::VectorXd> l);
  double inward(const Eigen::Ref<const Eigen::MatrixXd>& g,
                const Eigen::Ref<const Eigen::VectorXd>& r,
                const Eigen::Ref<const Eigen::VectorXd>& l, std::int32_t i) const;
  bool pivot_blocks(const Eigen::Ref<const Eigen::MatrixXd>& g,
                    const Eigen::Ref<const Eigen::VectorXd>& r,
                    const Eigen::Ref<const Eigen::VectorXd>& low,
                    const Eigen::Ref<const Eigen::VectorXd>& high, Eigen::Ref<Eigen::VectorXd> l,
                    int& pivots);
  bool pivot_singly(const Eigen::Ref<const Eigen::MatrixXd>& g,
                    const Eigen::Ref<const Eigen::VectorXd>& r,
                    const Eigen::Ref<const Eigen::VectorXd>& low,
                    const Eigen::Ref<const Eigen::VectorXd>& high, Eigen::Ref<Eigen::VectorXd> l,
                    int& pivots);

  Eigen::MatrixXd factor_;
  Eigen::VectorXd part_, before_;
  std::vector<std::int32_t> inside_;
  double noise_ = 0.0;
  std::vector<At> at_, should_;
};

struct RowStats {
  EliminationStats tree;  ///< settled: limits and rows are
  int sweeps = 0, pivots = 0;
  int rounds = 0;
  int active = 0;  ///< hard one-sided rows that press
};

/// The tree's limited problem with rows, see row_solver.cpp.
class RowSolver {
 public:
  /// For at most `capacity` rows, of which no more than kMaxActive act at once.
  RowSolver(const IkTree&, std::size_t capacity);

  /// min 1/2 d'Hd - g'd + soft rows, x + d within limits, under the hard rows; H and g as
  /// TreeElimination::linearise has them. `step`: the solution; every row's lambda: warm start in,
  /// multiplier out. Hard rows press with at most `most`, so that rows that contradict each other
  /// or the limits share what cannot be met.
  RowStats solve(TreeElimination&, const Eigen::VectorXd& x, double damping,
                 const Eigen::VectorXd& wish, std::span<Row> rows, double most,
                 Eigen::VectorXd& step);
  /// J'lambda of the last solve's rows (not of the limits).
  const RowPush& push() const { return push_; }

  static constexpr std::size_t kMaxActive = 256;

 private:
  void begin(TreeElimination&, const Eigen::VectorXd& x, const Eigen::VectorXd& step,
             std::span<const Row> rows, double most);
  bool extend(TreeElimination&, const Eigen::VectorXd& x, const Eigen::VectorXd& step,
              std::span<const Row> rows, double most);
  bool add_row(TreeElimination&, std::span<const Row> rows, std::size_t i,
               const Eigen::VectorXd& step, double most);
  bool add_wall(TreeElimination&, const Row::Term&, const Row::Term&, double room);
  bool add_side(TreeElimination&, std::int32_t node, std::int32_t coordinate, double side,
                double room);
  bool add_walls(TreeElimination&, const Eigen::VectorXd& x, const Eigen::VectorXd& step);
  bool add(TreeElimination&, Eigen::Index place, const Row&, double slack, double low, double high);

  const IkTree& tree_;
  RowPush push_;
  DualPgs pgs_;
  std::vector<std::int32_t> chosen_;  ///< [acting] row; -1: a range; -2 - node: a tangent
  std::vector<std::uint8_t> acts_;    ///< [row]
  std::vector<std::uint8_t> walled_;  ///< [2 coordinate + (minimum)] it acts
  Eigen::Index count_ = 0;            ///< acting rows and walls
  Eigen::MatrixXd half_, g_;          ///< coordinates x count; count x count
  Eigen::VectorXd r_, low_, high_;    ///< [acting] r: slack without multipliers
  Eigen::VectorXd lambda_, applied_;  ///< [acting]; what the step has of it
  Eigen::VectorXd sum_;               ///< [coordinate]
};

}  // namespace limber
