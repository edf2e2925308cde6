#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "solver/ik_tree.h"

namespace limber {

/// Where two capsules of one space are nearest to each other, m.
struct CapsuleGap {
  double gap = 0.0;            ///< between the surfaces; below 0 they overlap
  Eigen::Vector3d on_a, on_b;  ///< on the capsules' axes
};
CapsuleGap capsule_gap(const Capsule& a, const Capsule& b);

/// Two capsules that are near each other, at one place of their surfaces. World space, metres.
struct CapsuleContact {
  std::int32_t pair = 0;                  ///< of capsules, fixed for a rig
  std::int32_t feature = 0;               ///< which of a pair's contacts, see capsule_contacts.cpp
  std::int32_t node_a = -1, node_b = -1;  ///< -1: on a joint that cannot move
  Eigen::Vector3d point;                  ///< half way between the surfaces
  Eigen::Vector3d normal;                 ///< unit, from b to a
  double gap = 0.0;                       ///< below 0: they overlap by more than allowed
};

/// The capsules of a rig that are to stay apart: those of collision_pairs(rig), but for pairs that
/// never move against each other and pairs that overlap deeply at rest (q = 0), as neighbours in a
/// trunk do. A slight overlap at rest stays allowed, and no more than that.
class CapsuleContacts {
 public:
  CapsuleContacts(const Rig&, const IkTree&);

  std::size_t pair_count() const { return pairs_.size(); }
  /// All contacts with a gap below `sight`, in fixed order, at most out.capacity() of them: nothing
  /// is allocated. Keeps a list of near pairs between calls, which changes the speed alone.
  void find(const IkKinematics&, double sight, std::vector<CapsuleContact>& out);

 private:
  struct Body {
    std::int32_t node = -1;
    Eigen::Vector3d from, to;  ///< in the node's space
    double radius = 0.0;
  };
  struct Group {  ///< the capsules of one joint
    std::int32_t node = -1;
    Eigen::Vector3d centre = Eigen::Vector3d::Zero();  ///< of a sphere around them, node's space
    double radius = 0.0;
  };
  struct Pair {
    std::int32_t a = 0, b = 0;  ///< bodies
    double allowed = 0.0;       ///< gap at least this, <= 0
  };
  struct GroupPair {
    std::int32_t a = 0, b = 0;        ///< groups
    std::int32_t begin = 0, end = 0;  ///< pairs
  };

  void add_pairs(const Rig&, const std::vector<std::int32_t>& first_body,
                 const std::vector<Body>& at_rest);
  void place(const IkKinematics&);
  void gather();
  void measure(std::int32_t pair, double sight, std::vector<CapsuleContact>& out) const;

  std::vector<Body> bodies_;
  std::vector<Group> groups_;  ///< [joint]
  std::vector<Pair> pairs_;
  std::vector<GroupPair> group_pairs_;
  std::vector<std::int32_t> near_;                  ///< group pairs within reach of each other
  std::vector<Eigen::Vector3d> from_, to_;          ///< [body] world
  std::vector<Eigen::Vector3d> centre_, gathered_;  ///< [joint] world; when near_ was made
};

}  // namespace limber
