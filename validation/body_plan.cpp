#include <algorithm>
#include <array>
#include <cctype>
#include <map>
#include <string_view>

#include "validation/figure_model.h"

namespace limber {
namespace {

std::string lower(std::string_view s) {
  std::string out(s);
  for (char& c : out) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return out;
}

bool has(std::string_view text, std::string_view part) {
  return text.find(part) != std::string_view::npos;
}

std::string_view without_namespace(std::string_view name) {
  const std::size_t colon = name.rfind(':');
  return colon == std::string_view::npos ? name : name.substr(colon + 1);
}

/// The side that a joint's name states: left, _L, .l, L_, lThigh, LThigh and their mirrors.
BodySide side_in_name(std::string_view full_name) {
  const std::string_view name = without_namespace(full_name);
  const std::string small = lower(name);
  if (has(small, "left")) return BodySide::left;
  if (has(small, "right")) return BodySide::right;
  const auto of = [](char c) {
    return c == 'l' || c == 'L'   ? BodySide::left
           : c == 'r' || c == 'R' ? BodySide::right
                                  : BodySide::centre;
  };
  const auto letter = [](char c) { return std::isalpha(static_cast<unsigned char>(c)) != 0; };
  for (std::size_t i = 0; i < name.size(); ++i) {
    const bool begins = i == 0 || !letter(name[i - 1]);
    const bool ends = i + 1 == name.size() || !letter(name[i + 1]);
    if (begins && ends && of(name[i]) != BodySide::centre) return of(name[i]);
  }
  const auto upper = [](char c) { return std::isupper(static_cast<unsigned char>(c)) != 0; };
  if (name.size() > 2 && upper(name[1])) {
    if (letter(name[2]) && !upper(name[2])) return of(name[0]);  // "LLL", "RL_" say nothing
  }
  return BodySide::centre;
}

bool looks_like_role(std::string_view name) {
  static constexpr std::array kEnds = {"UpperLeg",
                                       "LowerLeg",
                                       "Foot",
                                       "Toes",
                                       "Shoulder",
                                       "UpperArm",
                                       "LowerArm",
                                       "Hand",
                                       "ThumbMetacarpal",
                                       "ThumbProximal",
                                       "ThumbDistal",
                                       "IndexProximal",
                                       "IndexIntermediate",
                                       "IndexDistal",
                                       "MiddleProximal",
                                       "MiddleIntermediate",
                                       "MiddleDistal",
                                       "RingProximal",
                                       "RingIntermediate",
                                       "RingDistal",
                                       "LittleProximal",
                                       "LittleIntermediate",
                                       "LittleDistal"};
  if (name == "hips" || name == "spine" || name == "chest" || name == "neck" || name == "head") {
    return true;
  }
  const std::size_t skip = name.starts_with("left") ? 4 : name.starts_with("right") ? 5 : 0;
  return skip > 0 && std::find(kEnds.begin(), kEnds.end(), name.substr(skip)) != kEnds.end();
}

/// The middle of the body, whichever joint it hangs on: a rig may be rooted at a foot.
bool is_of_trunk(std::string_view role) {
  constexpr std::array<std::string_view, 6> kTrunk = {"hips",       "spine", "chest",
                                                      "upperChest", "neck",  "head"};
  return std::find(kTrunk.begin(), kTrunk.end(), role) != kTrunk.end();
}

bool named_sides(const Character& character, BodyPlan& plan) {
  const Skeleton& skeleton = character.skeleton;
  bool left = false, right = false;
  for (std::int32_t i = 0; i < skeleton.size(); ++i) {
    BodySide side = side_in_name(plan.roles[i]);
    if (side == BodySide::centre) side = side_in_name(skeleton.names[i]);
    const std::int32_t parent = skeleton.parents[i];
    if (side == BodySide::centre && parent != kNoJoint && !is_of_trunk(plan.roles[i])) {
      side = plan.sides[parent];
    }
    plan.sides[i] = side;
    left = left || side == BodySide::left;
    right = right || side == BodySide::right;
  }
  return left && right;
}

/// The name with its side taken out, for finding mirror images.
std::string sideless(std::string_view full_name) {
  std::string name = lower(without_namespace(full_name));
  for (const std::string_view word : {"left", "right"}) {
    const std::size_t at = name.find(word);
    if (at == std::string::npos) continue;
    name.erase(at, word.size() - 1);
    name[at] = '*';
    return name;
  }
  const auto letter = [&](std::size_t i) {
    return i < name.size() && std::isalpha(static_cast<unsigned char>(name[i])) != 0;
  };
  const auto side = [&](std::size_t i) { return name[i] == 'l' || name[i] == 'r'; };
  for (std::size_t i = 0; i < name.size(); ++i) {
    const bool alone = (i == 0 || !letter(i - 1)) && !letter(i + 1);
    if (!alone || !side(i)) continue;
    name[i] = '*';
    return name;
  }
  if (!name.empty() && side(0)) name[0] = '*';
  return name;
}

/// Pairs where the two chains leave the middle; joints that coincide at rest are still there.
void pair_by_name(const Character& character, BodyPlan& plan) {
  const Skeleton& skeleton = character.skeleton;
  const std::vector<DualQuaternion> rest = rest_model(character);
  std::map<std::string, std::int32_t> right;
  for (std::int32_t i = 0; i < skeleton.size(); ++i) {
    if (plan.sides[i] == BodySide::right) right.emplace(sideless(skeleton.names[i]), i);
  }
  std::vector<std::uint8_t> apart(skeleton.parents.size(), 0);
  for (std::int32_t l = 0; l < skeleton.size(); ++l) {
    const std::int32_t parent = skeleton.parents[l];
    apart[l] = parent != kNoJoint && apart[parent];
    if (plan.sides[l] != BodySide::left || apart[l]) continue;
    const auto r = right.find(sideless(skeleton.names[l]));
    if (r == right.end()) continue;
    if ((rest[l].translation() - rest[r->second].translation()).norm() < 1e-4) continue;
    plan.pairs.emplace_back(l, r->second);
    apart[l] = 1;
  }
}

/// Control joints beside the body (IK targets, poles) say nothing about where it looks.
void keep_pairs_below(const Skeleton& skeleton, std::int32_t pelvis, BodyPlan& plan) {
  const std::vector<std::uint8_t> inside = joints_below(skeleton, pelvis);
  std::vector<std::pair<std::int32_t, std::int32_t>> kept;
  for (const auto& pair : plan.pairs) {
    if (inside[pair.first] && inside[pair.second]) kept.push_back(pair);
  }
  if (!kept.empty()) plan.pairs = kept;
}

/// Sides of a skeleton whose names tell nothing: siblings with like subtrees, beside each other at
/// rest, are mirror images; which of them is left follows from where the feet point.
void pair_by_shape(const Character& character, BodyPlan& plan) {
  const Skeleton& skeleton = character.skeleton;
  const auto n = static_cast<std::size_t>(skeleton.size());
  const std::vector<DualQuaternion> rest = rest_model(character);
  const auto at = [&](std::int32_t i) { return rest[i].translation(); };
  std::vector<int> joints(n, 1);
  std::vector<double> length(n, 0.0);
  std::vector<std::int32_t> tip(n);  // the subtree's last joint
  for (std::int32_t i = skeleton.size() - 1; i >= 0; --i) {
    if (joints[i] == 1) tip[i] = i;
    const std::int32_t parent = skeleton.parents[i];
    if (parent == kNoJoint) continue;
    joints[parent] += joints[i];
    length[parent] += length[i] + (at(i) - at(parent)).norm();
    tip[parent] = tip[i];
  }
  Eigen::Vector3d forward = Eigen::Vector3d::Zero();
  for (std::int32_t a = 0; a < skeleton.size(); ++a) {
    for (std::int32_t b = a + 1; b < skeleton.size(); ++b) {
      if (skeleton.parents[a] != skeleton.parents[b] || joints[a] != joints[b] || joints[a] < 2) {
        continue;
      }
      const Eigen::Vector3d apart = at(a) - at(b);
      const bool alike = std::abs(length[a] - length[b]) < 0.05 * (length[a] + length[b]);
      if (!alike || std::hypot(apart.x(), apart.z()) < 2.0 * std::abs(apart.y())) continue;
      plan.pairs.emplace_back(a, b);
      for (const std::int32_t limb : {a, b}) {
        if (at(tip[limb]).y() > at(limb).y() - 0.5 * length[limb]) continue;  // no leg
        forward += at(tip[limb]) - at(skeleton.parents[tip[limb]]);
      }
    }
  }
  forward.y() = 0.0;
  if (forward.norm() < 1e-6) forward = Eigen::Vector3d(0, 0, 1);
  const Eigen::Vector3d left = Eigen::Vector3d(0, 1, 0).cross(forward);
  for (auto& [l, r] : plan.pairs) {
    if ((at(l) - at(r)).dot(left) < 0.0) std::swap(l, r);
    plan.sides[l] = BodySide::left;
    plan.sides[r] = BodySide::right;
  }
  for (std::int32_t i = 0; i < skeleton.size(); ++i) {
    const std::int32_t parent = skeleton.parents[i];
    if (parent != kNoJoint && plan.sides[i] == BodySide::centre) plan.sides[i] = plan.sides[parent];
  }
}

constexpr std::array<std::string_view, 5> kFingers = {"thumb", "index", "middle", "ring", "little"};

/// 0 thumb ... 4 little, -1 none. "RingPinky" is a little finger.
std::int8_t finger_in(const std::string& lower_name) {
  if (has(lower_name, "pinky") || has(lower_name, "pinkie")) return 4;
  for (std::size_t f = kFingers.size(); f-- > 0;) {
    if (has(lower_name, kFingers[f])) return static_cast<std::int8_t>(f);
  }
  return -1;
}

void find_fingers(const Skeleton& skeleton, BodyPlan& plan) {
  plan.fingers.assign(skeleton.parents.size(), -1);
  for (std::int32_t i = 0; i < skeleton.size(); ++i) {
    std::int8_t finger = finger_in(lower(plan.roles[i]));
    if (finger < 0) finger = finger_in(lower(skeleton.names[i]));
    const std::int32_t parent = skeleton.parents[i];
    if (finger < 0 && parent != kNoJoint) finger = plan.fingers[parent];
    plan.fingers[i] = finger;
  }
}

bool part_of_a_body(std::string_view lower_name) {
  for (const std::string_view word :
       {"leg", "thigh", "foot", "knee", "spine", "hips", "pelvis", "chest", "neck", "head"}) {
    if (has(lower_name, word)) return true;
  }
  return false;
}

bool below(const Skeleton& skeleton, std::int32_t joint, std::int32_t top) {
  while (joint > top) joint = skeleton.parents[joint];
  return joint == top;
}

std::int32_t find_named(const Character& character, const BodyPlan& plan, std::string_view role,
                        std::initializer_list<std::string_view> words) {
  for (std::int32_t i = 0; i < character.skeleton.size(); ++i) {
    if (plan.roles[i] == role) return i;
  }
  for (const std::string_view word : words) {
    for (std::int32_t i = 0; i < character.skeleton.size(); ++i) {
      const std::string name = lower(without_namespace(character.skeleton.names[i]));
      if (has(name, word) && plan.sides[i] == BodySide::centre) return i;
    }
  }
  return kNoJoint;
}

}  // namespace

std::vector<DualQuaternion> rest_model(const Character& character) {
  const Skeleton& skeleton = character.skeleton;
  std::vector<DualQuaternion> rest = character.bind_model_from_joint;
  if (rest.size() == skeleton.parents.size()) return rest;
  rest.resize(skeleton.parents.size());
  model_from_local(skeleton, skeleton.rest_parent_from_joint, rest);
  return rest;
}

std::int32_t knuckle_of(const Skeleton& skeleton, const BodyPlan& plan, std::int8_t finger) {
  std::vector<std::int32_t> chain;
  for (std::int32_t i = 0; i < skeleton.size(); ++i) {
    if (plan.fingers[i] != finger) continue;
    if (has(lower(plan.roles[i]), "proximal") || has(lower(skeleton.names[i]), "proximal"))
      return i;
    chain.push_back(i);
  }
  if (chain.empty()) return kNoJoint;
  return chain.size() >= 5 ? chain[1] : chain[0];  // five: the metacarpal comes first
}

std::int32_t wrist_of(const Skeleton& skeleton, const BodyPlan& plan) {
  if (plan.crop != kNoJoint) return plan.crop;
  for (std::int32_t i = 0; i < skeleton.size(); ++i) {
    if (plan.roles[i].ends_with("Hand") || has(lower(skeleton.names[i]), "wrist")) return i;
  }
  std::int32_t wrist = knuckle_of(skeleton, plan, 1);  // above the fingers
  while (wrist > 0 && plan.fingers[wrist] >= 0) wrist = skeleton.parents[wrist];
  return std::max(wrist, 0);
}

std::vector<std::uint8_t> joints_below(const Skeleton& skeleton, std::int32_t top) {
  std::vector<std::uint8_t> below(skeleton.parents.size(), top == kNoJoint);
  for (std::int32_t i = std::max(top, 0); i < skeleton.size(); ++i) {
    const std::int32_t parent = skeleton.parents[i];
    if (i == top || (parent != kNoJoint && below[parent])) below[i] = 1;
  }
  return below;
}

BodyPlan hand_plan_of(const Character& character, BodySide side) {
  const Skeleton& skeleton = character.skeleton;
  const BodyPlan whole = plan_of(character);
  BodyPlan hand = whole;
  for (std::int32_t i = 0; i < skeleton.size(); ++i) {
    if (hand.sides[i] != side) hand.fingers[i] = -1;
  }
  std::int32_t wrist = knuckle_of(skeleton, hand, 1);  // the last joint that carries all fingers
  while (wrist != kNoJoint && hand.fingers[wrist] >= 0) wrist = skeleton.parents[wrist];
  if (wrist == kNoJoint || wrist == 0) return whole;
  hand.crop = hand.pelvis = wrist;
  hand.head = kNoJoint;
  hand.hand_only = true;
  hand.stands = false;
  return hand;
}

BodyPlan plan_of(const Character& character) {
  const Skeleton& skeleton = character.skeleton;
  BodyPlan plan;
  plan.roles = character.roles;
  plan.roles.resize(skeleton.parents.size());
  plan.sides.resize(skeleton.parents.size(), BodySide::centre);
  bool body = false;
  for (std::int32_t i = 0; i < skeleton.size(); ++i) {
    if (plan.roles[i].empty() && looks_like_role(skeleton.names[i])) {
      plan.roles[i] = skeleton.names[i];
    }
    body = body || part_of_a_body(lower(skeleton.names[i])) || part_of_a_body(lower(plan.roles[i]));
  }
  find_fingers(skeleton, plan);
  const auto some = [&](std::int8_t f) {
    return std::find(plan.fingers.begin(), plan.fingers.end(), f) != plan.fingers.end();
  };
  plan.hand_only = !body && some(0) && some(1);
  if (named_sides(character, plan)) {
    pair_by_name(character, plan);
  } else if (!plan.hand_only) {
    std::fill(plan.sides.begin(), plan.sides.end(), BodySide::centre);
    pair_by_shape(character, plan);
  }
  if (plan.hand_only) {
    plan.pelvis = wrist_of(skeleton, plan);
    return plan;
  }
  plan.head = find_named(character, plan, "head", {"head"});
  plan.pelvis = find_named(character, plan, "hips", {"hips", "pelvis", "hip"});
  // iClone's "Pelvis" carries the legs alone: the figure hangs on what also carries the head.
  while (plan.pelvis > 0 && plan.head != kNoJoint && !below(skeleton, plan.head, plan.pelvis) &&
         skeleton.parents[plan.pelvis] != kNoJoint) {
    plan.pelvis = skeleton.parents[plan.pelvis];
  }
  if (plan.pelvis == kNoJoint) {  // where the tree first branches, if it does
    const auto children = children_of(skeleton);
    plan.pelvis = 0;
    while (children[plan.pelvis].size() == 1) plan.pelvis = children[plan.pelvis][0];
    if (children[plan.pelvis].empty()) plan.pelvis = 0;
  }
  plan.stands = plan.head != kNoJoint || !plan.pairs.empty();
  keep_pairs_below(skeleton, plan.pelvis, plan);
  return plan;
}

}  // namespace limber
