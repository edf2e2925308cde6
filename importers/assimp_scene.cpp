#include "importers/assimp_scene.h"

#include <fmt/format.h>

#include <Eigen/SVD>
#include <algorithm>
#include <set>

#include "importers/failure.h"

namespace limber {
namespace {

constexpr std::string_view kHelperMark = "_$AssimpFbx$_";

NodeKind kind_of(const std::string& name) {
  const auto at = name.find(kHelperMark);
  if (at == std::string::npos) return NodeKind::real;
  return name.compare(at + kHelperMark.size(), 9, "Geometric") == 0 ? NodeKind::geometric
                                                                    : NodeKind::pivot;
}

bool holds_mesh(const aiNode& node) { return node.mNumMeshes > 0; }

}  // namespace

Eigen::Matrix4d to_matrix(const aiMatrix4x4& m) {
  Eigen::Matrix4d out;
  out << m.a1, m.a2, m.a3, m.a4, m.b1, m.b2, m.b3, m.b4, m.c1, m.c2, m.c3, m.c4, m.d1, m.d2, m.d3,
      m.d4;
  return out;
}

std::string to_text(const aiString& s) { return {s.data, s.length}; }

NodeTree::NodeTree(const aiScene& scene) {
  read_nodes(scene);
  attach_helpers();
  for (std::int32_t i = 0; i < size(); ++i) apply_post_rotation(i);
}

void NodeTree::read_nodes(const aiScene& scene) {
  struct Open {
    const aiNode* node;
    std::int32_t parent;
  };
  std::vector<Open> open = {{scene.mRootNode, -1}};
  while (!open.empty()) {
    const Open next = open.back();
    open.pop_back();
    const std::int32_t row = size();
    nodes.push_back(next.node);
    parents.push_back(next.parent);
    names.push_back(to_text(next.node->mName));
    kinds.push_back(kind_of(names.back()));
    local.push_back(to_matrix(next.node->mTransformation));
    if (!local.back().allFinite()) {
      fail("node-not-finite",
           fmt::format("node '{}' has a transform that is not finite", names.back()),
           "re-export the file");
    }
    remember_name(row);
    for (unsigned c = next.node->mNumChildren; c-- > 0;) {
      if (next.node->mChildren[c] != nullptr) open.push_back({next.node->mChildren[c], row});
    }
  }
  post_inverse.assign(nodes.size(), Eigen::Matrix3d::Identity());
  prefix.assign(nodes.size(), Eigen::Matrix4d::Identity());
}

/// assimp tells nodes by name alone. Where a joint and a mesh share one, the joint is meant; where
/// two joints do, nobody knows.
void NodeTree::remember_name(std::int32_t row) {
  const auto [it, fresh] = by_name.emplace(names[row], row);
  if (fresh) return;
  const bool mesh = holds_mesh(*nodes[row]), mesh_before = holds_mesh(*nodes[it->second]);
  if (mesh_before && !mesh) it->second = row;
  if (mesh_before == mesh) ambiguous.insert(names[row]);
}

void NodeTree::attach_helpers() {
  carrier.resize(nodes.size());
  geometric.assign(nodes.size(), Eigen::Matrix4d::Identity());
  for (std::int32_t i = 0; i < size(); ++i) {
    carrier[i] = i;
    if (kinds[i] == NodeKind::real) continue;
    carrier[i] = find(names[i].substr(0, names[i].find(kHelperMark)));
    if (kinds[i] != NodeKind::geometric) continue;
    // Helpers above the real node move its mesh; those below undo that for its children.
    const bool inverse = names[i].ends_with("Inverse");
    if (carrier[i] >= 0 && !inverse) geometric[carrier[i]] = geometric[carrier[i]] * local[i];
    local[i].setIdentity();
  }
}

/// local = ... PreRotation Rotation PostRotation^-1 RotationPivot^-1 ... (FBX SDK reference).
void NodeTree::apply_post_rotation(std::int32_t node) {
  aiVector3D degrees;
  const aiMetadata* metadata = nodes[node]->mMetaData;
  if (kinds[node] != NodeKind::real || metadata == nullptr ||
      !metadata->Get(kHiddenPostRotation, degrees) || degrees.SquareLength() == 0.0F) {
    return;
  }
  const Eigen::Vector3d radians = Eigen::Vector3d(degrees.x, degrees.y, degrees.z) * (M_PI / 180.0);
  const Eigen::Quaterniond post = Eigen::AngleAxisd(radians.z(), Eigen::Vector3d::UnitZ()) *
                                  Eigen::AngleAxisd(radians.y(), Eigen::Vector3d::UnitY()) *
                                  Eigen::AngleAxisd(radians.x(), Eigen::Vector3d::UnitX());
  post_inverse[node] = post.conjugate().toRotationMatrix();
  // In a chain of helpers the place is before the first one that comes after the rotation.
  std::int32_t after = node;
  bool split = false;
  for (std::int32_t i = parents[node]; i >= 0 && carrier[i] == node; i = parents[i]) {
    const std::string part = names[i].substr(names[i].find(kHelperMark) + kHelperMark.size());
    split |= kinds[i] == NodeKind::pivot;
    if (part == "RotationPivotInverse" || part.starts_with("Scaling")) after = i;
  }
  if (split) {
    prefix[after].topLeftCorner<3, 3>() = post_inverse[node];
    local[after] = prefix[after] * local[after];
    return;
  }
  Eigen::Matrix3d linear = local[node].topLeftCorner<3, 3>();
  const Eigen::RowVector3d scale = linear.colwise().norm();
  if (scale.minCoeff() <= 0.0) return;
  for (int k = 0; k < 3; ++k) linear.col(k) /= scale[k];
  local[node].topLeftCorner<3, 3>() = linear * post_inverse[node] * scale.asDiagonal();
}

std::int32_t NodeTree::find(const std::string& name) const {
  const auto it = by_name.find(name);
  return it == by_name.end() ? -1 : it->second;
}

std::vector<Eigen::Matrix4d> NodeTree::world(const std::vector<Eigen::Matrix4d>& locals) const {
  std::vector<Eigen::Matrix4d> out(locals.size());
  for (std::size_t i = 0; i < locals.size(); ++i) {
    out[i] = parents[i] < 0 ? locals[i] : Eigen::Matrix4d(out[parents[i]] * locals[i]);
  }
  return out;
}

namespace {

void require_unambiguous(const NodeTree& tree, const std::string& name) {
  if (tree.ambiguous.count(name) == 0) return;
  fail("assimp-names-shared",
       fmt::format("several nodes are named '{}', and assimp tells nodes by name alone", name),
       "rename the joints, or read the file with --reader auto");
}

std::vector<std::uint8_t> bones_of(const aiScene& scene, const NodeTree& tree) {
  std::vector<std::uint8_t> bones(tree.nodes.size(), 0);
  for (unsigned m = 0; m < scene.mNumMeshes; ++m) {
    const aiMesh& mesh = *scene.mMeshes[m];
    for (unsigned b = 0; b < mesh.mNumBones; ++b) {
      require_unambiguous(tree, to_text(mesh.mBones[b]->mName));
      const std::int32_t node = tree.find(to_text(mesh.mBones[b]->mName));
      if (node >= 0) bones[tree.carrier[node] >= 0 ? tree.carrier[node] : node] = 1;
    }
  }
  return bones;
}

std::vector<std::uint8_t> animated_of(const aiScene& scene, const NodeTree& tree) {
  std::vector<std::uint8_t> animated(tree.nodes.size(), 0);
  for (unsigned a = 0; a < scene.mNumAnimations; ++a) {
    const aiAnimation& animation = *scene.mAnimations[a];
    for (unsigned c = 0; c < animation.mNumChannels; ++c) {
      const std::string name = to_text(animation.mChannels[c]->mNodeName);
      const std::int32_t node = tree.find(name);
      if (node < 0 || tree.carrier[node] < 0) {
        fail("assimp-channel-orphan",
             fmt::format("animation '{}' moves node '{}', which the file does not have",
                         to_text(animation.mName), name),
             "bake the animation onto the joints and export again, or convert the file to GLB");
      }
      require_unambiguous(tree, name);
      animated[tree.carrier[node]] = 1;
    }
  }
  return animated;
}

/// The scene's own root: assimp invents it for most formats.
bool invented_root(const NodeTree& tree, std::string_view format) {
  if (format == "bvh") return false;
  return (format != "gltf" && format != "glb") || tree.names[0] == "ROOT";
}

}  // namespace

JointTree find_joints(const aiScene& scene, const NodeTree& tree, std::string_view format) {
  const std::vector<std::uint8_t> bones = bones_of(scene, tree);
  const std::vector<std::uint8_t> animated = animated_of(scene, tree);
  const bool skinned = std::find(bones.begin(), bones.end(), 1) != bones.end();
  const bool moving = std::find(animated.begin(), animated.end(), 1) != animated.end();
  std::set<std::string> not_joints;
  for (unsigned i = 0; i < scene.mNumCameras; ++i) {
    not_joints.insert(to_text(scene.mCameras[i]->mName));
  }
  for (unsigned i = 0; i < scene.mNumLights; ++i) {
    not_joints.insert(to_text(scene.mLights[i]->mName));
  }
  std::vector<std::uint8_t> wanted(tree.nodes.size(), 0);
  for (std::int32_t i = tree.size() - 1; i >= 0; --i) {
    const bool mesh_only = holds_mesh(*tree.nodes[i]) || not_joints.count(tree.names[i]) > 0;
    const bool bare = !skinned && !moving && !mesh_only;
    const bool moved = animated[i] && !(skinned && mesh_only);
    if (tree.kinds[i] == NodeKind::real && (bones[i] || moved || bare)) wanted[i] = 1;
    if (wanted[i] && tree.parents[i] >= 0) wanted[tree.parents[i]] = 1;
  }
  if (invented_root(tree, format) && !bones[0] && !animated[0]) wanted[0] = 0;

  JointTree joints;
  joints.joint_of_node.assign(tree.nodes.size(), -1);
  for (std::int32_t i = 0; i < tree.size(); ++i) {
    if (!wanted[i] || tree.kinds[i] != NodeKind::real) continue;
    std::int32_t parent = tree.parents[i];
    while (parent >= 0 && joints.joint_of_node[parent] < 0) parent = tree.parents[parent];
    joints.parents.push_back(parent < 0 ? kNoJoint : joints.joint_of_node[parent]);
    joints.joint_of_node[i] = static_cast<std::int32_t>(joints.node_of_joint.size());
    joints.node_of_joint.push_back(i);
    joints.skinned.push_back(bones[i]);
  }
  if (joints.size() == 0) {
    fail("no-skeleton", "the file has no joints: no skin, no animation and no bare nodes",
         "export the armature together with the mesh");
  }
  return joints;
}

Eigen::Matrix4d CanonicalSpace::matrix() const {
  Eigen::Matrix4d m = Eigen::Matrix4d::Identity();
  m.topLeftCorner<3, 3>() = unit_m * canonical_from_file.toRotationMatrix();
  return m;
}

DualQuaternion CanonicalSpace::rigid(const Eigen::Matrix4d& file_from_node) const {
  Eigen::Matrix3d r = file_from_node.topLeftCorner<3, 3>();
  if (r.determinant() < 0.0) r = -r;  // a mirrored node: the rotation of its point reflection
  const Eigen::RowVector3d scale = r.colwise().norm();
  for (int k = 0; k < 3; ++k) {
    if (scale[k] > 0.0) r.col(k) /= scale[k];
  }
  Eigen::Quaterniond rotation(1, 0, 0, 0);
  if ((r.transpose() * r).isIdentity(1e-6)) {
    rotation = Eigen::Quaterniond(r).normalized();
  } else if (scale.minCoeff() > 0.0) {  // sheared: the nearest rotation (polar decomposition)
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(r, Eigen::ComputeFullU | Eigen::ComputeFullV);
    rotation = Eigen::Quaterniond(Eigen::Matrix3d(svd.matrixU() * svd.matrixV().transpose()));
    rotation.normalize();
  }
  const Eigen::Vector3d place = file_from_node.topRightCorner<3, 1>();
  return DualQuaternion::from_rotation_translation((canonical_from_file * rotation).normalized(),
                                                   unit_m * (canonical_from_file * place))
      .normalized();
}

std::vector<DualQuaternion> fold_pose(const JointTree& joints,
                                      const std::vector<Eigen::Matrix4d>& world,
                                      const CanonicalSpace& space) {
  std::vector<DualQuaternion> model, local;
  for (std::int32_t j = 0; j < joints.size(); ++j) {
    model.push_back(space.rigid(world[joints.node_of_joint[j]]));
    const std::int32_t parent = joints.parents[j];
    local.push_back(parent == kNoJoint ? model[j]
                                       : (model[parent].conjugate() * model[j]).normalized());
  }
  return local;
}

}  // namespace limber
