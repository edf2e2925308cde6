#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "importers/figure_guess.h"
#include "importers/gltf_document.h"
#include "importers/joint_names.h"

namespace limber::gltf {

namespace {

/// Skin joints, humanoid bones and animated nodes with all their ancestors; all nodes where there
/// is no skin.
std::vector<std::uint8_t> wanted_nodes(Document& document, const Scene& scene) {
  std::vector<std::uint8_t> wanted(scene.nodes.size(), scene.skins.empty() ? 1 : 0);
  const auto want = [&](std::int32_t node) {
    for (; node >= 0 && wanted[node] == 0; node = scene.nodes[node].parent) wanted[node] = 1;
  };
  for (const Skin& skin : scene.skins) {
    for (const std::int32_t node : skin.joints) want(node);
  }
  for (std::size_t i = 0; i < scene.nodes.size(); ++i) {
    if (!scene.vrm_roles[i].empty()) want(static_cast<std::int32_t>(i));
  }
  for (const std::int32_t node : animated_nodes(document)) want(node);
  return wanted;
}

/// Depth first, roots and children in document order.
std::vector<std::int32_t> parents_first(const Scene& scene,
                                        const std::vector<std::uint8_t>& wanted) {
  std::vector<std::int32_t> order;
  std::vector<std::int32_t> stack;
  for (auto i = static_cast<std::int32_t>(scene.nodes.size()) - 1; i >= 0; --i) {
    if (scene.nodes[i].parent < 0) stack.push_back(i);
  }
  while (!stack.empty()) {
    const std::int32_t node = stack.back();
    stack.pop_back();
    if (wanted[node] == 0) continue;
    order.push_back(node);
    const auto& children = scene.nodes[node].children;
    stack.insert(stack.end(), children.rbegin(), children.rend());
  }
  return order;
}

double mean_scale(const Eigen::Vector3d& scale) { return std::cbrt(std::abs(scale.prod())); }

void warn_of_scale(const Node& node, const std::string& name, bool has_joints_below,
                   Warnings& warnings) {
  if (node.scale.minCoeff() < 0.0) {
    warnings.push_back({"scale-mirrored", "a negative scale; its sign was ignored", name});
  }
  const Eigen::Vector3d size = node.scale.cwiseAbs();
  if (has_joints_below && size.maxCoeff() > 1.001 * size.minCoeff()) {
    warnings.push_back(
        {"scale-not-uniform",
         fmt::format("the scale {:.4g}, {:.4g}, {:.4g} was folded as its mean "
                     "{:.4g}",
                     node.scale.x(), node.scale.y(), node.scale.z(), mean_scale(node.scale)),
         name});
  }
}

void fill_names(const Scene& scene, const Joints& joints, Skeleton& skeleton, Warnings& warnings) {
  std::vector<std::uint8_t> generated;
  for (const std::int32_t node : joints.node_of_joint) {
    const std::string& name = scene.nodes[node].name;
    generated.push_back(name.empty() ? 1 : 0);
    skeleton.names.push_back(name.empty() ? "node_" + std::to_string(node) : name);
  }
  const auto unnamed = std::count(generated.begin(), generated.end(), 1);
  if (unnamed > 0) {
    warnings.push_back(
        {"joint-unnamed", fmt::format("{} of {} joints have no name; they are called 'node_N'",
                                      unnamed, generated.size())});
  }
  make_names_valid(skeleton.names, generated, "node_", warnings);
}

}  // namespace

DualQuaternion Joints::local(const Skeleton& skeleton, std::int32_t joint,
                             const Eigen::Vector3d& translation,
                             const Eigen::Quaterniond& rotation) const {
  const DualQuaternion local = DualQuaternion::from_rotation_translation(
      rotation, unit_m * parent_scale[joint] * translation);
  if (skeleton.parents[joint] != kNoJoint) return local;
  return DualQuaternion::from_rotation(canonical_from_file) * local;
}

Eigen::Matrix4d Joints::joint_from_file_joint(std::int32_t joint) const {
  Eigen::Matrix4d m = Eigen::Matrix4d::Identity();
  m.diagonal().head<3>() = unit_m * parent_scale[joint] * own_scale[joint];
  return m;
}

Joints build_skeleton(Document& document, const Scene& scene, const ImportOptions& options,
                      Character& character, Warnings& warnings) {
  Joints joints;
  joints.unit_m = options.unit_m.value_or(1.0);
  joints.canonical_from_file = canonical_from_up(options.up.value_or('y') == 'z' ? "+Z" : "+Y");
  joints.node_of_joint = parents_first(scene, wanted_nodes(document, scene));
  joints.joint_of_node.assign(scene.nodes.size(), -1);
  Skeleton& skeleton = character.skeleton;
  fill_names(scene, joints, skeleton, warnings);
  character.roles.resize(joints.node_of_joint.size());
  for (std::size_t j = 0; j < joints.node_of_joint.size(); ++j) {
    const std::int32_t index = joints.node_of_joint[j];
    const Node& node = scene.nodes[index];
    const auto joint = static_cast<std::int32_t>(j);
    joints.joint_of_node[index] = joint;
    const std::int32_t parent = node.parent < 0 ? kNoJoint : joints.joint_of_node[node.parent];
    skeleton.parents.push_back(parent);
    joints.parent_scale.push_back(parent == kNoJoint ? 1.0
                                                     : joints.parent_scale[parent] *
                                                           mean_scale(joints.own_scale[parent]));
    joints.own_scale.push_back(node.scale.cwiseAbs());
    skeleton.rest_parent_from_joint.push_back(
        joints.local(skeleton, joint, node.translation, node.rotation));
    character.roles[j] = scene.vrm_roles[index];
  }
  std::vector<std::uint8_t> is_parent(skeleton.parents.size(), 0);
  for (const std::int32_t parent : skeleton.parents) {
    if (parent != kNoJoint) is_parent[parent] = 1;
  }
  for (std::size_t j = 0; j < skeleton.parents.size(); ++j) {
    warn_of_scale(scene.nodes[joints.node_of_joint[j]], skeleton.names[j], is_parent[j] != 0,
                  warnings);
  }
  character.deforming.assign(skeleton.parents.size(), scene.skins.empty() ? 1 : 0);
  for (const Skin& skin : scene.skins) {
    for (const std::int32_t node : skin.joints) {
      character.deforming[joints.joint_of_node[node]] = 1;
    }
  }
  return joints;
}

namespace {

/// A joint's place when the skin was bound, in the skin's mesh space but canonical size.
struct Bound {
  std::int32_t joint;
  DualQuaternion mesh_from_joint;
};

std::vector<Bound> bound_joints(const Skin& skin, const Joints& joints) {
  std::vector<Bound> bound;
  std::vector<double> sizes;
  for (std::size_t k = 0; k < skin.inverse_binds.size(); ++k) {
    const std::int32_t joint = joints.joint_of_node[skin.joints[k]];
    const Eigen::Matrix4d joint_from_mesh =
        joints.joint_from_file_joint(joint) * skin.inverse_binds[k];
    const Eigen::Matrix4d mesh_from_joint = joint_from_mesh.inverse();
    Eigen::Matrix3d basis = mesh_from_joint.topLeftCorner<3, 3>();
    sizes.push_back(1.0 / std::cbrt(std::abs(basis.determinant())));
    if (basis.determinant() < 0.0) basis = -basis;
    for (int c = 0; c < 3; ++c) basis.col(c).normalize();
    bound.push_back(
        {joint, DualQuaternion::from_rotation_translation(Eigen::Quaterniond(basis).normalized(),
                                                          mesh_from_joint.topRightCorner<3, 1>())});
  }
  if (sizes.empty()) return bound;
  // Metres per mesh unit, the same for all joints but for rounding and odd scales.
  std::nth_element(sizes.begin(), sizes.begin() + sizes.size() / 2, sizes.end());
  const double size = sizes[sizes.size() / 2];
  for (Bound& b : bound) b.mesh_from_joint.dual.coeffs() *= size;
  return bound;
}

/// How far the skin's binding, placed by `model_from_mesh`, is turned from the rest pose: the
/// median over its joints.
double turn_from_rest(const std::vector<Bound>& bound, const Eigen::Quaterniond& model_from_mesh,
                      const std::vector<DualQuaternion>& rest) {
  std::vector<double> angles;
  for (const Bound& b : bound) {
    angles.push_back(rotation_angle<double>((model_from_mesh * b.mesh_from_joint.real).normalized(),
                                            rest[b.joint].real));
  }
  std::nth_element(angles.begin(), angles.begin() + angles.size() / 2, angles.end());
  return angles[angles.size() / 2];
}

/// glTF does not say where a skin's mesh space lies in the model (it ignores the mesh node). Of the
/// places in use - the model's own space, the mesh node's, the space above the topmost joint - that
/// one is taken whose binding is turned least from the rest pose.
DualQuaternion place_mesh(const Scene& scene, const Joints& joints, std::size_t skin,
                          const std::vector<Bound>& bound, const std::vector<DualQuaternion>& rest,
                          const Skeleton& skeleton) {
  std::vector<DualQuaternion> places = {DualQuaternion::from_rotation(joints.canonical_from_file)};
  for (std::size_t i = 0; i < scene.nodes.size(); ++i) {
    if (scene.nodes[i].skin != static_cast<std::int64_t>(skin)) continue;
    DualQuaternion place;
    double scale_above = joints.unit_m;
    std::vector<const Node*> path;
    for (auto n = static_cast<std::int32_t>(i); n >= 0; n = scene.nodes[n].parent) {
      path.push_back(&scene.nodes[n]);
    }
    for (auto it = path.rbegin(); it != path.rend(); ++it) {
      place = place * DualQuaternion::from_rotation_translation((*it)->rotation,
                                                                scale_above * (*it)->translation);
      scale_above *= mean_scale((*it)->scale);
    }
    places.push_back(places.front() * place);
    break;
  }
  std::int32_t top = bound.front().joint;
  for (const Bound& b : bound) top = std::min(top, b.joint);
  if (skeleton.parents[top] != kNoJoint) places.push_back(rest[skeleton.parents[top]]);
  std::size_t best = 0;
  double least = std::numeric_limits<double>::infinity();
  for (std::size_t k = 0; k < places.size(); ++k) {
    const double turn = turn_from_rest(bound, places[k].real, rest);
    if (turn < least - 1e-4) {
      least = turn;
      best = k;
    }
  }
  return places[best];
}

}  // namespace

void build_bind_pose(const Scene& scene, const Joints& joints, Character& character) {
  if (scene.skins.empty()) return;
  const Skeleton& skeleton = character.skeleton;
  const std::size_t total = skeleton.parents.size();
  std::vector<DualQuaternion> rest(total);
  model_from_local(skeleton, skeleton.rest_parent_from_joint, rest);
  std::vector<DualQuaternion> bind(total);
  std::vector<std::uint8_t> known(total, 0);
  for (std::size_t s = 0; s < scene.skins.size(); ++s) {
    const std::vector<Bound> bound = bound_joints(scene.skins[s], joints);
    if (bound.empty()) continue;
    const DualQuaternion model_from_mesh = place_mesh(scene, joints, s, bound, rest, skeleton);
    for (const Bound& b : bound) {
      if (known[b.joint] != 0) continue;
      known[b.joint] = 1;
      bind[b.joint] = (model_from_mesh * b.mesh_from_joint).normalized();
    }
  }
  // Ancestors of bound joints follow from a child, everything else from its parent.
  for (std::size_t j = total; j-- > 0;) {
    const std::int32_t parent = skeleton.parents[j];
    if (known[j] == 0 || parent == kNoJoint || known[parent] != 0) continue;
    known[parent] = 1;
    bind[parent] = (bind[j] * skeleton.rest_parent_from_joint[j].conjugate()).normalized();
  }
  for (std::size_t j = 0; j < total; ++j) {
    if (known[j] != 0) continue;
    const std::int32_t parent = skeleton.parents[j];
    bind[j] = parent == kNoJoint ? skeleton.rest_parent_from_joint[j]
                                 : (bind[parent] * skeleton.rest_parent_from_joint[j]).normalized();
  }
  character.bind_model_from_joint = std::move(bind);
}

}  // namespace limber::gltf
