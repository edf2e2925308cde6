#include "pipeline/topology.h"

#include <algorithm>
#include <cmath>

namespace limber {
namespace {

using Eigen::Vector3d;

/// The skeleton as the search sees it: joint positions in the bind pose and who hangs on whom.
struct Tree {
  std::vector<std::int32_t> parents;
  std::vector<std::vector<std::int32_t>> children;
  std::vector<Vector3d> p;
  double height = 0.0;

  bool is_below(std::int32_t ancestor, std::int32_t joint) const {
    for (std::int32_t j = joint; j != kNoJoint; j = parents[j]) {
      if (j == ancestor) return true;
    }
    return false;
  }
  /// From just below `from` down to `to`.
  std::vector<std::int32_t> path(std::int32_t from, std::int32_t to) const {
    std::vector<std::int32_t> out;
    for (std::int32_t j = to; j != from && j != kNoJoint; j = parents[j])
      out.insert(out.begin(), j);
    return out;
  }
  std::int32_t common_ancestor(std::int32_t a, std::int32_t b) const {
    for (std::int32_t j = a; j != kNoJoint; j = parents[j]) {
      if (is_below(j, b)) return j;
    }
    return kNoJoint;
  }
};

Tree read_tree(const Character& character) {
  const Skeleton& skeleton = character.skeleton;
  Tree tree{.parents = skeleton.parents, .children = children_of(skeleton), .p = {}};
  std::vector<DualQuaternion> model(skeleton.parents.size());
  if (character.bind_model_from_joint.empty()) {
    model_from_local(skeleton, skeleton.rest_parent_from_joint, model);
  } else {
    model = character.bind_model_from_joint;
  }
  double low = 1e9, high = -1e9;
  for (std::int32_t j = 0; j < skeleton.size(); ++j) {
    tree.p.push_back(model[j].translation());
    if (!character.deforming[j]) continue;
    low = std::min(low, tree.p[j].y());
    high = std::max(high, tree.p[j].y());
  }
  tree.height = high - low;
  return tree;
}

std::vector<std::int32_t> leaves(const Character& character, const Tree& tree) {
  std::vector<std::int32_t> out;
  for (std::int32_t j = 0; j < character.skeleton.size(); ++j) {
    const bool leaf = std::none_of(tree.children[j].begin(), tree.children[j].end(),
                                   [&](std::int32_t c) { return character.deforming[c] != 0; });
    if (leaf && character.deforming[j]) out.push_back(j);
  }
  return out;
}

struct LimbPair {
  std::int32_t a = kNoJoint, b = kNoJoint, fork = kNoJoint;
};

/// The pair of leaves that mirror each other best among those that `accept` lets through.
template <class Accept>
std::optional<LimbPair> mirrored_pair(const Tree& tree, std::span<const std::int32_t> leaves,
                                      const Accept& accept) {
  std::optional<LimbPair> best;
  double best_score = 0.0;
  for (std::size_t i = 0; i < leaves.size(); ++i) {
    for (std::size_t k = i + 1; k < leaves.size(); ++k) {
      const std::int32_t a = leaves[i], b = leaves[k];
      const std::int32_t fork = tree.common_ancestor(a, b);
      if (fork == kNoJoint || !accept(a, b, fork)) continue;
      const auto path_a = tree.path(fork, a), path_b = tree.path(fork, b);
      if (path_a.size() != path_b.size() || path_a.size() < 3) continue;
      const double apart = (tree.p[a] - tree.p[b]).norm();
      const double uneven =
          std::abs((tree.p[a] - tree.p[fork]).norm() - (tree.p[b] - tree.p[fork]).norm()) +
          std::abs(tree.p[a].y() - tree.p[b].y());
      const double reach = (tree.p[a] - tree.p[fork]).norm() + (tree.p[b] - tree.p[fork]).norm();
      if (uneven > 0.15 * tree.height || apart < 0.02 * tree.height) continue;
      const double score = reach - 4.0 * uneven;
      if (score > best_score) best_score = score, best = LimbPair{a, b, fork};
    }
  }
  return best;
}

/// The two longest bones in a row of a limb's path are its upper and lower half.
std::size_t upper_bone(const Tree& tree, std::span<const std::int32_t> path) {
  std::size_t best = 0;
  double longest = -1.0;
  for (std::size_t i = 0; i + 2 < path.size(); ++i) {
    const double l = std::min((tree.p[path[i + 1]] - tree.p[path[i]]).norm(),
                              (tree.p[path[i + 2]] - tree.p[path[i + 1]]).norm());
    if (l > longest) longest = l, best = i;
  }
  return best;
}

void set_limb(Figure& figure, const Tree& tree, std::int32_t fork, std::int32_t leaf, Side side,
              bool leg) {
  const auto path = tree.path(fork, leaf);
  const std::size_t upper = upper_bone(tree, path);
  const auto set = [&](Role left, std::size_t i) {
    if (i < path.size()) figure.joint[index_of(on_side(left, side))] = path[i];
  };
  if (leg) {
    set(Role::leftUpperLeg, upper);
    set(Role::leftLowerLeg, upper + 1);
    set(Role::leftFoot, upper + 2);
    set(Role::leftToes, upper + 3);
  } else {
    if (upper > 0) set(Role::leftShoulder, upper - 1);
    set(Role::leftUpperArm, upper);
    set(Role::leftLowerArm, upper + 1);
    set(Role::leftHand, upper + 2);
  }
}

}  // namespace

std::optional<Figure> identify_by_topology(const Character& character) {
  const Tree tree = read_tree(character);
  if (!(tree.height > 0.0)) return std::nullopt;
  const auto ends = leaves(character, tree);
  double low = 1e9;
  for (const std::int32_t j : ends) low = std::min(low, tree.p[j].y());
  const auto legs = mirrored_pair(tree, ends, [&](std::int32_t a, std::int32_t b, std::int32_t f) {
    return tree.p[a].y() < low + 0.15 * tree.height && tree.p[b].y() < low + 0.15 * tree.height &&
           tree.p[f].y() > low + 0.25 * tree.height;
  });
  if (!legs) return std::nullopt;
  const auto arms = mirrored_pair(tree, ends, [&](std::int32_t a, std::int32_t b, std::int32_t f) {
    const bool of_a_leg = tree.is_below(tree.path(legs->fork, legs->a)[0], a) ||
                          tree.is_below(tree.path(legs->fork, legs->b)[0], a) ||
                          tree.is_below(tree.path(legs->fork, legs->a)[0], b) ||
                          tree.is_below(tree.path(legs->fork, legs->b)[0], b);
    return !of_a_leg && tree.p[f].y() > tree.p[legs->fork].y() &&
           (tree.p[a] - tree.p[b]).norm() > 0.25 * tree.height;
  });
  if (!arms) return std::nullopt;

  // Left is +X of a figure that faces along its toes; without toes, of one that faces +Z.
  const auto path_a = tree.path(legs->fork, legs->a);
  const std::size_t foot = upper_bone(tree, path_a) + 2;
  Vector3d forward = foot + 1 < path_a.size()
                         ? Vector3d(tree.p[path_a.back()] - tree.p[path_a[foot]])
                         : Vector3d::UnitZ();
  forward.y() = 0.0;
  if (forward.norm() < 0.02 * tree.height) forward = Vector3d::UnitZ();
  const Vector3d left = Vector3d::UnitY().cross(forward).normalized();

  Figure figure;
  figure.convention = "topology";
  figure.joint[index_of(Role::hips)] = legs->fork;
  const auto side_of_end = [&](std::int32_t end, std::int32_t other) {
    return (tree.p[end] - tree.p[other]).dot(left) > 0.0 ? Side::left : Side::right;
  };
  set_limb(figure, tree, legs->fork, legs->a, side_of_end(legs->a, legs->b), true);
  set_limb(figure, tree, legs->fork, legs->b, side_of_end(legs->b, legs->a), true);
  set_limb(figure, tree, arms->fork, arms->a, side_of_end(arms->a, arms->b), false);
  set_limb(figure, tree, arms->fork, arms->b, side_of_end(arms->b, arms->a), false);

  std::int32_t head = kNoJoint;
  for (const std::int32_t j : ends) {
    const auto path = tree.path(arms->fork, j);
    const bool arm =
        std::find(path.begin(), path.end(), tree.path(arms->fork, arms->a)[0]) != path.end() ||
        std::find(path.begin(), path.end(), tree.path(arms->fork, arms->b)[0]) != path.end();
    if (arm || path.empty() || tree.parents[path[0]] != arms->fork) continue;
    if (head == kNoJoint || tree.p[j].y() > tree.p[head].y()) head = j;
  }
  if (head != kNoJoint) figure.joint[index_of(Role::head)] = head;
  return figure;
}

}  // namespace limber
