#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "solver/ik_tree.h"
#include "solver/jacobian.h"
#include "solver/row.h"

namespace limber {

struct EliminationStats {
  int passes = 0;
  bool settled = false;  ///< no limit wanted to change any more
  bool definite = true;  ///< false: a curved problem has no minimum; the step is void
};

/// min 1/2 d'J'WJ d - d'J'We + damping/2 (d - wish)'D(d - wish) with x + d within limits, by O(n)
/// elimination along the tree for a fixed set of active limits, and a search for that set.
class TreeElimination {
 public:
  explicit TreeElimination(const IkTree&);

  /// Forgets which limits are active: those that x touches count as active to begin with.
  void reset(const Eigen::VectorXd& x);
  /// A new place x: `load` per node (not composite), twists from the kinematics. Swings that were
  /// held at their limit are so at the border's point nearest to x.
  void linearise(const Eigen::VectorXd& x, const IkKinematics&, const EffectorLoad& load);
  /// `step`: the solution. The active set is the start for the next call.
  EliminationStats solve(const Eigen::VectorXd& x, double damping, const Eigen::VectorXd& wish,
                         Eigen::VectorXd& step);
  /// Slides of held swings along their ellipse count as settled that are shorter than this part of
  /// the whole step, or along which the border turns by less than `bend` (rad). 0, the default: the
  /// solution is exact. An outer loop whose steps shrink loses nothing by more: what is left out is
  /// of second order, as is what linearising leaves out.
  void settle_slides_within(double part, double bend) {
    slide_part_ = part;
    slide_bend_ = bend;
  }
  /// After solve(): the step for other pulls with the same factors, undamped; what was held does
  /// not move. A quarter of the work.
  void solve_again(std::span<const Vector6> pull, Eigen::VectorXd& step);
  /// For rows (row_solver.h). The same without limits, in one pass; forgets the active set.
  EliminationStats solve_free(const Eigen::VectorXd& x, double damping, const Eigen::VectorXd& wish,
                              Eigen::VectorXd& step);
  /// After solve_free: half of the response to a row's J. With H = L D L' the elimination's
  /// factors, half = D^-1/2 L^-1 J', so that J_i H^-1 J_j' = half_i . half_j. Costs the tip-to-root
  /// pass along the row's own paths.
  void respond(const Row&, Eigen::Ref<Eigen::VectorXd> half);
  /// The other half: adds L'^-1 D^-1/2 half, how the step answers a push with that half response,
  /// to the step and the node twists.
  void complete(const Eigen::VectorXd& half, Eigen::VectorXd& step);
  /// Twists of the nodes under the last step.
  std::span<const Vector6> node_twist() const { return twist_; }

 private:
  enum class Lock : std::int8_t { none, min, max };
  /// A swing held to the tangent of its ellipse at `point`.
  struct SwingLock {
    bool active = false;
    bool corner = false;  ///< held in both coordinates
    Eigen::Vector2d point = Eigen::Vector2d::Zero(), normal = Eigen::Vector2d::UnitX();
    double curvature = 0.0;
    double press = 0.0;  ///< multiplier, >= 0: how hard the objective pushes outwards
    double slide = 0.0;  ///< the last way along the tangent
    double reach = 1.0;  ///< the longest one allowed
  };
  struct Pivot {
    Vector6 axis, momentum;                             ///< S, U = I S
    double inverse = 0.0, diagonal = 0.0, drive = 0.0;  ///< 1 / D, D, u
    double held = 0.0;                                  ///< the step of a locked one
    double pull = 0.0;                                  ///< extra drive, of the tangent's curvature
    bool locked = false;
  };
  struct Outside {
    SpatialInertia<double> inertia;
    Vector6 bias;
  };

  void prepare_pivots(std::int32_t node, const Eigen::VectorXd& x, double damping);
  void eliminate(std::int32_t node, const Eigen::VectorXd& x, double damping);
  void substitute(Eigen::VectorXd& step);
  bool update_box(std::int32_t node, const Eigen::VectorXd& x, const Eigen::VectorXd& step,
                  bool may_release);
  bool update_swing(std::int32_t node, const Eigen::VectorXd& x, const Eigen::VectorXd& step,
                    bool may_release);
  void hold_swing(SwingLock&, const SwingEllipse&, const Eigen::Vector2d& wish);

  const IkTree& tree_;
  const IkKinematics* kinematics_ = nullptr;
  const EffectorLoad* load_ = nullptr;
  const double* wish_ = nullptr;
  std::vector<Vector6> felt_;        ///< [node] scratch of respond
  std::vector<Lock> lock_;           ///< [coordinate]
  std::vector<SwingLock> swing_;     ///< [node]
  std::vector<Pivot> pivot_;         ///< [coordinate]
  std::vector<Outside> outside_;     ///< [node] what its parent feels
  std::vector<Vector6> twist_;       ///< [node]
  std::vector<double> multiplier_;   ///< [coordinate] gradient of the objective where locked
  std::vector<std::uint8_t> dirty_;  ///< [node]
  bool definite_ = true;
  double slide_part_ = 0.0, slide_bend_ = 0.0, slide_tolerance_ = 0.0;
};

}  // namespace limber
