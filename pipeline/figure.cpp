#include "pipeline/figure.h"

#include <algorithm>
#include <cctype>
#include <optional>

#include "pipeline/conventions.h"
#include "pipeline/topology.h"

namespace limber {
namespace {

constexpr int kBodyRequired = 13;  // of 15: a figure may lack a spine joint or a head
constexpr int kHandRequired = 8;   // finger joints of one hand

bool starts_with_digits_after(std::string& s, std::string_view prefix) {
  if (!s.starts_with(prefix)) return false;
  std::size_t i = prefix.size();
  while (i < s.size() && std::isdigit(static_cast<unsigned char>(s[i]))) ++i;
  if (i >= s.size()) return false;
  s.erase(0, i);
  return true;
}

/// Names as they are compared: no namespace, no well-known prefix, no separators, lower case.
std::string comparable(std::string_view name) {
  if (const std::size_t colon = name.find_last_of(":|");
      colon != std::string_view::npos && colon + 1 < name.size()) {
    name.remove_prefix(colon + 1);
  }
  std::string s;
  for (const char c : name) {
    const auto u = static_cast<unsigned char>(c);
    if (std::isalnum(u))
      s += static_cast<char>(std::tolower(u));
    else if (u >= 0x80)
      s += c;
  }
  if (!starts_with_digits_after(s, "mixamorig")) {
    if (starts_with_digits_after(s, "bip0")) s.insert(0, "bip");
  }
  return s;
}

bool is_ancestor(std::span<const std::int32_t> parents, std::int32_t ancestor, std::int32_t joint) {
  for (std::int32_t j = parents[joint]; j != kNoJoint; j = parents[j]) {
    if (j == ancestor) return true;
  }
  return false;
}

std::optional<Role> nearest_mapped_parent(const Figure& figure, Role role) {
  for (std::optional<Role> p = parent_of(role); p; p = parent_of(*p)) {
    if (figure.has(*p)) return p;
  }
  return std::nullopt;
}

struct Match {
  Figure figure;
  int required = 0, fingers = 0, total = 0, misplaced = 0;
  double share = 0.0;  // of the convention's names that were found
  int score() const { return 10 * required + total - 6 * misplaced; }
};

Match match_convention(const Character& character,
                       const std::multimap<std::string, std::int32_t>& joints_by_name,
                       const Convention& convention) {
  Match m;
  m.figure.convention = convention.name;
  for (const auto& [role, name] : convention.names) {
    const auto [first, last] = joints_by_name.equal_range(comparable(name));
    std::int32_t found = kNoJoint;
    for (auto it = first; it != last; ++it) {
      if (found == kNoJoint || (!character.deforming[found] && character.deforming[it->second])) {
        found = it->second;
      }
    }
    if (found == kNoJoint) continue;
    m.figure.joint[index_of(role)] = found;
    m.required += is_required(role);
    m.fingers += is_finger(role);
    ++m.total;
  }
  m.share = convention.names.empty() ? 0.0 : double(m.total) / double(convention.names.size());
  for (int r = 0; r < kRoleCount; ++r) {
    if (!m.figure.has(role_at(r))) continue;
    const auto parent = nearest_mapped_parent(m.figure, role_at(r));
    if (parent && m.figure.is_body() &&
        !is_ancestor(character.skeleton.parents, m.figure.at(*parent), m.figure.joint[r])) {
      ++m.misplaced;
    }
  }
  return m;
}

/// Side of a lone hand from the rest pose: fingers and thumb bend towards the palm, which is on the
/// side distal x radial of a left hand and on the other of a right hand.
Side side_by_shape(const Character& character, const Figure& as_right) {
  std::vector<DualQuaternion> model(character.skeleton.parents.size());
  model_from_local(character.skeleton, character.skeleton.rest_parent_from_joint, model);
  const auto p = [&](Role left) { return model[as_right.at(mirrored(left))].translation(); };
  const Eigen::Vector3d distal = p(Role::leftMiddleProximal) - p(Role::leftHand);
  const Role last =
      as_right.has(Role::rightLittleProximal) ? Role::leftLittleProximal : Role::leftRingProximal;
  const Eigen::Vector3d normal = distal.cross(p(Role::leftIndexProximal) - p(last)).normalized();
  double bend = 0.0;
  for (int k = index_of(Role::leftThumbMetacarpal); k <= index_of(Role::leftLittleDistal); ++k) {
    if (!as_right.has(mirrored(role_at(k)))) continue;
    bend += normal.dot(p(role_at(k)) - p(Role::leftMiddleProximal));
  }
  return bend > 0.0 ? Side::left : Side::right;
}

void mirror_roles(Figure& figure) {
  for (int r = kFirstLeft; r < kFirstRight; ++r) {
    std::swap(figure.joint[r], figure.joint[index_of(mirrored(role_at(r)))]);
  }
}

std::optional<Figure> identify_by_names(const Character& character) {
  std::multimap<std::string, std::int32_t> joints_by_name;
  for (std::int32_t j = 0; j < character.skeleton.size(); ++j) {
    joints_by_name.emplace(comparable(character.skeleton.names[j]), j);
  }
  Match best;
  bool either_hand = false;
  for (const Convention& convention : conventions()) {
    Match m = match_convention(character, joints_by_name, convention);
    if (m.score() > best.score() || (m.score() == best.score() && m.share > best.share)) {
      best = std::move(m);
      either_hand = convention.either_hand;
    }
  }
  const bool body = best.figure.is_body() && best.required >= kBodyRequired;
  const bool hand = best.figure.is_hand() && best.fingers >= kHandRequired;
  if (!body && !hand) return std::nullopt;
  if (4 * best.misplaced > best.total) return std::nullopt;
  if (hand && either_hand && best.figure.has_fingers(Side::right) &&
      side_by_shape(character, best.figure) == Side::left) {
    mirror_roles(best.figure);
  }
  return best.figure;
}

std::optional<Figure> identify_by_file(const Character& character) {
  Figure figure;
  int required = 0, fingers = 0;
  for (std::int32_t j = 0; j < character.skeleton.size(); ++j) {
    const std::optional<Role> role = role_named(character.roles[j]);
    if (!role) continue;
    figure.joint[index_of(*role)] = j;
    required += is_required(*role);
    fingers += is_finger(*role);
  }
  if (required < kBodyRequired && !(figure.is_hand() && fingers >= kHandRequired)) {
    return std::nullopt;
  }
  figure.convention = "vrm1";
  return figure;
}

/// Hands whose joints are all siblings: each joint hangs on its role's parent; a joint without a
/// role hangs on the finger end it is near (a tip) or on the hand (a metacarpal).
void give_flat_hand_its_chains(const Character& character, Figure& figure) {
  const std::vector<std::int32_t>& own = character.skeleton.parents;
  const auto roles = roles_by_joint(figure, character.skeleton.size());
  for (const Side side : {Side::left, Side::right}) {
    const std::int32_t hand = figure.at(on_side(Role::leftHand, side));
    if (hand == kNoJoint || !figure.has_fingers(side)) continue;
    const std::int32_t knuckle = figure.at(on_side(Role::leftIndexProximal, side));
    const std::int32_t next = figure.at(on_side(Role::leftIndexIntermediate, side));
    if (next == kNoJoint || own[knuckle] != own[hand] || own[next] != own[hand]) continue;
    std::vector<DualQuaternion> model(own.size());
    model_from_local(character.skeleton, character.skeleton.rest_parent_from_joint, model);
    for (std::int32_t j = 0; j < character.skeleton.size(); ++j) {
      if (j == hand || own[j] != own[hand]) continue;
      if (roles[j]) {
        const auto parent = nearest_mapped_parent(figure, *roles[j]);
        figure.parents[j] = parent ? figure.at(*parent) : hand;
        continue;
      }
      std::int32_t nearest = hand;
      double best = 1e9;
      for (std::int32_t k = 0; k < character.skeleton.size(); ++k) {
        if (!roles[k] || own[k] != own[hand]) continue;
        const double d = (model[k].translation() - model[j].translation()).norm();
        if (d < best) best = d, nearest = k;
      }
      const bool at_the_end = roles[nearest] && is_finger(*roles[nearest]) &&
                              name_of(*roles[nearest]).ends_with("Distal");
      figure.parents[j] = at_the_end ? nearest : hand;
    }
  }
}

/// The hips are what carries both thighs and the trunk, whatever joint has the name: legs hang
/// below the hips' first spine joint (3ds Max Biped), or beside the hips (then what carries all).
void find_moving_hips(const Character& character, Figure& figure) {
  if (!figure.is_body()) return;
  const auto& parents = character.skeleton.parents;
  const std::int32_t named = figure.at(Role::hips);
  const auto carries_all = [&](std::int32_t joint) {
    for (const Role limb :
         {Role::rightUpperLeg, Role::leftUpperArm, Role::rightUpperArm, Role::head}) {
      if (figure.has(limb) && !is_ancestor(parents, joint, figure.at(limb))) return false;
    }
    return true;
  };
  std::int32_t hips = parents[figure.at(Role::leftUpperLeg)];
  while (hips != kNoJoint && !carries_all(hips)) hips = parents[hips];
  if (hips == kNoJoint) hips = named;
  figure.joint[index_of(Role::hips)] = hips;
  figure.pelvis = {hips};
  if (!is_ancestor(parents, named, hips)) return;
  while (figure.pelvis.front() != named) {
    figure.pelvis.insert(figure.pelvis.begin(), parents[figure.pelvis.front()]);
  }
}

/// Limb joints that rigs with IK helpers hang elsewhere (feet below the root) get their limb's
/// chain.
void give_limbs_their_chains(Figure& figure) {
  if (!figure.is_body()) return;
  for (int r = kFirstLeft; r < kRoleCount; ++r) {
    const Role role = role_at(r);
    if (is_finger(role) || !figure.has(role)) continue;
    const auto parent = nearest_mapped_parent(figure, role);
    if (!parent || side_of(*parent) == Side::middle) continue;
    const std::int32_t j = figure.at(role), p = figure.at(*parent);
    if (!is_ancestor(figure.parents, p, j) && !is_ancestor(figure.parents, j, p)) {
      figure.parents[j] = p;
    }
  }
}

/// Every joint once, parents before children.
std::vector<std::int32_t> parents_first(std::span<const std::int32_t> parents) {
  std::vector<std::int32_t> order;
  std::vector<std::uint8_t> placed(parents.size(), 0);
  const auto n = static_cast<std::int32_t>(parents.size());
  while (static_cast<std::int32_t>(order.size()) < n) {
    const std::size_t before = order.size();
    for (std::int32_t j = 0; j < n; ++j) {
      if (placed[j] || (parents[j] != kNoJoint && !placed[parents[j]])) continue;
      placed[j] = 1;
      order.push_back(j);
    }
    if (order.size() == before) break;  // a cycle: cannot come from valid input
  }
  return order;
}

std::vector<std::int32_t> path_up(std::span<const std::int32_t> parents, std::int32_t joint) {
  std::vector<std::int32_t> path;
  for (std::int32_t j = joint; j != kNoJoint; j = parents[j]) path.push_back(j);
  return path;
}

/// Spine and neck by structure: the trunk ends where the path to the head leaves the arms. Only a
/// joint that is called neck is one although the arms hang from it (3ds Max Biped).
void find_trunk(const Character& character, Figure& figure) {
  if (!figure.is_body()) return;
  const auto& parents = character.skeleton.parents;
  const std::int32_t hips = figure.at(Role::hips);
  std::int32_t head = figure.at(Role::head);
  if (head == kNoJoint) head = figure.at(Role::neck);
  const auto up_from_head = path_up(parents, head == kNoJoint ? hips : head);
  std::int32_t top = hips;
  for (const std::int32_t j : up_from_head) {
    const bool carries = j == hips || is_ancestor(parents, j, figure.at(Role::leftUpperArm)) ||
                         is_ancestor(parents, j, figure.at(Role::rightUpperArm));
    if (carries) {
      top = j;
      break;
    }
  }
  if (top != hips && top == figure.at(Role::neck) && parents[top] != hips) top = parents[top];
  figure.spine.clear();
  figure.neck.clear();
  bool above = true;
  for (const std::int32_t j : up_from_head) {
    if (j == hips) break;
    if (j == top) above = false;
    if (above && j != head) figure.neck.insert(figure.neck.begin(), j);
    if (!above) figure.spine.insert(figure.spine.begin(), j);
  }
}

/// Spine roles follow the structure: the first is `spine`, the last `upperChest` (three or more) or
/// `chest` (two); a neck role is the neck's first joint.
void name_trunk(Figure& figure) {
  if (!figure.is_body()) return;
  auto set = [&](Role role, std::int32_t j) { figure.joint[index_of(role)] = j; };
  const auto n = figure.spine.size();
  set(Role::spine, n >= 1 ? figure.spine.front() : kNoJoint);
  set(Role::chest, n == 2 ? figure.spine[1] : n >= 3 ? figure.spine[n / 2] : kNoJoint);
  set(Role::upperChest, n >= 3 ? figure.spine.back() : kNoJoint);
  set(Role::neck, figure.neck.empty() ? kNoJoint : figure.neck.front());
}

FigureChain chain_of(const Figure& figure, std::string name, std::span<const Role> roles,
                     int needed) {
  FigureChain chain{.name = std::move(name), .joints = {}};
  for (const Role role : roles) {
    if (figure.has(role)) chain.joints.push_back(figure.at(role));
  }
  const double by_name = figure.convention == "topology" ? 0.75 : 1.0;
  chain.confidence = std::min(1.0, double(chain.joints.size()) / needed) * by_name;
  return chain;
}

void list_chains(Figure& figure) {
  figure.chains.clear();
  double confidence = 1.0;
  const auto add = [&](FigureChain chain, bool required) {
    if (chain.joints.empty() && !required) return;
    if (required) confidence = std::min(confidence, chain.confidence);
    figure.chains.push_back(std::move(chain));
  };
  const double by_name = figure.convention == "topology" ? 0.75 : 1.0;
  if (figure.is_body()) {
    add({"spine", figure.spine, by_name}, false);
    FigureChain neck{"neck", figure.neck, by_name};
    if (figure.has(Role::head)) neck.joints.push_back(figure.at(Role::head));
    add(std::move(neck), false);
  }
  for (const Side side : {Side::left, Side::right}) {
    const std::string prefix = side == Side::left ? "left" : "right";
    const auto roles = [&](std::initializer_list<Role> left) {
      std::vector<Role> out;
      for (const Role r : left) out.push_back(on_side(r, side));
      return out;
    };
    if (figure.is_body()) {
      add(chain_of(figure, prefix + "Leg",
                   roles({Role::leftUpperLeg, Role::leftLowerLeg, Role::leftFoot, Role::leftToes}),
                   3),
          true);
      add(chain_of(
              figure, prefix + "Arm",
              roles({Role::leftShoulder, Role::leftUpperArm, Role::leftLowerArm, Role::leftHand}),
              3),
          true);
    }
    for (int finger = 0; finger < 5; ++finger) {
      static constexpr std::array<const char*, 5> kFingers = {"Thumb", "Index", "Middle", "Ring",
                                                              "Little"};
      std::vector<Role> joints;
      for (int k = 0; k < 3; ++k) {
        joints.push_back(
            on_side(role_at(index_of(Role::leftThumbMetacarpal) + 3 * finger + k), side));
      }
      add(chain_of(figure, prefix + kFingers[finger], joints, 3), false);
    }
  }
  figure.confidence = confidence;
}

Result<void> apply_overrides(const Character& character, const RoleOverrides& overrides,
                             Figure& figure) {
  for (const auto& [role_name, joint_name] : overrides) {
    const std::optional<Role> role = role_named(role_name);
    if (!role) {
      return Error{.code = "map-unknown-role",
                   .message = "'" + role_name + "' is no VRM 1.0 humanoid name",
                   .hint = "use names such as hips, leftUpperArm, rightIndexProximal"};
    }
    const std::int32_t j = joint_name.empty() ? kNoJoint : character.skeleton.find(joint_name);
    if (j == kNoJoint && !joint_name.empty()) {
      return Error{.code = "map-unknown-joint",
                   .message = "the map names a joint that the file does not have",
                   .joint = joint_name,
                   .hint = "list the joints with `limber inspect --json`"};
    }
    figure.joint[index_of(*role)] = j;
  }
  for (int r = 0; r < kRoleCount; ++r) {
    for (int other = 0; other < r && figure.joint[r] != kNoJoint; ++other) {
      if (figure.joint[other] != figure.joint[r]) continue;
      return Error{.code = "map-joint-twice",
                   .message = "one joint cannot be both " + std::string(name_of(role_at(other))) +
                              " and " + std::string(name_of(role_at(r))),
                   .joint = character.skeleton.names[figure.joint[r]],
                   .hint = "give the joint one role in the map file"};
    }
  }
  return {};
}

/// A map that differs from the structure in spine or neck means its own list of joints.
void apply_trunk_overrides(const Character& character, const RoleOverrides& overrides,
                           Figure& figure) {
  // The joint a map gives the role; a joint of the pelvis is none of the trunk's.
  const auto meant = [&](Role role) {
    const auto given = overrides.find(std::string(name_of(role)));
    if (given == overrides.end()) return figure.at(role);
    const std::int32_t j = character.skeleton.find(given->second);
    return std::ranges::count(figure.pelvis, j) != 0 ? figure.at(role) : j;
  };
  const auto listed = [&](std::initializer_list<Role> roles, std::vector<std::int32_t>& chain) {
    bool differs = false;
    std::vector<std::int32_t> joints, by_role;
    for (const Role role : roles) {
      const std::int32_t j = by_role.emplace_back(meant(role));
      differs = differs || j != figure.at(role);
      if (j != kNoJoint) joints.push_back(j);
    }
    if (!differs) return;
    chain = joints;
    for (std::size_t k = 0; k < roles.size(); ++k) {
      figure.joint[index_of(roles.begin()[k])] = by_role[k];
    }
  };
  listed({Role::spine, Role::chest, Role::upperChest}, figure.spine);
  listed({Role::neck}, figure.neck);
}

}  // namespace

bool Figure::has_fingers(Side side) const {
  return has(on_side(Role::leftIndexProximal, side)) &&
         has(on_side(Role::leftMiddleProximal, side)) &&
         (has(on_side(Role::leftLittleProximal, side)) ||
          has(on_side(Role::leftRingProximal, side)));
}

std::int32_t Figure::root() const {
  if (is_body()) return pelvis.front();
  return at(on_side(Role::leftHand, hand_side()));
}

std::vector<std::optional<Role>> roles_by_joint(const Figure& figure, std::int32_t joint_count) {
  std::vector<std::optional<Role>> roles(static_cast<std::size_t>(joint_count));
  for (int r = 0; r < kRoleCount; ++r) {
    if (figure.joint[r] != kNoJoint) roles[figure.joint[r]] = role_at(r);
  }
  return roles;
}

Result<Figure> identify_figure(const Character& character, const RoleOverrides& overrides) {
  std::optional<Figure> found = identify_by_file(character);
  if (!found) found = identify_by_names(character);
  if (!found) found = identify_by_topology(character);
  if (!found && overrides.empty()) {
    return Error{.code = "map-not-a-figure",
                 .message = "no naming convention fits, and the hierarchy is no human body or hand",
                 .hint = "name the joints in a map file (limber map -o) and pass it with --map"};
  }
  Figure figure = found ? std::move(*found) : Figure();
  if (!found) figure.convention = "map";
  if (auto r = apply_overrides(character, overrides, figure); !r) return r.error();
  if (!figure.is_body() && !figure.is_hand()) {
    return Error{.code = "map-not-a-figure",
                 .message = "the map names neither hips with legs nor a hand",
                 .hint = "name at least hips and both legs, or a hand and its fingers"};
  }
  find_moving_hips(character, figure);
  figure.parents = character.skeleton.parents;
  give_limbs_their_chains(figure);
  give_flat_hand_its_chains(character, figure);
  figure.order = parents_first(figure.parents);
  find_trunk(character, figure);
  name_trunk(figure);
  apply_trunk_overrides(character, overrides, figure);
  list_chains(figure);
  return figure;
}

}  // namespace limber
