#pragma once

#include <Eigen/Core>

#include "tests/bench/peers/coordinate_peer.h"
#include "tests/bench/peers/limited_step.h"

namespace limber::peers {

/// Minimises 1/2 |r|^2 with a quadratic model per iteration, steps within limits and damping that
/// grows where a step fails. What the methods differ in is the model.
class SecondOrder : public Method {
 public:
  SecondOrder(Task& task, double damping_gain);
  int solve(State&) override;

 protected:
  /// H and J'r at the state that the task was last evaluated at.
  virtual void model(const State&, Eigen::MatrixXd& h, Eigen::VectorXd& g) = 0;
  /// A step was taken; the task is evaluated at its end.
  virtual void moved(const State& /*from*/, const State& /*to*/) {}

  Task& task_;

 private:
  double damping_gain_;
  LimitedStep limited_;
  Eigen::MatrixXd h_;
  Eigen::VectorXd g_;
  State trial_;
};

/// Damped least squares, H = J'J: Levenberg-Marquardt.
class LeastSquares : public SecondOrder {
 public:
  /// How J'J is put together: from each effector's chain, or as one dense product.
  enum class Assembly { chains, dense };
  explicit LeastSquares(Task& task, Assembly assembly = Assembly::chains)
      : SecondOrder(task, 1.0), assembly_(assembly) {}

 protected:
  void model(const State&, Eigen::MatrixXd& h, Eigen::VectorXd& g) override;

 private:
  Assembly assembly_;
  Eigen::MatrixXd jacobian_;
};

/// Newton: the true Hessian, by differences of the analytic gradient.
class Newton : public SecondOrder {
 public:
  explicit Newton(Task& task) : SecondOrder(task, 1.0) {}

 protected:
  void model(const State&, Eigen::MatrixXd& h, Eigen::VectorXd& g) override;

 private:
  State nearby_;
  Eigen::VectorXd shift_, there_;
};

/// Broyden's class: BFGS, its Hessian kept from frame to frame while it serves.
class Bfgs : public SecondOrder {
 public:
  explicit Bfgs(Task& task) : SecondOrder(task, 0.0) {}
  int solve(State&) override;

 protected:
  void model(const State&, Eigen::MatrixXd& h, Eigen::VectorXd& g) override;
  void moved(const State& from, const State& to) override;

 private:
  Eigen::MatrixXd b_;          // the approximate Hessian; empty before the first frame
  Eigen::VectorXd g_, after_;  // J'r before and after the last step
};

}  // namespace limber::peers
