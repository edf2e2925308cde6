#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "assets/model/result.h"
#include "assets/model/rig.h"

namespace limber {

/// What one effector is pulled to, in world space, or in that of the joint the effector is relative
/// to. `weight` scales the effector's own weights for this frame (0: absent). For a line, `pose`
/// carries the effector's offset and axis; a gaze looks at its translation.
struct EffectorTarget {
  DualQuaternion pose;
  double weight = 1.0;
};

/// Two points that are to stay apart along a direction: normal . (a - b) >= least.
struct Separation {
  std::int32_t joint_a = 0, joint_b = 0;
  Eigen::Vector3d point_a, point_b;  ///< in their joints' spaces, m
  Eigen::Vector3d normal;            ///< unit, world space
  double least = 0.0;                ///< m
};

enum class IkMethod : std::uint8_t {
  pgs,        ///< tree elimination as preconditioner, locked limits, projected Gauss-Seidel rows
  pgs_paper,  ///< Kenwright 2013: damped normal equations, plain projected Gauss-Seidel sweeps
};

struct IkOptions {
  IkMethod method = IkMethod::pgs;
  double stop_position_m = 1e-4;  ///< every strong effector below both: done
  double stop_orientation_rad = 8.7266e-4;
  /// true: done as soon as the strong effectors are within tolerance. false: go on until the cost
  /// stops falling, so that weak effectors have their say (retargeting).
  bool stop_at_tolerance = true;
  double stop_step = 1e-7;           ///< largest coordinate step (rad, m) that still counts
  double stop_cost_decrease = 1e-6;  ///< relative fall of the cost per step that still counts
  double stop_cost = 1e-14;          ///< below it (m^2) there is nothing left to gain
  int max_relinearisations = 60;
  /// pgs_paper: per relinearisation. One is the paper's iteration; 0.1 mm needs three.
  int sweeps = 1;
  double relaxation = 1.0;  ///< pgs_paper: of the sweeps, within (0, 2); 1: Gauss-Seidel
  double damping = 1e-4;    ///< D; rotations (rad); translations: damping / l^2 with l = 1 m
  /// pgs: where the start ends out of tolerance, try again from a third, two thirds and all of the
  /// way to the middle of the ranges; an answer is kept if it gets there. A clip whose targets
  /// leave much open can wind itself into a corner of its limits; leaving it shows as a jump.
  bool unwind = false;
  /// pgs: other starts to try, always the same ones, where the first ends out of tolerance. For
  /// poses that stand alone; in a clip they would pop.
  int restarts = 0;
  /// follow: start where the last two answers point to, else at the last one.
  bool extrapolate = true;
  /// Fill IkReport::residual. It measures an answer and is no part of finding it.
  bool measure_residual = true;
  /// pgs: keep the rig's capsules apart (see collision_pairs), within 1e-5 m where it can be done.
  bool collision = false;
  /// pgs: how many Separations a frame may have at most, see IkSolver::keep_apart. They may name
  /// joints that carry effectors, those above them, and those of collision_pairs(rig).
  int separations = 0;
  /// s between frames: what joints' max_speed needs. 0: speeds are not limited.
  double dt = 0.0;
};

struct IkReport {
  int relinearisations = 0;
  int tree_passes = 0;
  int sweeps = 0;
  double residual = 0.0;   ///< |x - P(x - diag^-1 (Ax - b))|_inf of the last linear problem
  double cost = 0.0;       ///< sum (wp |dp|)^2 + (0.1 wr |dtheta|)^2
  bool converged = false;  ///< stopped by tolerance, step or cost, not by the iteration cap
  /// follow: by how much the largest second difference (m) of a joint's or effector's place exceeds
  /// that of the targets. 0 until there are two answers before.
  double bend = 0.0;
  bool reached = false;  ///< every strong effector is within the stop tolerances
  /// Couplings, capsules, speeds and priorities: by how much (m, rad) the worst one is missed.
  double row_violation = 0.0;
  int active_rows = 0;  ///< contacts and speeds that press
};

/// Joint-limited inverse kinematics for one rig. Not thread-safe; one instance per thread.
class IkSolver {
 public:
  /// Errors: `rig-invalid`; `solver-options`, also for pgs_paper with what it has no rows for:
  /// relative effectors, priorities, couplings, collision, speeds.
  static Result<IkSolver> create(const Rig&, const IkOptions& = {});
  IkSolver(IkSolver&&) noexcept;
  IkSolver& operator=(IkSolver&&) noexcept;
  ~IkSolver();

  /// Moves the pose (start in, solution out) towards the targets, one per rig effector. Every
  /// limited joint ends within its limits (1e-5 degrees). Unreachable targets get the best pose
  /// found. Allocates nothing.
  IkReport solve(std::span<const EffectorTarget> targets,
                 std::span<DualQuaternion> parent_from_joint);
  /// The same; `previous` is the pose of the frame before, from which speeds count (without it they
  /// count from the start).
  IkReport solve(std::span<const EffectorTarget> targets,
                 std::span<DualQuaternion> parent_from_joint,
                 std::span<const DualQuaternion> previous);
  /// Rows start from the multipliers that the solve before ended with, as the frames of a clip do
  /// best. This forgets them: call it where a clip begins, so that its answer is its own.
  void forget();

  /// Points that stay apart, within 1e-5 m where it can be done, from the next solve on; at most
  /// IkOptions::separations.
  void keep_apart(std::span<const Separation>);

  /// The next frame of a clip: as solve(), but starts from the answers to the calls before, keeps
  /// their active limits and damping, and what the targets leave open goes on calmly. Whatever
  /// `parent_from_joint` holds is overwritten. Without a call before it starts from the rest pose.
  IkReport follow(std::span<const EffectorTarget> targets,
                  std::span<DualQuaternion> parent_from_joint);
  /// Makes follow() go on as if these were the answers before; the same twice: from rest there.
  void resume(std::span<const DualQuaternion> before, std::span<const DualQuaternion> last);

 private:
  struct State;
  explicit IkSolver(std::unique_ptr<State>);
  std::unique_ptr<State> state_;
};

/// Effector cost of a pose, as IkReport::cost.
double effector_cost(const Rig&, std::span<const EffectorTarget>,
                     std::span<const DualQuaternion> parent_from_joint);

}  // namespace limber
