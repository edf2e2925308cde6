#include <assimp/material.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>

#include "importers/assimp_scene.h"

namespace limber {
namespace {

/// Reads one scene's meshes; keeps what several of them share.
class FigureReader {
 public:
  FigureReader(const aiScene& scene, const NodeTree& tree, const JointTree& joints,
               const CanonicalSpace& space, std::string_view format, const UriResolver& resolver,
               Character& character, Warnings& warnings)
      : scene_(scene),
        tree_(tree),
        joints_(joints),
        canonical_from_file_(space.matrix()),
        space_(space),
        format_(format),
        resolver_(resolver),
        character_(character),
        warnings_(warnings),
        world_(tree.world(tree.local)) {
    for (const std::int32_t node : joints.node_of_joint) {
      const DualQuaternion joint = space.rigid(world_[node]);
      model_from_rest_.push_back(joint);
      // What the rigid joint leaves of its node's affine transform: scale, shear, the unit.
      joint_from_node_.push_back(joint.conjugate().matrix() * canonical_from_file_ * world_[node]);
    }
  }

  void read() {
    read_materials();
    for (std::int32_t node = 0; node < tree_.size(); ++node) {
      for (unsigned m = 0; m < tree_.nodes[node]->mNumMeshes; ++m) {
        const unsigned index = tree_.nodes[node]->mMeshes[m];
        if (index < scene_.mNumMeshes) read_mesh(*scene_.mMeshes[index], node);
      }
    }
    set_bind_pose();
  }

 private:
  void warn(std::string code, std::string message) {
    warnings_.push_back({.code = std::move(code), .message = std::move(message)});
  }

  // ---- materials

  std::int32_t add_texture(Texture texture, const std::string& name) {
    const auto starts = [&](std::string_view magic) {
      return texture.bytes.size() > magic.size() &&
             std::memcmp(texture.bytes.data(), magic.data(), magic.size()) == 0;
    };
    texture.mime_type = starts("\x89PNG")        ? "image/png"
                        : starts("\xFF\xD8\xFF") ? "image/jpeg"
                                                 : "";
    if (texture.mime_type.empty()) {
      warn("texture-format", fmt::format("texture '{}' is neither PNG nor JPEG: left out", name));
      return -1;
    }
    character_.textures.push_back(std::move(texture));
    return static_cast<std::int32_t>(character_.textures.size()) - 1;
  }

  /// Embedded, beside the file, or beside the file under its last name (artists' absolute paths).
  std::int32_t read_texture(const std::string& path) {
    if (const auto known = textures_.find(path); known != textures_.end()) return known->second;
    std::int32_t& row = textures_[path];
    row = -1;
    if (const aiTexture* embedded = scene_.GetEmbeddedTexture(path.c_str())) {
      if (embedded->mHeight != 0) {
        warn("texture-format", fmt::format("texture '{}' holds raw pixels: left out", path));
        return -1;
      }
      const auto* bytes = reinterpret_cast<const std::byte*>(embedded->pcData);
      return row = add_texture({"", {bytes, bytes + embedded->mWidth}}, path);
    }
    const std::string last = path.substr(path.find_last_of("/\\") + 1);
    for (const std::string& uri : {path, last}) {
      if (!resolver_ || uri.empty()) continue;
      if (auto found = resolver_(uri)) return row = add_texture({"", std::move(*found)}, path);
    }
    warn("texture-missing", fmt::format("texture '{}' is not beside the file", path));
    return -1;
  }

  void read_materials() {
    for (unsigned m = 0; m < scene_.mNumMaterials; ++m) {
      const aiMaterial& in = *scene_.mMaterials[m];
      Material out;
      aiString text;
      if (in.Get(AI_MATKEY_NAME, text) == aiReturn_SUCCESS) out.name = to_text(text);
      aiColor4D color;
      float opacity = 1.0F;
      if (in.Get(AI_MATKEY_BASE_COLOR, color) == aiReturn_SUCCESS ||
          in.Get(AI_MATKEY_COLOR_DIFFUSE, color) == aiReturn_SUCCESS) {
        out.base_color = {color.r, color.g, color.b, color.a};
      }
      if (in.Get(AI_MATKEY_OPACITY, opacity) == aiReturn_SUCCESS && opacity > 0.0F) {
        out.base_color[3] *= opacity;
      }
      if (!out.base_color.allFinite()) out.base_color = Material().base_color;
      int two_sided = 0;
      in.Get(AI_MATKEY_TWOSIDED, two_sided);
      out.double_sided = two_sided != 0;
      if (in.GetTexture(aiTextureType_DIFFUSE, 0, &text) == aiReturn_SUCCESS ||
          in.GetTexture(aiTextureType_BASE_COLOR, 0, &text) == aiReturn_SUCCESS) {
        out.base_color_texture = read_texture(to_text(text));
        if (out.base_color_texture >= 0 && format_ != "gltf" && format_ != "glb") {
          out.base_color.head<3>().setOnes();  // FBX and Collada replace the colour
        }
      }
      character_.materials.push_back(std::move(out));
    }
  }

  // ---- meshes

  void read_mesh(const aiMesh& in, std::int32_t node) {
    if (in.mNumVertices == 0 || in.mNumFaces == 0) return;
    Mesh mesh;
    mesh.name = to_text(in.mName).empty() ? tree_.names[node] : to_text(in.mName);
    if (!read_vertices(in, mesh)) {
      warn("mesh-invalid",
           fmt::format("mesh '{}' has vertices that are not finite: left out", mesh.name));
      return;
    }
    for (unsigned f = 0; f < in.mNumFaces; ++f) {
      const aiFace& face = in.mFaces[f];
      if (face.mNumIndices != 3) continue;
      const unsigned* i = face.mIndices;
      if (std::max({i[0], i[1], i[2]}) >= in.mNumVertices) continue;
      mesh.triangles.insert(mesh.triangles.end(), {i[0], i[1], i[2]});
    }
    if (in.mMaterialIndex < scene_.mNumMaterials) {
      mesh.material = static_cast<std::int32_t>(in.mMaterialIndex);
    }
    if (in.mNumBones > 0 ? !skin(in, node, mesh) : !hang(node, mesh)) return;
    character_.meshes.push_back(std::move(mesh));
  }

  static bool read_vertices(const aiMesh& in, Mesh& mesh) {
    for (unsigned v = 0; v < in.mNumVertices; ++v) {
      mesh.positions.push_back({in.mVertices[v].x, in.mVertices[v].y, in.mVertices[v].z});
      if (!mesh.positions.back().allFinite()) return false;
      if (in.HasNormals()) {
        Eigen::Vector3f n(in.mNormals[v].x, in.mNormals[v].y, in.mNormals[v].z);
        n.stableNormalize();
        if (!n.allFinite() || n.isZero()) n = Eigen::Vector3f::UnitY();
        mesh.normals.push_back(n);
      }
      if (in.HasTextureCoords(0)) {
        mesh.uvs.push_back({in.mTextureCoords[0][v].x, in.mTextureCoords[0][v].y});
        if (!mesh.uvs.back().allFinite()) mesh.uvs.back().setZero();
      }
    }
    return true;
  }

  /// An unskinned part follows the nearest joint above it.
  bool hang(std::int32_t node, Mesh& mesh) {
    std::int32_t above = node;
    while (above >= 0 && joints_.joint_of_node[above] < 0) above = tree_.parents[above];
    if (above < 0) {
      warn("mesh-not-skinned", fmt::format("mesh '{}' hangs on no joint: left out", mesh.name));
      return false;
    }
    const std::int32_t joint = joints_.joint_of_node[above];
    mesh.skin.push_back(
        {joint, affine(model_from_rest_[joint].conjugate().matrix() * canonical_from_file_ *
                       world_[node] * tree_.geometric[node])});
    for (std::size_t v = 0; v <= mesh.positions.size(); ++v) {
      mesh.influence_begin.push_back(static_cast<std::uint32_t>(v));
      if (v < mesh.positions.size()) mesh.influences.push_back({0, 1.0F});
    }
    return true;
  }

  static Eigen::Matrix4d affine(Eigen::Matrix4d m) {
    m.row(3) = Eigen::RowVector4d(0, 0, 0, 1);
    return m;
  }

  bool skin(const aiMesh& in, std::int32_t node, Mesh& mesh) {
    std::vector<std::vector<Influence>> influences(mesh.positions.size());
    std::map<std::int32_t, std::uint32_t> row_of_joint;
    bool broken = false;
    for (unsigned b = 0; b < in.mNumBones; ++b) {
      const aiBone& bone = *in.mBones[b];
      const std::int32_t at = tree_.find(to_text(bone.mName));
      const std::int32_t joint =
          at < 0 ? -1 : joints_.joint_of_node[std::max(0, tree_.carrier[at])];
      const Eigen::Matrix4d node_from_mesh = affine(to_matrix(bone.mOffsetMatrix));
      if (joint < 0 || !node_from_mesh.allFinite()) {
        broken = true;
        continue;
      }
      const auto [it, fresh] =
          row_of_joint.emplace(joint, static_cast<std::uint32_t>(mesh.skin.size()));
      if (fresh) mesh.skin.push_back({joint, affine(joint_from_node_[joint] * node_from_mesh)});
      if (std::abs(node_from_mesh.determinant()) > 1e-30) {
        offsets_.push_back({joint, node, node_from_mesh.inverse()});
      }
      for (unsigned w = 0; w < bone.mNumWeights; ++w) {
        const aiVertexWeight& weight = bone.mWeights[w];
        if (!std::isfinite(weight.mWeight) || weight.mWeight < 0.0F ||
            weight.mVertexId >= influences.size()) {
          broken = true;
        } else if (weight.mWeight > 0.0F) {
          influences[weight.mVertexId].push_back({it->second, weight.mWeight});
        }
      }
    }
    if (broken) {
      warn("weights-invalid",
           fmt::format("mesh '{}': weights that are not numbers, negative, or on no joint or "
                       "vertex were dropped",
                       mesh.name));
    }
    if (mesh.skin.empty()) return hang(node, mesh);
    set_weights(influences, mesh);
    return true;
  }

  void set_weights(const std::vector<std::vector<Influence>>& influences, Mesh& mesh) {
    std::int64_t unbound = 0, unequal = 0;
    const std::uint32_t stand_in = topmost_row(mesh);
    for (const std::vector<Influence>& vertex : influences) {
      mesh.influence_begin.push_back(static_cast<std::uint32_t>(mesh.influences.size()));
      double sum = 0.0;
      for (const Influence& i : vertex) sum += i.weight;
      if (!(sum > 1e-8)) {
        ++unbound;
        mesh.influences.push_back({stand_in, 1.0F});
        continue;
      }
      unequal += std::abs(sum - 1.0) > 0.01;
      for (const Influence& i : vertex) {
        mesh.influences.push_back({i.skin_joint, static_cast<float>(i.weight / sum)});
      }
    }
    mesh.influence_begin.push_back(static_cast<std::uint32_t>(mesh.influences.size()));
    if (unbound > 0) {
      warn("weights-missing",
           fmt::format("mesh '{}': {} of {} vertices have no weight and follow the skin's first "
                       "joint",
                       mesh.name, unbound, influences.size()));
    }
    if (unequal > 0) {
      warn("weights-normalised",
           fmt::format("mesh '{}': the weights of {} of {} vertices did not sum to one", mesh.name,
                       unequal, influences.size()));
    }
  }

  /// The skin's topmost joint carries vertices without weights.
  static std::uint32_t topmost_row(const Mesh& mesh) {
    const auto top =
        std::min_element(mesh.skin.begin(), mesh.skin.end(),
                         [](const SkinJoint& a, const SkinJoint& b) { return a.joint < b.joint; });
    return static_cast<std::uint32_t>(top - mesh.skin.begin());
  }

  // ---- bind pose

  struct Offset {
    std::int32_t joint, node;
    Eigen::Matrix4d mesh_from_node;
  };

  /// Where a mesh stood at binding. FBX: its node. Collada and glTF define skins apart from the
  /// mesh's node, and assimp folds the bind shape matrix away; taken is what brings the bones
  /// nearer to their rest.
  bool bound_at_node() const {
    if (format_ == "fbx") return true;
    double by_node = 0.0, by_origin = 0.0;
    for (const Offset& o : offsets_) {
      const DualQuaternion rest = model_from_rest_[o.joint];
      by_node += distance(rest, space_.rigid(mesh_node(o) * o.mesh_from_node));
      by_origin += distance(rest, space_.rigid(o.mesh_from_node));
    }
    return by_node < by_origin;
  }

  Eigen::Matrix4d mesh_node(const Offset& o) const {
    return world_[o.node] * tree_.geometric[o.node];
  }

  static double distance(const DualQuaternion& a, const DualQuaternion& b) {
    return (a.translation() - b.translation()).norm() +
           0.3 * rotation_angle(a.rotation(), b.rotation());
  }

  /// Meshes may disagree: each joint takes the one that is nearest to all the others.
  void set_bind_pose() {
    if (offsets_.empty()) return;
    const bool at_node = bound_at_node();
    std::vector<std::vector<DualQuaternion>> candidates(joints_.parents.size());
    for (const Offset& o : offsets_) {
      const DualQuaternion bind = space_.rigid(
          at_node ? Eigen::Matrix4d(mesh_node(o) * o.mesh_from_node) : o.mesh_from_node);
      if (bind.real.coeffs().allFinite() && bind.dual.coeffs().allFinite()) {
        candidates[o.joint].push_back(bind);
      }
    }
    std::vector<DualQuaternion> bind(candidates.size());
    for (std::int32_t j = 0; j < joints_.size(); ++j) {
      const std::int32_t parent = joints_.parents[j];
      const DualQuaternion& rest = character_.skeleton.rest_parent_from_joint[j];
      bind[j] = parent == kNoJoint ? rest : (bind[parent] * rest).normalized();
      double best = std::numeric_limits<double>::infinity();
      for (const DualQuaternion& a : candidates[j]) {
        double sum = 0.0;
        for (const DualQuaternion& b : candidates[j]) sum += distance(a, b);
        if (sum < best) {
          best = sum;
          bind[j] = a;
        }
      }
    }
    character_.bind_model_from_joint = std::move(bind);
  }

  const aiScene& scene_;
  const NodeTree& tree_;
  const JointTree& joints_;
  const Eigen::Matrix4d canonical_from_file_;
  const CanonicalSpace& space_;
  std::string_view format_;
  const UriResolver& resolver_;
  Character& character_;
  Warnings& warnings_;
  std::vector<Eigen::Matrix4d> world_;
  std::vector<DualQuaternion> model_from_rest_;
  std::vector<Eigen::Matrix4d> joint_from_node_;
  std::vector<Offset> offsets_;
  std::map<std::string, std::int32_t> textures_;
};

}  // namespace

void read_assimp_figure(const aiScene& scene, const NodeTree& tree, const JointTree& joints,
                        const CanonicalSpace& space, std::string_view format,
                        const UriResolver& resolver, Character& character, Warnings& warnings) {
  FigureReader(scene, tree, joints, space, format, resolver, character, warnings).read();
}

}  // namespace limber
