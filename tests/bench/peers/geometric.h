#pragma once

#include <Eigen/Core>
#include <vector>

#include "tests/bench/peers/coordinate_peer.h"

namespace limber::peers {

/// Turns one joint so that directions r meet wanted directions d best, within its limits: the best
/// turn maximises trace(T' B), B = sum w d r'. `parent_rest` is the joint's world rotation at q =
/// 0. Returns T, in world space, after limits.
Eigen::Matrix3d turn_joint(const Coordinates&, std::int32_t joint,
                           const Eigen::Matrix3d& parent_rest, const Eigen::Matrix3d& b, State&);

/// Cyclic coordinate descent (Wang & Chen 1991) for trees: joint by joint from the leaves to the
/// root, each turned to the best fit of all effectors below it, positions and rotations at their
/// weights; balls by the closed form of Wahba's problem, a free root by that of Procrustes.
class Ccd : public Method {
 public:
  explicit Ccd(Task&);
  int solve(State&) override;

 private:
  void sweep(State&);
  Eigen::Matrix3d fit(std::int32_t joint, const Eigen::Vector3d& pivot,
                      const Eigen::Vector3d& wanted_pivot) const;
  void move_below(std::int32_t joint, const Eigen::Vector3d& pivot, const Eigen::Matrix3d& turn,
                  const Eigen::Vector3d& shift);
  void place_root(State&);

  Task& task_;
  PlainKinematics kinematics_;
  std::vector<std::vector<std::size_t>> below_;  // [joint] effectors
  std::vector<Eigen::Vector3d> position_;        // [effector] as the sweep goes on
  std::vector<Eigen::Matrix3d> rotation_;
  State best_;
};

/// FABRIK for trees (Aristidou & Lasenby 2011): wanted origins from the effectors inwards, averaged
/// where branches meet; then from the root outwards, each joint turned towards its children's
/// wanted origins within its limits. Orientations go inwards as Aristidou et al. 2016 have it, and
/// settle only what the positions leave open, so that orientation targets are met by luck.
class Fabrik : public Method {
 public:
  explicit Fabrik(Task&);
  int solve(State&) override;

 private:
  void inwards(const State&);
  void outwards(State&);
  void ask(std::int32_t joint, const Eigen::Vector3d& origin, double weight);
  void ask_parent(std::int32_t joint, const State&);
  Eigen::Matrix3d fit(std::int32_t joint, const State&) const;

  Task& task_;
  PlainKinematics kinematics_;
  std::vector<std::vector<std::int32_t>> children_;  // [joint]
  std::vector<std::vector<std::size_t>> effectors_;  // [joint] those it carries
  std::vector<Eigen::Vector3d> origin_, placed_;     // [joint] wanted, and as they come to be
  std::vector<Eigen::Matrix3d> rotation_, turned_;   // [joint] the same
  std::vector<double> weight_;                       // [joint] of what is wanted; 0: nothing
  State best_;
};

}  // namespace limber::peers
