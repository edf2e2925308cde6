#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "solver/capsule_contacts.h"
#include "solver/ik_solver.h"
#include "solver/ik_tree.h"
#include "solver/row.h"

namespace limber {

/// The rows at one place of the coordinates, and what they say of it.
struct RowPlace {
  std::vector<Row> rows;  ///< by ascending id
  double cost = 0.0;      ///< soft rows: sum of value^2 / compliance, m^2, as IkReport::cost
  double excess = 0.0;    ///< hard rows: sum of the violations beyond tolerance
  double worst = 0.0;     ///< hard rows: largest violation / tolerance; at most 1: all are kept
  bool reached = true;    ///< every strong relative effector is within the stop tolerances
};

/// What joins branches of a rig's tree, as rows: relative effectors (soft), couplings, effectors of
/// higher priority held where they are, speeds that no box can bound, capsules (hard).
class IkRows {
 public:
  IkRows(const Rig&, const IkTree&, const IkOptions&);

  /// The rig and the options ask for no rows and one level only.
  bool none() const { return none_; }
  /// At most this many rows at once, kMaxContacts contacts among them.
  std::size_t capacity() const { return capacity_; }
  RowPlace make_place() const;
  /// Distinct priorities, strongest first.
  std::span<const std::int32_t> levels() const { return levels_; }

  /// Goals for one level. Effectors of weaker levels are absent; relative ones become rows; those
  /// of stronger levels are held where `here` (evaluated) has them, a gaze with its target where it
  /// stands in the eye.
  void aim(std::span<const EffectorTarget>, std::int32_t level, const IkKinematics& here,
           std::span<IkGoal> goals);
  /// Goals for all levels at once, nothing held: for measuring.
  void aim_at_all(std::span<const EffectorTarget>, std::span<IkGoal> goals);
  /// See IkSolver::keep_apart.
  void keep_apart(std::span<const Separation> apart) {
    separations_.assign(apart.begin(), apart.end());
  }
  /// Speeds count from `previous`.
  void set_previous(const IkState& previous) { previous_ = previous; }

  /// Rows of an evaluated place. Allocates nothing.
  void build(const IkState&, const IkKinematics&, RowPlace&);
  /// Takes the rows' wrenches about kinematics.origin.
  void anchor(const IkKinematics&, RowPlace&) const;

  static constexpr std::size_t kMaxContacts = 512;

 private:
  /// An effector that is not the tree's alone.
  struct Link {
    bool soft = false, held = false;
    std::int32_t base_node = -1;  ///< of relative_to, -1: the world
    Eigen::Quaterniond base_rotation = Eigen::Quaterniond::Identity();
    Eigen::Vector3d base_position = Eigen::Vector3d::Zero();  ///< node_from_base
    IkGoal goal;                                              ///< in the base's space
    Eigen::Vector3d axis = Eigen::Vector3d::UnitX();          ///< held: in the effector's space
  };
  struct CoupledPair {
    Row::Term from, to;
    double ratio = 1.0, offset = 0.0;
  };
  struct SpeedTerm {
    Row::Term term;
    double reach = 0.0;
    bool turn = false;  ///< a rotation without limits, its component `coordinate - first`
    std::int32_t first = 0;
  };

  void hold(std::size_t effector, const IkKinematics&, IkGoal& goal);
  void add_link(std::size_t effector, const IkKinematics&, RowPlace&) const;
  void add_speeds(const IkState&, RowPlace&) const;
  void add_contacts(const IkKinematics&, RowPlace&);
  void add_separations(const IkKinematics&, RowPlace&) const;
  void judge(RowPlace&) const;

  const IkTree& tree_;
  double stop_position_m_, stop_orientation_rad_;
  bool none_ = true;
  std::size_t capacity_ = 0;
  std::vector<std::int32_t> levels_;
  std::vector<std::int32_t> priority_;  ///< [effector]
  std::vector<Link> links_;             ///< [effector]
  std::vector<CoupledPair> couplings_;
  std::vector<SpeedTerm> speeds_;
  IkState previous_;
  bool collision_ = false;
  CapsuleContacts capsules_;
  std::vector<Separation> separations_;
  std::vector<CapsuleContact> contacts_;
};

}  // namespace limber
