#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <set>
#include <string>

#include "exporters/gltf_document.h"

namespace limber {
namespace {

constexpr int kArrayBuffer = 34962;
constexpr std::size_t kMaxInfluences = 8;  ///< JOINTS_0 and JOINTS_1

Json joint_node(const Skeleton& skeleton, std::int32_t j,
                const std::vector<std::vector<std::int32_t>>& children) {
  Json node;
  node["name"] = skeleton.names[j];
  if (!children[j].empty()) node["children"] = children[j];
  const DualQuaternion& local = skeleton.rest_parent_from_joint[j];
  const Eigen::Vector3d t = local.translation();
  const Eigen::Quaterniond q = local.rotation().normalized();
  if (!t.isZero(0.0)) node["translation"] = {t.x(), t.y(), t.z()};
  if (!q.vec().isZero(0.0)) node["rotation"] = {q.x(), q.y(), q.z(), q.w()};
  return node;
}

/// A vertex's strongest influences, one per joint, renormalised in float so that they sum to one.
std::vector<Influence> strongest(const Mesh& mesh, std::size_t vertex) {
  std::vector<Influence> merged;
  for (std::uint32_t i = mesh.influence_begin[vertex]; i < mesh.influence_begin[vertex + 1]; ++i) {
    const Influence& influence = mesh.influences[i];
    const auto same = std::find_if(merged.begin(), merged.end(), [&](const Influence& m) {
      return m.skin_joint == influence.skin_joint;
    });
    if (same != merged.end()) {
      same->weight += influence.weight;
    } else if (influence.weight > 0.0F) {
      merged.push_back(influence);
    }
  }
  std::stable_sort(merged.begin(), merged.end(),
                   [](const Influence& a, const Influence& b) { return a.weight > b.weight; });
  if (merged.size() > kMaxInfluences) merged.resize(kMaxInfluences);
  double sum = 0.0;
  for (const Influence& m : merged) sum += m.weight;
  float rest = 1.0F;
  for (std::size_t i = 1; i < merged.size(); ++i) {
    merged[i].weight = static_cast<float>(merged[i].weight / sum);
    rest -= merged[i].weight;
  }
  merged[0].weight = rest;
  return merged;
}

void add_skin_attributes(Json& attributes, GltfBuffer& buffer, const Mesh& mesh) {
  std::vector<std::vector<Influence>> influences;
  std::size_t most = 1;
  for (std::size_t v = 0; v < mesh.positions.size(); ++v) {
    influences.push_back(strongest(mesh, v));
    most = std::max(most, influences.back().size());
  }
  for (std::size_t set = 0; 4 * set < most; ++set) {
    std::vector<std::uint16_t> joints;
    std::vector<float> weights;
    for (const std::vector<Influence>& vertex : influences) {
      for (std::size_t i = 4 * set; i < 4 * set + 4; ++i) {
        const bool used = i < vertex.size();
        joints.push_back(used ? static_cast<std::uint16_t>(vertex[i].skin_joint) : 0);
        weights.push_back(used ? vertex[i].weight : 0.0F);
      }
    }
    const std::string n = std::to_string(set);
    attributes["JOINTS_" + n] = buffer.add_shorts(joints, "VEC4", kArrayBuffer);
    attributes["WEIGHTS_" + n] = buffer.add_floats(weights, "VEC4", false, kArrayBuffer);
  }
}

template <class Vector>
std::span<const float> floats(const std::vector<Vector>& vectors) {
  static_assert(sizeof(Vector) == Vector::SizeAtCompileTime * sizeof(float));
  return {vectors.empty() ? nullptr : vectors[0].data(),
          vectors.size() * Vector::SizeAtCompileTime};
}

Json make_primitive(const Mesh& mesh, std::int32_t material, GltfBuffer& buffer) {
  Json attributes;
  attributes["POSITION"] = buffer.add_floats(floats(mesh.positions), "VEC3", true, kArrayBuffer);
  if (!mesh.normals.empty()) {
    std::vector<Eigen::Vector3f> normals = mesh.normals;
    for (Eigen::Vector3f& n : normals) {
      const float length = n.norm();
      n = std::isfinite(length) && length > 1e-12F ? Eigen::Vector3f(n / length)
                                                   : Eigen::Vector3f::UnitY();
    }
    attributes["NORMAL"] = buffer.add_floats(floats(normals), "VEC3", false, kArrayBuffer);
  }
  if (!mesh.uvs.empty()) {
    attributes["TEXCOORD_0"] = buffer.add_floats(floats(mesh.uvs), "VEC2", false, kArrayBuffer);
  }
  add_skin_attributes(attributes, buffer, mesh);
  Json primitive;
  primitive["attributes"] = std::move(attributes);
  primitive["indices"] = buffer.add_indices(mesh.triangles);
  primitive["material"] = material;
  return primitive;
}

Json make_skin(const Mesh& mesh, GltfBuffer& buffer) {
  std::vector<float> matrices;
  Json joints = Json::array();
  for (const SkinJoint& s : mesh.skin) {
    joints.push_back(s.joint);
    Eigen::Matrix4d m = s.joint_from_mesh;
    m.row(3) = Eigen::RowVector4d(0, 0, 0, 1);
    for (int k = 0; k < 16; ++k) matrices.push_back(static_cast<float>(m.data()[k]));
  }
  Json skin;
  skin["inverseBindMatrices"] = buffer.add_floats(matrices, "MAT4", false);
  skin["joints"] = std::move(joints);
  return skin;
}

void add_textures(Json& json, const Character& character, GltfBuffer& buffer) {
  for (std::size_t t = 0; t < character.textures.size(); ++t) {
    const Texture& texture = character.textures[t];
    const std::size_t view = buffer.add_view(texture.bytes);
    json["images"].push_back({{"mimeType", texture.mime_type}, {"bufferView", view}});
    json["textures"].push_back({{"source", t}});
  }
}

void add_materials(Json& json, const Character& character) {
  std::vector<Material> materials = character.materials;
  const bool bare = std::any_of(character.meshes.begin(), character.meshes.end(),
                                [](const Mesh& m) { return m.material < 0; });
  if (bare) {
    materials.emplace_back();
    materials.back().name = "default";
  }
  for (const Material& material : materials) {
    Json pbr, out;
    std::array<double, 4> color;
    for (int k = 0; k < 4; ++k) color[k] = std::clamp(double(material.base_color[k]), 0.0, 1.0);
    pbr["baseColorFactor"] = color;
    const std::int32_t texture = material.base_color_texture;
    if (texture >= 0 && texture < static_cast<std::int32_t>(character.textures.size())) {
      pbr["baseColorTexture"]["index"] = texture;
    }
    pbr["metallicFactor"] = 0;
    pbr["roughnessFactor"] = 0.8;
    out["name"] = material.name;
    out["pbrMetallicRoughness"] = std::move(pbr);
    if (color[3] < 0.999) out["alphaMode"] = "BLEND";
    if (material.double_sided) out["doubleSided"] = true;
    json["materials"].push_back(std::move(out));
  }
}

/// Some readers look nodes up by name, so a mesh never takes a joint's.
std::string mesh_node_name(const Mesh& mesh, std::set<std::string>& taken) {
  const std::string base = mesh.name.empty() ? "mesh" : mesh.name;
  std::string name = base;
  for (int n = 1; !taken.insert(name).second; ++n) name = base + "_mesh" + std::to_string(n);
  return name;
}

void add_meshes(Json& json, const Character& character, GltfBuffer& buffer,
                std::vector<std::int32_t>& scene_nodes) {
  std::set<std::string> taken(character.skeleton.names.begin(), character.skeleton.names.end());
  for (const Mesh& mesh : character.meshes) {
    if (mesh.triangles.empty()) continue;
    const std::string name = mesh_node_name(mesh, taken);
    const auto material =
        mesh.material >= 0 ? mesh.material : static_cast<std::int32_t>(character.materials.size());
    Json out;
    out["name"] = name;
    out["primitives"] = Json::array({make_primitive(mesh, material, buffer)});
    Json skin = make_skin(mesh, buffer);
    json["meshes"].push_back(std::move(out));
    json["skins"].push_back(std::move(skin));
    Json node;
    node["name"] = name;
    node["mesh"] = json["meshes"].size() - 1;
    node["skin"] = json["skins"].size() - 1;
    scene_nodes.push_back(static_cast<std::int32_t>(json["nodes"].size()));
    json["nodes"].push_back(std::move(node));
  }
}

/// A skin's joints must share an ancestor; a skeleton with several roots gets one.
void join_roots(Json& json, const Character& character, std::vector<std::int32_t>& scene_nodes) {
  const bool skinned = !character.meshes.empty();
  if (scene_nodes.size() < 2 || !skinned) return;
  std::string name = "root";
  while (character.skeleton.find(name) != kNoJoint) name += "_";
  Json node;
  node["name"] = name;
  node["children"] = scene_nodes;
  scene_nodes = {static_cast<std::int32_t>(json["nodes"].size())};
  json["nodes"].push_back(std::move(node));
}

}  // namespace

Result<GltfTarget> new_document(const Character& character, const GlbOptions& options) {
  for (const Mesh& mesh : character.meshes) {
    std::set<std::int32_t> joints;
    for (const SkinJoint& s : mesh.skin) {
      if (joints.insert(s.joint).second && mesh.skin.size() <= 65536) continue;
      return Error{.code = "character-invalid",
                   .message = "mesh '" + mesh.name + "': a skin names a joint twice, or too many",
                   .joint = character.skeleton.names[s.joint]};
    }
  }
  GltfTarget target;
  Json& json = target.json;
  const Skeleton& skeleton = character.skeleton;
  json["asset"] = {{"version", "2.0"}, {"generator", options.generator}};
  json["scene"] = 0;
  json["scenes"] = Json::array({Json::object()});
  const auto children = children_of(skeleton);
  std::vector<std::int32_t> scene_nodes;
  for (std::int32_t j = 0; j < skeleton.size(); ++j) {
    json["nodes"].push_back(joint_node(skeleton, j, children));
    if (skeleton.parents[j] == kNoJoint) scene_nodes.push_back(j);
    target.space.node_of_joint.push_back(j);
    target.space.metres_per_unit.push_back(1.0);
  }
  join_roots(json, character, scene_nodes);
  GltfBuffer buffer(json, {});
  add_textures(json, character, buffer);
  if (!character.meshes.empty()) add_materials(json, character);
  add_meshes(json, character, buffer, scene_nodes);
  json["scenes"][0]["nodes"] = scene_nodes;
  target.bytes = std::move(buffer).take_bytes();
  return target;
}

}  // namespace limber
