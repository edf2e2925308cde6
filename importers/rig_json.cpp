#include "importers/rig_json.h"

#include <fmt/format.h>

#include <cmath>
#include <map>

#include "importers/failure.h"
#include "importers/json_view.h"

namespace limber {

namespace {

constexpr const char* kCode = "rig-json";
constexpr std::int64_t kMaxJoints = 65536;
constexpr std::int64_t kMaxPriority = 255;

template <class Enum>
Enum read_enum(const JsonView& view, std::initializer_list<Enum> values) {
  std::string known;
  for (const Enum value : values) {
    if (view.string() == to_string(value)) return value;
    known += known.empty() ? "" : ", ";
    known += to_string(value);
  }
  view.complain(fmt::format("'{}' is none of {}", view.string(), known));
}

Eigen::Vector3d read_unit_vector(const JsonView& view) {
  const Eigen::Vector3d v = view.vector3();
  if (std::abs(v.norm() - 1.0) > 1e-6) view.complain("a unit vector is expected");
  return v.normalized();
}

Eigen::Quaterniond read_quaternion(const JsonView& view) {
  view.array_of(4);
  const Eigen::Quaterniond q(view[0].number(), view[1].number(), view[2].number(),
                             view[3].number());
  if (std::abs(q.norm() - 1.0) > 1e-6) view.complain("a unit quaternion (w, x, y, z) is expected");
  return q.normalized();
}

Range read_range(const JsonView& view) {
  view.array_of(2);
  const Range range{view[0].number(), view[1].number()};
  if (range.min > range.max) view.complain("the range is empty: its minimum exceeds its maximum");
  return range;
}

/// A joint by its index, or by the name of one that stands before it (or anywhere, once all do).
std::int32_t read_joint(const JsonView& view, const Rig& rig, std::int32_t min = 0) {
  if (view.is_string()) {
    const std::int32_t joint = rig.find(view.string());
    if (joint == kNoJoint) view.complain(fmt::format("no joint is named '{}'", view.string()));
    return joint;
  }
  return static_cast<std::int32_t>(view.integer(min, rig.size() - 1));
}

void read_axes(const JsonView& view, RigJoint& joint) {
  const std::int32_t count = joint.type == JointType::ball        ? 3
                             : joint.type == JointType::universal ? 2
                             : joint.type == JointType::hinge     ? 1
                                                                  : 0;
  const auto axes = view.find("axes");
  if (count > 0 && !axes) view.complain("'axes' is missing");
  if (!axes) return;
  if (count == 0 && axes->array().size() == 0) return;
  axes->array_of(static_cast<std::size_t>(count));
  for (std::int32_t k = 0; k < count; ++k) joint.axes[k] = read_unit_vector((*axes)[k]);
}

/// Balls are limited by `twist_swing`; their `limits` box, like a free joint's, is for solvers that
/// know hinges only: its shape is checked and its numbers are left alone.
void read_limits(const JsonView& view, RigJoint& joint) {
  const auto limits = view.find("limits");
  const auto twist_swing = view.find("twist_swing");
  if (limits && !limits->is_null()) {
    limits->array_of(static_cast<std::size_t>(dof_count(joint.type)));
    for (std::size_t k = 0; k < limits->size(); ++k) {
      const Range range = read_range((*limits)[k]);
      if (joint.type == JointType::hinge || joint.type == JointType::universal) {
        joint.limits[k] = range;
      }
    }
  }
  if (!twist_swing || twist_swing->is_null()) return;
  if (joint.type != JointType::ball) twist_swing->complain("only ball joints have 'twist_swing'");
  twist_swing->only({"swing0", "swing1", "twist"});
  joint.limits[0] = read_range(twist_swing->at("swing0"));
  joint.limits[1] = read_range(twist_swing->at("swing1"));
  joint.limits[2] = read_range(twist_swing->at("twist"));
}

Capsule read_capsule(const JsonView& view) {
  view.only({"from", "to", "radius"});
  Capsule capsule{view.at("from").vector3(), view.at("to").vector3(), view.at("radius").number()};
  if (!(capsule.radius > 0.0)) view.at("radius").complain("a radius above zero is expected");
  return capsule;
}

/// `citation` (one text or key of the rig's `citations`) and `citations` (several).
std::string read_citation(const JsonView& view, const std::map<std::string, std::string>& known) {
  std::string text;
  const auto add = [&](const JsonView& entry) {
    const auto it = known.find(entry.string());
    text += text.empty() ? "" : "; ";
    text += it == known.end() ? entry.string() : it->second;
  };
  if (const auto one = view.find("citation")) add(*one);
  if (const auto many = view.find("citations")) {
    for (std::size_t i = 0; i < many->array().size(); ++i) add((*many)[i]);
  }
  return text;
}

RigJoint read_rig_joint(const JsonView& view, const Rig& rig, std::int64_t& dof_index,
                        const std::map<std::string, std::string>& citations) {
  view.only({"name", "parent", "type", "role", "offset", "rest", "axes", "limits", "dof",
             "dof_index", "twist_swing", "capsule", "capsules", "weight", "max_speed", "citation",
             "citations"});
  RigJoint joint;
  joint.name = view.at("name").string();
  if (joint.name.empty()) view.at("name").complain("a name is expected");
  if (rig.find(joint.name) != kNoJoint) view.at("name").complain("another joint has this name");
  if (const auto role = view.find("role")) joint.role = role->string();
  if (!joint.role.empty() && rig.find_role(joint.role) != kNoJoint) {
    view.at("role").complain("another joint has this role");
  }
  joint.parent = read_joint(view.at("parent"), rig, kNoJoint);
  joint.type = read_enum(view.at("type"), {JointType::fixed, JointType::hinge, JointType::universal,
                                           JointType::ball, JointType::free});
  joint.offset = view.at("offset").vector3();
  if (const auto rest = view.find("rest")) joint.rest = read_quaternion(*rest);
  read_axes(view, joint);
  read_limits(view, joint);
  if (const auto capsule = view.find("capsule")) {
    if (!capsule->is_null()) joint.capsules.push_back(read_capsule(*capsule));
  }
  if (const auto capsules = view.find("capsules")) {
    for (std::size_t i = 0; i < capsules->array().size(); ++i) {
      joint.capsules.push_back(read_capsule((*capsules)[i]));
    }
  }
  if (const auto weight = view.find("weight")) {
    joint.weight = weight->number();
    if (!(joint.weight > 0.0)) weight->complain("a weight above zero is expected");
  }
  if (const auto speed = view.find("max_speed")) {
    joint.max_speed = speed->number();
    if (joint.max_speed < 0.0) speed->complain("a speed is at least zero");
  }
  joint.citation = read_citation(view, citations);
  const std::int32_t dof = dof_count(joint.type);
  if (const auto given = view.find("dof")) given->integer(dof, dof);
  if (const auto given = view.find("dof_index")) given->integer(dof_index, dof_index);
  dof_index += dof;
  return joint;
}

RigEffector read_effector(const JsonView& view, const Rig& rig) {
  view.only({"name", "joint", "offset", "kind", "axis", "strong", "weight_pos", "weight_rot",
             "relative_to", "priority"});
  RigEffector effector;
  effector.name = view.at("name").string();
  if (effector.name.empty()) view.at("name").complain("a name is expected");
  for (const RigEffector& other : rig.effectors) {
    if (other.name == effector.name) view.at("name").complain("another effector has this name");
  }
  effector.joint = read_joint(view.at("joint"), rig);
  if (const auto offset = view.find("offset")) effector.offset = offset->vector3();
  if (const auto kind = view.find("kind")) {
    effector.kind =
        read_enum(*kind, {EffectorKind::pose, EffectorKind::position, EffectorKind::orientation,
                          EffectorKind::direction, EffectorKind::line, EffectorKind::gaze});
  }
  if (const auto axis = view.find("axis")) {
    effector.axis = read_unit_vector(*axis);
  } else if (has_axis(effector.kind)) {
    view.complain("a direction, line or gaze effector needs 'axis'");
  }
  if (const auto strong = view.find("strong")) effector.strong = strong->boolean();
  const auto read_weight = [&](const char* key, double& weight) {
    const auto given = view.find(key);
    if (!given) return;
    weight = given->number();
    if (weight < 0.0) given->complain("a weight is at least zero");
  };
  read_weight("weight_pos", effector.weight_pos);
  read_weight("weight_rot", effector.weight_rot);
  if (const auto base = view.find("relative_to")) {
    effector.relative_to = read_joint(*base, rig);
    if (effector.relative_to == effector.joint) {
      base->complain("an effector cannot be relative to its own joint");
    }
  }
  if (const auto priority = view.find("priority")) {
    effector.priority = static_cast<std::int32_t>(priority->integer(0, kMaxPriority));
  }
  return effector;
}

Coupling read_coupling(const JsonView& view, const Rig& rig) {
  view.only({"from_joint", "from_dof", "to_joint", "to_dof", "ratio", "offset"});
  Coupling coupling;
  const auto read_dof = [&](const char* key, std::int32_t joint) {
    const auto given = view.find(key);
    const std::int32_t count = coupled_dof_count(rig.joints[joint]);
    if (count == 0) {
      view.complain(fmt::format("joint '{}' has no coordinate to couple", rig.joints[joint].name));
    }
    return given ? static_cast<std::int32_t>(given->integer(0, count - 1)) : 0;
  };
  coupling.from_joint = read_joint(view.at("from_joint"), rig);
  coupling.from_dof = read_dof("from_dof", coupling.from_joint);
  coupling.to_joint = read_joint(view.at("to_joint"), rig);
  coupling.to_dof = read_dof("to_dof", coupling.to_joint);
  if (coupling.from_joint == coupling.to_joint && coupling.from_dof == coupling.to_dof) {
    view.complain("a coordinate cannot be coupled to itself");
  }
  if (const auto ratio = view.find("ratio")) coupling.ratio = ratio->number();
  if (const auto offset = view.find("offset")) coupling.offset = offset->number();
  return coupling;
}

CollisionPair read_collision(const JsonView& view, const Rig& rig) {
  view.array_of(2);
  const CollisionPair pair{read_joint(view[0], rig), read_joint(view[1], rig)};
  if (pair.joint_a == pair.joint_b) view.complain("a joint cannot collide with itself");
  return pair;
}

std::map<std::string, std::string> read_known_citations(const JsonView& root) {
  std::map<std::string, std::string> known;
  const auto citations = root.find("citations");
  if (!citations) return known;
  if (citations->is_array()) {
    for (std::size_t i = 0; i < citations->size(); ++i) (*citations)[i].string();
    return known;
  }
  for (const auto& [key, unused] : citations->object().value().items()) {
    known[key] = citations->at(key.c_str()).string();
  }
  return known;
}

Rig read_rig(const JsonView& root) {
  root.only({"$schema", "format", "name", "description", "ndof", "joints", "effectors", "couplings",
             "collisions", "citations"});
  if (root.at("format").string() != "ikrig/1") {
    root.at("format").complain("the format is not 'ikrig/1'");
  }
  Rig rig;
  rig.name = root.at("name").string();
  if (rig.name.empty()) root.at("name").complain("a name is expected");
  if (const auto description = root.find("description")) rig.description = description->string();
  const auto citations = read_known_citations(root);
  const JsonView joints = root.at("joints");
  if (joints.array().size() == 0) joints.complain("the rig has no joints");
  if (joints.size() > std::size_t(kMaxJoints)) joints.complain("too many joints");
  std::int64_t dof = 0;
  for (std::size_t i = 0; i < joints.size(); ++i) {
    rig.joints.push_back(read_rig_joint(joints[i], rig, dof, citations));
  }
  if (const auto ndof = root.find("ndof")) ndof->integer(dof, dof);
  if (const auto effectors = root.find("effectors")) {
    for (std::size_t i = 0; i < effectors->array().size(); ++i) {
      rig.effectors.push_back(read_effector((*effectors)[i], rig));
    }
  }
  if (const auto couplings = root.find("couplings")) {
    for (std::size_t i = 0; i < couplings->array().size(); ++i) {
      rig.couplings.push_back(read_coupling((*couplings)[i], rig));
    }
  }
  if (const auto collisions = root.find("collisions")) {
    for (std::size_t i = 0; i < collisions->array().size(); ++i) {
      rig.collisions.push_back(read_collision((*collisions)[i], rig));
    }
  }
  return rig;
}

}  // namespace

Result<Rig> read_rig_json(std::string_view text) {
  return guarded<Rig>([&]() -> Result<Rig> {
    const nlohmann::json document = parse_json(text, kCode, true);
    Rig rig = read_rig(JsonView(document, kCode));
    if (Result<void> valid = validate(rig); !valid) {
      Error error = valid.error();
      error.code = kCode;
      const std::int32_t joint = rig.find(error.joint);
      if (joint != kNoJoint) error.message = fmt::format("/joints/{}: {}", joint, error.message);
      return error;
    }
    return rig;
  });
}

}  // namespace limber
