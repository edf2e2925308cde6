#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "assets/model/clip.h"
#include "assets/model/mesh.h"
#include "assets/model/skeleton.h"

namespace limber {

/// The untouched glTF document of a character, kept so that an export can patch it instead of
/// building it anew, and what import did to bring it into canonical space.
struct GltfDocument {
  std::string json;                             ///< the JSON chunk or .gltf text, verbatim
  std::vector<std::vector<std::byte>> buffers;  ///< resolved, by buffer index
  bool binary_chunk = false;                    ///< buffer 0 is the GLB's own BIN chunk
  std::map<std::string, std::vector<std::byte>> external_images;  ///< by URI, as written
  std::vector<std::int32_t> node_of_joint;  ///< glTF node of each skeleton joint
  /// World scale above each joint (its ancestors' product), folded out at import:
  /// file translation = canonical translation / (unit_m * parent_scale).
  std::vector<double> parent_scale;
  double unit_m = 1.0;                                 ///< metres per file unit
  Eigen::Quaterniond canonical_from_file{1, 0, 0, 0};  ///< turns the file's up axis to +Y; on roots
};

/// A skinned figure, or a bare skeleton: what a file holds besides its clips.
struct Character {
  std::string name;
  Skeleton skeleton;
  std::vector<std::uint8_t> deforming;  ///< [joint] 1: a skin uses it (all 1 where no skin is)
  std::vector<std::string> roles;  ///< [joint] VRM 1.0 humanoid name the file itself gives, or ""
  /// model_from_joint at binding; empty where the file has no skin. Joints outside every skin
  /// follow their parent by their rest pose.
  std::vector<DualQuaternion> bind_model_from_joint;
  std::vector<Mesh> meshes;
  std::vector<Material> materials;
  std::vector<Texture> textures;
  std::vector<std::string> morph_targets;  ///< names; their shapes stay in the document
  bool has_document = false;
  GltfDocument document;  ///< valid where has_document
};

/// Checks the skeleton, index ranges, weights and array sizes. Error: `character-invalid`.
Result<void> validate(const Character&);

}  // namespace limber
