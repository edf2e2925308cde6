#include "tests/bench/peers/task.h"

namespace limber::peers {

namespace {
constexpr double kRotationArm = 0.1;  // m/rad
}

Task::Task(const Workload& work, Kinematics& kinematics)
    : work_(work), kinematics_(kinematics), targets_(work.targets.front()), rows_{0} {
  for (std::size_t e = 0; e < work.rig.effectors.size(); ++e) {
    const RigEffector& effector = work.rig.effectors[e];
    const bool turns = effector.kind == EffectorKind::pose && effector.weight_rot > 0.0;
    const auto columns = static_cast<Eigen::Index>(kinematics.chain(e).size());
    rows_.push_back(rows_.back() + (turns ? 6 : 3));
    chain_jacobian_.emplace_back(6, columns);
    block_.emplace_back(columns, columns);
  }
  residual_.resize(rows());
}

void Task::evaluate(const State& state) {
  kinematics_.set(state);
  reached_ = true;
  for (std::size_t e = 0; e < targets_.size(); ++e) {
    const RigEffector& effector = work_.rig.effectors[e];
    const double weight = targets_[e].weight;
    const Eigen::Vector3d miss = targets_[e].pose.translation() - kinematics_.position(e);
    residual_.segment<3>(row(e)) = weight * effector.weight_pos * miss;
    if (effector.strong) reached_ &= miss.norm() < work_.stop_pos;
    if (height(e) == 3) continue;
    const Eigen::Vector3d turn = rotation_log(
        Eigen::Quaterniond(targets_[e].pose.rotation() * kinematics_.rotation(e).conjugate()));
    residual_.segment<3>(row(e) + 3) = weight * kRotationArm * effector.weight_rot * turn;
    if (effector.strong) reached_ &= turn.norm() < work_.stop_rot;
  }
}

void Task::weighted_jacobian(std::size_t e, ChainJacobian& jacobian) {
  kinematics_.jacobian(e, jacobian);
  const RigEffector& effector = work_.rig.effectors[e];
  const double weight = targets_[e].weight;
  jacobian.topRows<3>() *= weight * effector.weight_pos;
  jacobian.bottomRows<3>() *= weight * kRotationArm * effector.weight_rot;
}

void Task::dense_jacobian(const State& state, Eigen::MatrixXd& jacobian) {
  kinematics_.prepare_jacobian(state);
  jacobian.setZero(rows(), coordinates().dofs());
  for (std::size_t e = 0; e < targets_.size(); ++e) {
    ChainJacobian& part = chain_jacobian_[e];
    weighted_jacobian(e, part);
    const auto& chain = kinematics_.chain(e);
    for (std::size_t k = 0; k < chain.size(); ++k) {
      jacobian.col(chain[k]).segment(row(e), height(e)) =
          part.col(static_cast<Eigen::Index>(k)).head(height(e));
    }
  }
}

void Task::normal_equations(const State& state, Eigen::MatrixXd& jtj, Eigen::VectorXd& jtr) {
  kinematics_.prepare_jacobian(state);
  jtj.setZero(coordinates().dofs(), coordinates().dofs());
  jtr.setZero(coordinates().dofs());
  for (std::size_t e = 0; e < targets_.size(); ++e) {
    ChainJacobian& part = chain_jacobian_[e];
    weighted_jacobian(e, part);
    Eigen::MatrixXd& block = block_[e];
    if (height(e) == 6) {
      block.noalias() = part.transpose().lazyProduct(part);
    } else {
      block.noalias() = part.topRows<3>().transpose().lazyProduct(part.topRows<3>());
    }
    const auto& chain = kinematics_.chain(e);
    for (std::size_t k = 0; k < chain.size(); ++k) {
      const auto column = static_cast<Eigen::Index>(k);
      jtr[chain[k]] += part.col(column).head(height(e)).dot(residual_.segment(row(e), height(e)));
      double* to = jtj.col(chain[k]).data();
      const double* from = block.col(column).data();
      for (std::size_t j = 0; j < chain.size(); ++j) to[chain[j]] += from[j];
    }
  }
}

void Task::descent(const State& state, Eigen::VectorXd& jtr) {
  kinematics_.prepare_jacobian(state);
  jtr.setZero(coordinates().dofs());
  for (std::size_t e = 0; e < targets_.size(); ++e) {
    ChainJacobian& part = chain_jacobian_[e];
    weighted_jacobian(e, part);
    const auto& chain = kinematics_.chain(e);
    for (std::size_t k = 0; k < chain.size(); ++k) {
      jtr[chain[k]] += part.col(static_cast<Eigen::Index>(k))
                           .head(height(e))
                           .dot(residual_.segment(row(e), height(e)));
    }
  }
}

}  // namespace limber::peers
