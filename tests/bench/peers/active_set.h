#pragma once

#include <Eigen/Core>
#include <vector>

#include "tests/bench/peers/coordinate_peer.h"

namespace limber::peers {

/// Damped least squares within limits, as robotics does it: Levenberg-Marquardt steps, each the
/// solution of a quadratic problem whose active limits are found by locking and releasing.
class ActiveSetDls : public Method {
 public:
  /// How J'J is put together: from each effector's chain, or as one dense product.
  enum class Assembly { chains, dense };
  explicit ActiveSetDls(Task&, Assembly = Assembly::chains);
  /// Moves the state until the task is reached or nothing more is gained; returns linearisations.
  int solve(State&) override;

 private:
  void assemble(const State&);
  void limited_step(const State&, double damping);
  void lock_active(const State&);
  void solve_free();
  bool lock_violated(const State&);
  bool release();
  void turn_basis(std::size_t swing, const Eigen::Vector2d& normal);
  void lock(Eigen::Index dof, double displacement, int side);

  Task& task_;
  Assembly assembly_;
  const Coordinates& coordinates_;
  Eigen::MatrixXd jacobian_;    // dense assembly only
  Eigen::MatrixXd h_, factor_;  // damped J'J; its free part, factored in place
  Eigen::VectorXd g_, step_, right_, multiplier_;
  std::vector<int> side_;               // [dof] 0 free, -1 or 1: locked at its lower or upper limit
  std::vector<Eigen::Index> free_;      // dofs that are not locked
  std::vector<Eigen::Vector2d> basis_;  // [swing] its first axis in (swing0, swing1)
  State trial_;
};

}  // namespace limber::peers
