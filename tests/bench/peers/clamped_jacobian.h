#pragma once

#include <Eigen/Core>

#include "tests/bench/peers/coordinate_peer.h"

namespace limber::peers {

/// The classic Jacobian methods (Buss 2004): a step from J and r, then every joint clamped into its
/// limits. They know nothing of limits while they choose the step.
class ClampedJacobian : public Method {
 public:
  explicit ClampedJacobian(Task& task, int max_iterations)
      : task_(task), max_iterations_(max_iterations) {}
  int solve(State&) override;

 protected:
  virtual void choose_step(const Eigen::MatrixXd& j, const Eigen::VectorXd& r,
                           Eigen::VectorXd& step) = 0;
  Task& task_;

 private:
  int max_iterations_;
  Eigen::MatrixXd jacobian_;
  Eigen::VectorXd step_;
  State best_;
};

/// step = alpha J'r, alpha = <r, JJ'r> / |JJ'r|^2 (Buss 2004, eq. 5).
class JacobianTranspose : public ClampedJacobian {
 public:
  explicit JacobianTranspose(Task& task) : ClampedJacobian(task, 1000) {}

 protected:
  void choose_step(const Eigen::MatrixXd& j, const Eigen::VectorXd& r,
                   Eigen::VectorXd& step) override;
  Eigen::VectorXd jjtr_;
};

/// step = (J'J + lambda^2)^-1 J'r, or its twin in residual space where that is smaller.
class ClampedDls : public ClampedJacobian {
 public:
  explicit ClampedDls(Task& task) : ClampedJacobian(task, 100) {}

 protected:
  void choose_step(const Eigen::MatrixXd& j, const Eigen::VectorXd& r,
                   Eigen::VectorXd& step) override;
  Eigen::MatrixXd normal_;
};

/// Pseudo-inverse by singular values, damped only where they are small (numerical filtering,
/// Maciejewski & Klein 1988).
class SvdDls : public ClampedJacobian {
 public:
  explicit SvdDls(Task& task) : ClampedJacobian(task, 100) {}

 protected:
  void choose_step(const Eigen::MatrixXd& j, const Eigen::VectorXd& r,
                   Eigen::VectorXd& step) override;
};

/// Selectively damped least squares (Buss & Kim 2005).
class Sdls : public ClampedJacobian {
 public:
  explicit Sdls(Task& task) : ClampedJacobian(task, 100) {}

 protected:
  void choose_step(const Eigen::MatrixXd& j, const Eigen::VectorXd& r,
                   Eigen::VectorXd& step) override;
  Eigen::MatrixXd reach_;  // [block of three rows][dof] |dp/dq|
};

}  // namespace limber::peers
