#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "tests/bench/peers/coordinates.h"

namespace limber::peers {

/// Velocity of an effector (linear, angular; world space) per coordinate of its chain, 6 x chain.
using ChainJacobian = Eigen::Matrix<double, 6, Eigen::Dynamic>;

/// Where effectors are and how they move. Nothing of Limber's solver is in it.
class Kinematics {
 public:
  explicit Kinematics(const Coordinates&);
  virtual ~Kinematics() = default;

  /// Forward kinematics.
  virtual void set(const State&) = 0;
  virtual Eigen::Vector3d position(std::size_t effector) const = 0;
  virtual Eigen::Quaterniond rotation(std::size_t effector) const = 0;
  /// To be called once after `set`, before the first `jacobian`.
  virtual void prepare_jacobian(const State&) = 0;
  /// Columns in the order of chain(effector).
  virtual void jacobian(std::size_t effector, ChainJacobian&) = 0;

  const Coordinates& coordinates() const { return coordinates_; }
  /// The coordinates that move an effector, ascending; its joints from the root on.
  const std::vector<Eigen::Index>& chain(std::size_t effector) const { return chains_[effector]; }
  const std::vector<std::int32_t>& joints(std::size_t effector) const { return joints_[effector]; }

 protected:
  const Coordinates& coordinates_;

 private:
  std::vector<std::vector<Eigen::Index>> chains_;
  std::vector<std::vector<std::int32_t>> joints_;
};

/// Straight from the definition: a rotation and an origin per joint, an axis per coordinate.
class PlainKinematics : public Kinematics {
 public:
  explicit PlainKinematics(const Coordinates&);
  void set(const State&) override;
  Eigen::Vector3d position(std::size_t effector) const override;
  Eigen::Quaterniond rotation(std::size_t effector) const override;
  void prepare_jacobian(const State&) override;
  void jacobian(std::size_t effector, ChainJacobian&) override;

  const Eigen::Quaterniond& joint_rotation(std::int32_t joint) const { return rotation_[joint]; }
  const Eigen::Vector3d& joint_origin(std::int32_t joint) const { return origin_[joint]; }

 private:
  std::vector<Eigen::Quaterniond> rotation_;  // [joint] world from joint
  std::vector<Eigen::Vector3d> origin_;       // [joint] in world space
  Eigen::Matrix3Xd axis_;                     // [dof] in world space; a translation's direction
};

/// MuJoCo's kinematics of the same rig: universal joints as two hinges, balls and the root as its
/// own ball and free joints, effectors as sites. Null where the program was built without MuJoCo.
std::unique_ptr<Kinematics> mujoco_kinematics(const Coordinates&);
bool has_mujoco();

}  // namespace limber::peers
