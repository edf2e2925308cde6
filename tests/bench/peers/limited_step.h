#pragma once

#include <Eigen/Core>
#include <vector>

#include "tests/bench/peers/coordinates.h"

namespace limber::peers {

/// The best step within limits of a quadratic model, by an active set. Every second-order peer
/// takes its steps here.
class LimitedStep {
 public:
  explicit LimitedStep(const Coordinates&);

  /// min 1/2 d'Hd - d'g with state + d within limits. Uses up h (both triangles) and g. False where
  /// h is not positive definite.
  bool solve(const State&, Eigen::MatrixXd& h, Eigen::VectorXd& g);
  const Eigen::VectorXd& step() const { return step_; }

 private:
  void lock_active(const State&);
  bool solve_free();
  bool lock_violated(const State&);
  bool release();
  void turn_basis(std::size_t swing, const Eigen::Vector2d& normal);
  void lock(Eigen::Index dof, double displacement, int side);

  const Coordinates& coordinates_;
  Eigen::MatrixXd* h_ = nullptr;
  Eigen::VectorXd* g_ = nullptr;
  Eigen::MatrixXd factor_;  // the free part of H, factored in place
  Eigen::VectorXd step_, right_, multiplier_;
  std::vector<int> side_;               // [dof] 0 free, -1 or 1: locked at its lower or upper limit
  std::vector<Eigen::Index> free_;      // dofs that are not locked
  std::vector<Eigen::Vector2d> basis_;  // [swing] its first axis in (swing0, swing1)
};

}  // namespace limber::peers
