#include "tests/bench/peers/clamped_jacobian.h"

#include <Eigen/Cholesky>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>

namespace limber::peers {

namespace {

constexpr double kDamping2 = 1e-5;        // lambda^2 of DLS: m^2 per rad^2
constexpr double kSmallSingular = 3e-3;   // m per rad: below it SVD-DLS damps
constexpr double kMaxTurn = 0.25 * M_PI;  // SDLS's gamma_max, rad
constexpr double kZero = 1e-12;
constexpr int kPatience = 20;  // iterations without a better pose

/// Scales v so that none of its entries exceeds `bound`.
void clamp_largest(Eigen::VectorXd& v, double bound) {
  const double largest = v.cwiseAbs().maxCoeff();
  if (largest > bound) v *= bound / largest;
}

}  // namespace

int ClampedJacobian::solve(State& state) {
  task_.evaluate(state);
  best_ = state;
  double best = task_.cost();
  int iterations = 0, since_better = 0;
  while (!task_.reached() && iterations < max_iterations_ && since_better < kPatience) {
    ++iterations;
    task_.dense_jacobian(state, jacobian_);
    choose_step(jacobian_, task_.residual(), step_);
    task_.coordinates().add(step_, state);
    task_.coordinates().clamp(state);
    task_.evaluate(state);
    ++since_better;
    if (task_.reached() || task_.cost() < 0.9999 * best) {
      best = task_.cost();
      best_ = state;
      since_better = 0;
    }
  }
  if (!task_.reached()) {
    state = best_;
    task_.evaluate(state);
  }
  return iterations;
}

void JacobianTranspose::choose_step(const Eigen::MatrixXd& j, const Eigen::VectorXd& r,
                                    Eigen::VectorXd& step) {
  step.noalias() = j.transpose() * r;
  jjtr_.noalias() = j * step;
  const double length2 = jjtr_.squaredNorm();
  step *= length2 > 0.0 ? r.dot(jjtr_) / length2 : 0.0;
}

void ClampedDls::choose_step(const Eigen::MatrixXd& j, const Eigen::VectorXd& r,
                             Eigen::VectorXd& step) {
  const bool tall = j.rows() >= j.cols();
  const Eigen::Index n = std::min(j.rows(), j.cols());
  normal_.setZero(n, n);
  normal_.diagonal().setConstant(kDamping2);
  if (tall) {
    normal_.selfadjointView<Eigen::Lower>().rankUpdate(j.transpose());
    step.noalias() = j.transpose() * r;
    Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>>(normal_).solveInPlace(step);
  } else {
    normal_.selfadjointView<Eigen::Lower>().rankUpdate(j);
    Eigen::VectorXd x = r;
    Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>>(normal_).solveInPlace(x);
    step.noalias() = j.transpose() * x;
  }
}

void SvdDls::choose_step(const Eigen::MatrixXd& j, const Eigen::VectorXd& r,
                         Eigen::VectorXd& step) {
  const Eigen::BDCSVD<Eigen::MatrixXd> svd(j, Eigen::ComputeThinU | Eigen::ComputeThinV);
  Eigen::VectorXd x = svd.matrixU().transpose() * r;
  for (Eigen::Index i = 0; i < x.size(); ++i) {
    const double sigma = svd.singularValues()[i], ratio = sigma / kSmallSingular;
    const double lambda2 =
        ratio < 1.0 ? (1.0 - ratio * ratio) * kSmallSingular * kSmallSingular : 0;
    x[i] *= sigma / (sigma * sigma + lambda2);
  }
  step.noalias() = svd.matrixV() * x;
}

// Per singular value: alpha = u'r, N = sum over effectors of |u there|, M = what a turn by v /
// sigma moves the effectors at most; the turn is clamped to gamma = min(1, N / M) gamma_max. A
// rotation target counts as an effector of its own.
void Sdls::choose_step(const Eigen::MatrixXd& j, const Eigen::VectorXd& r, Eigen::VectorXd& step) {
  const Eigen::Index blocks = j.rows() / 3;
  reach_.resize(blocks, j.cols());
  for (Eigen::Index b = 0; b < blocks; ++b) {
    reach_.row(b) = j.middleRows<3>(3 * b).colwise().norm();
  }
  const Eigen::RowVectorXd reach = reach_.colwise().sum();
  const Eigen::BDCSVD<Eigen::MatrixXd> svd(j, Eigen::ComputeThinU | Eigen::ComputeThinV);
  step.setZero(j.cols());
  for (Eigen::Index i = 0; i < svd.singularValues().size(); ++i) {
    const double sigma = svd.singularValues()[i];
    if (sigma < kZero) break;
    double n = 0.0;
    for (Eigen::Index b = 0; b < blocks; ++b) n += svd.matrixU().col(i).segment<3>(3 * b).norm();
    const double m = reach.dot(svd.matrixV().col(i).cwiseAbs()) / sigma;
    const double alpha = svd.matrixU().col(i).dot(r);
    Eigen::VectorXd turn = alpha / sigma * svd.matrixV().col(i);
    clamp_largest(turn, std::min(1.0, n / m) * kMaxTurn);
    step += turn;
  }
  clamp_largest(step, kMaxTurn);
}

}  // namespace limber::peers
