#pragma once

#include <assimp/scene.h>

#include <Eigen/Core>
#include <assimp/Importer.hpp>
#include <cstdint>
#include <memory>
#include <set>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "importers/importer.h"

namespace limber {

/// Parses the bytes with the one assimp importer that `format` names (fbx, dae, bvh, gltf, glb).
/// Fails with `assimp-rejected` or `fbx-version-unsupported`. The scene lives as long as
/// `importer`.
const aiScene* load_assimp_scene(Assimp::Importer& importer, std::span<const std::byte> bytes,
                                 std::string_view format, const UriResolver&, const ImportOptions&);

/// What load_assimp_scene renames FBX's property PostRotation to.
inline constexpr const char* kHiddenPostRotation = "PostRotatio_";

Eigen::Matrix4d to_matrix(const aiMatrix4x4&);
std::string to_text(const aiString&);

/// What a node is for. assimp splits an FBX node with pivots into a chain of helpers
/// `NAME_$AssimpFbx$_...` above the real node NAME.
enum class NodeKind : std::uint8_t { real, pivot, geometric };

/// assimp's node hierarchy as parents-first arrays, affine and in file space.
struct NodeTree {
  std::vector<const aiNode*> nodes;
  std::vector<std::int32_t> parents;
  std::vector<NodeKind> kinds;
  std::vector<std::string> names;
  std::vector<std::int32_t>
      carrier;  ///< [node] the real node that a helper belongs to; else itself
  std::vector<Eigen::Matrix4d> local;  ///< rest; geometric helpers, which move meshes only, removed
  std::vector<Eigen::Matrix4d> geometric;  ///< [node] what moves this node's meshes
  /// [node] inverse of an FBX node's PostRotation, which belongs between its rotation and scale.
  std::vector<Eigen::Matrix3d> post_inverse;
  /// [node] the same where the node is split into helpers: stands before this one's own transform.
  std::vector<Eigen::Matrix4d> prefix;
  std::unordered_map<std::string, std::int32_t> by_name;
  std::set<std::string> ambiguous;  ///< names that two nodes of one kind share

  explicit NodeTree(const aiScene&);
  std::int32_t size() const { return static_cast<std::int32_t>(nodes.size()); }
  std::int32_t find(const std::string& name) const;  ///< -1 where there is none
  /// file_from_node of every node.
  std::vector<Eigen::Matrix4d> world(const std::vector<Eigen::Matrix4d>& local) const;

 private:
  void read_nodes(const aiScene&);
  void remember_name(std::int32_t row);
  void attach_helpers();
  void apply_post_rotation(std::int32_t node);
};

/// Which nodes are joints, and how their affine transforms become rigid and canonical.
struct JointTree {
  std::vector<std::int32_t> node_of_joint;  ///< parents first
  std::vector<std::int32_t> joint_of_node;  ///< -1: none
  std::vector<std::int32_t> parents;        ///< [joint]
  std::vector<std::uint8_t> skinned;        ///< [joint] a mesh is weighted to it

  std::int32_t size() const { return static_cast<std::int32_t>(parents.size()); }
};

/// Bones, animated nodes and their ancestors; where a file has neither, all nodes without mesh.
/// Fails with `no-skeleton`; where a channel's node is missing, `assimp-channel-orphan`; where a
/// name does not tell which node is meant, `assimp-names-shared`.
JointTree find_joints(const aiScene&, const NodeTree&, std::string_view format);

/// canonical = unit_m * rotation * file.
struct CanonicalSpace {
  double unit_m = 1.0;
  Eigen::Quaterniond canonical_from_file{1, 0, 0, 0};

  Eigen::Matrix4d matrix() const;
  /// The rigid part of canonical_from_file * file_from_node: its place and its nearest rotation.
  DualQuaternion rigid(const Eigen::Matrix4d& file_from_node) const;
};

/// Canonical parent_from_joint of every joint. Scale is folded: joints stand where the file puts
/// them, whatever scale their ancestors have.
std::vector<DualQuaternion> fold_pose(const JointTree&, const std::vector<Eigen::Matrix4d>& world,
                                      const CanonicalSpace&);

/// Meshes, materials, textures and the bind pose, all into `character` (whose skeleton is there).
void read_assimp_figure(const aiScene&, const NodeTree&, const JointTree&, const CanonicalSpace&,
                        std::string_view format, const UriResolver&, Character&, Warnings&);

/// The animations that move joints, sampled at the file's rate: FBX and BVH state it, other formats
/// show it in the spacing of their keys.
std::vector<Clip> read_assimp_clips(const aiScene&, const NodeTree&, const JointTree&,
                                    const CanonicalSpace&, std::string_view format, Warnings&);

}  // namespace limber
