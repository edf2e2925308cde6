#include <nlohmann/json.hpp>
#include <string>

#include "exporters/exporter.h"

namespace limber {
namespace {

using Json = nlohmann::ordered_json;

Json vector_json(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }
Json range_json(const Range& r) { return {r.min, r.max}; }

Json joint_json(const RigJoint& joint, std::int32_t dof_index) {
  Json out;
  out["name"] = joint.name;
  if (!joint.role.empty()) out["role"] = joint.role;
  out["parent"] = joint.parent;
  out["type"] = to_string(joint.type);
  out["dof"] = dof_count(joint.type);
  out["dof_index"] = dof_index;
  out["offset"] = vector_json(joint.offset);
  out["rest"] = {joint.rest.w(), joint.rest.x(), joint.rest.y(), joint.rest.z()};
  const int axes = joint.type == JointType::ball        ? 3
                   : joint.type == JointType::universal ? 2
                   : joint.type == JointType::hinge     ? 1
                                                        : 0;
  out["axes"] = Json::array();
  for (int k = 0; k < axes; ++k) out["axes"].push_back(vector_json(joint.axes[k]));
  if (joint.limited() && joint.type == JointType::ball) {
    out["twist_swing"] = {{"swing0", range_json(joint.limits[0])},
                          {"swing1", range_json(joint.limits[1])},
                          {"twist", range_json(joint.limits[2])}};
  } else if (joint.limited()) {
    out["limits"] = Json::array();
    for (int k = 0; k < axes; ++k) out["limits"].push_back(range_json(joint.limits[k]));
  }
  if (joint.weight != 1.0) out["weight"] = joint.weight;
  if (joint.max_speed > 0.0) out["max_speed"] = joint.max_speed;
  if (!joint.citation.empty()) out["citation"] = joint.citation;
  for (const Capsule& c : joint.capsules) {
    out["capsules"].push_back(
        {{"from", vector_json(c.from)}, {"to", vector_json(c.to)}, {"radius", c.radius}});
  }
  return out;
}

Json effector_json(const RigEffector& effector) {
  Json out;
  out["name"] = effector.name;
  out["joint"] = effector.joint;
  out["offset"] = vector_json(effector.offset);
  out["kind"] = to_string(effector.kind);
  if (has_axis(effector.kind)) {
    out["axis"] = vector_json(effector.axis);
  }
  out["strong"] = effector.strong;
  out["weight_pos"] = effector.weight_pos;
  out["weight_rot"] = effector.weight_rot;
  if (effector.relative_to != kNoJoint) out["relative_to"] = effector.relative_to;
  if (effector.priority != 0) out["priority"] = effector.priority;
  return out;
}

Json coupling_json(const Coupling& c) {
  return {{"from_joint", c.from_joint}, {"from_dof", c.from_dof}, {"to_joint", c.to_joint},
          {"to_dof", c.to_dof},         {"ratio", c.ratio},       {"offset", c.offset}};
}

}  // namespace

std::string write_rig_json(const Rig& rig) {
  Json out;
  out["format"] = "ikrig/1";
  out["name"] = rig.name;
  if (!rig.description.empty()) out["description"] = rig.description;
  out["ndof"] = dof_count(rig);
  const std::vector<std::int32_t> begin = dof_begin(rig);
  out["joints"] = Json::array();
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    out["joints"].push_back(joint_json(rig.joints[i], begin[i]));
  }
  out["effectors"] = Json::array();
  for (const RigEffector& effector : rig.effectors) {
    out["effectors"].push_back(effector_json(effector));
  }
  for (const Coupling& coupling : rig.couplings)
    out["couplings"].push_back(coupling_json(coupling));
  for (const CollisionPair& pair : rig.collisions) {
    out["collisions"].push_back({pair.joint_a, pair.joint_b});
  }
  return out.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace limber
