#pragma once

#include <Eigen/Core>
#include <Eigen/SVD>
#include <cstdint>
#include <span>
#include <vector>

#include "assets/model/result.h"
#include "assets/model/rig.h"
#include "assets/model/screw.h"

namespace limber {

struct ResolvedRateOptions {
  double step_s = 1e-3;    ///< dt
  double feedback = 1000;  ///< k1, 1/s: how fast errors are taken back; see feedback_bound
  /// k0 of the damped pseudo-inverse J'(J J' + k0)^-1, in the square of J's unit (m^2 for points).
  /// 0: the pseudo-inverse, which is exact and grows without bound towards singular poses.
  double damping = 0.0;
  double rank_tolerance = 1e-9;  ///< a singular value counts above this part of the largest
};

struct ResolvedRateReport {
  int rank = 0;              ///< of the task's rows
  double point_error = 0.0;  ///< m, before the step; the largest of all effectors
  double line_error = 0.0;   ///< |n - n'| (rad for small ones), likewise
};

/// Makes an arm follow moving points and lines by its joints' velocities: the controller of
/// Leclercq, Lefevre & Blohm 2013 (sections 3.2.2 and 3.3.2, appendices G and H). Knows no limits.
///
/// Tasks are the rig's effectors, of kind `position` (3 rows: a point) or `line` (6 rows, Pluecker,
/// rank 4 at most: the line through offset along axis); their weights are not used. A tool takes
/// one of each. Joint velocities are the rig's coordinates' (dof_begin): hinge and universal rad/s
/// about their axes; ball rad/s about the joint's own x, y, z; free m/s in the parent's space, then
/// as ball. For limits, see ik_solver.h.
class ResolvedRate {
 public:
  /// Error `solver-options`: an effector of another kind, a step that is not positive, a feedback
  /// or damping below zero.
  static Result<ResolvedRate> create(const Rig&, const ResolvedRateOptions& = {});

  /// Errors shrink by the factor 1 - feedback dt per step, so that they die out only below this
  /// (1/s, appendix G.6). It is not enforced: at the bound the arm just swings.
  static double feedback_bound(double step_s) { return 2.0 / step_s; }

  /// One step of dt. `targets`: one per effector, where it should be now and how it should move, as
  /// EffectorTarget has it. `wish` (rad/s, m/s; empty: none): joint velocities to take as far as
  /// the task leaves them open. Pose now in, pose dt later out. Allocates nothing.
  ResolvedRateReport step(std::span<const MovingTransform> targets,
                          std::span<DualQuaternion> parent_from_joint,
                          std::span<const double> wish = {});

  /// Of the last step: the task's rows against the coordinates, and the joint velocities taken.
  const Eigen::MatrixXd& jacobian() const { return jacobian_; }
  const Eigen::VectorXd& velocity() const { return velocity_; }

 private:
  ResolvedRate(const Rig&, const ResolvedRateOptions&, Eigen::Index rows);
  void place_axes(std::span<const DualQuaternion> parent_from_joint);
  void fill_rows(std::span<const MovingTransform> targets, ResolvedRateReport&);
  int solve(std::span<const double> wish);
  void advance(std::span<DualQuaternion> parent_from_joint) const;

  Rig rig_;
  ResolvedRateOptions options_;
  Skeleton skeleton_;
  std::vector<std::int32_t> begin_;            // [joint] first coordinate
  std::vector<DualQuaternion> world_;          // [joint]
  std::vector<DualVector> axis_;               // [coordinate] twist of its unit velocity, world
  Eigen::MatrixXd jacobian_;                   // [row, coordinate]
  Eigen::VectorXd wanted_, along_, velocity_;  // [row], [singular value], [coordinate]
  Eigen::JacobiSVD<Eigen::MatrixXd> svd_;
};

}  // namespace limber
