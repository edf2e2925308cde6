#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <map>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "assets/model/character.h"
#include "importers/importer.h"
#include "importers/json_view.h"

/// Internal to the glTF reader. All of it fails by throwing Failure (see failure.h).
namespace limber::gltf {

inline constexpr std::size_t kMaxNodes = 65536;

/// An accessor's elements, decoded: normalised integers become floats, sparse values are in place.
struct Accessor {
  std::size_t count = 0;
  std::size_t components = 0;
  bool integers = false;  ///< stored as integers and not normalised
  std::vector<double> values;

  std::span<const double> element(std::size_t i) const {
    return {values.data() + i * components, components};
  }
};

class Document {
 public:
  /// Opens the container, parses, refuses what cannot be honoured, and resolves the buffers.
  Document(std::span<const std::byte> bytes, const UriResolver&, Warnings&);

  JsonView root() const { return {json_, "gltf-invalid"}; }
  /// Member `index` of a top-level array.
  JsonView item(const char* collection, std::int64_t index) const;
  std::size_t count(const char* collection) const;
  /// A member that is an index into a top-level array; -1 where it is absent.
  std::int64_t index_of(const JsonView& owner, const char* key, const char* collection) const;

  /// `types` are the allowed ones, such as {"VEC3"}. Non-finite values fail unless allowed.
  const Accessor& accessor(std::int64_t index, std::initializer_list<std::string_view> types,
                           bool allow_non_finite = false);
  std::span<const std::byte> buffer_view(std::int64_t index) const;

  bool is_glb() const { return is_glb_; }
  /// Gives up the text and the buffers; the document is of no use afterwards.
  void move_into(GltfDocument&);

 private:
  void open_glb(std::span<const std::byte> bytes, Warnings&);
  void check_header() const;
  void load_buffers(const UriResolver&);
  Accessor decode(const JsonView& view, bool allow_non_finite) const;
  void decode_sparse(const JsonView& view, const JsonView& sparse, Accessor&) const;

  bool is_glb_ = false;
  bool has_bin_ = false;
  std::string text_;
  nlohmann::json json_;
  std::vector<std::byte> bin_;
  std::vector<std::vector<std::byte>> buffers_;
  std::unordered_map<std::int64_t, Accessor> accessors_;
};

/// One glTF node; its rest transform as translation, rotation, scale.
struct Node {
  std::string name;
  std::int32_t parent = -1;
  std::vector<std::int32_t> children;
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  Eigen::Quaterniond rotation{1, 0, 0, 0};
  Eigen::Vector3d scale = Eigen::Vector3d::Ones();
  std::int64_t mesh = -1;
  std::int64_t skin = -1;
};

struct Skin {
  std::vector<std::int32_t> joints;            ///< nodes
  std::vector<Eigen::Matrix4d> inverse_binds;  ///< empty: none in the file
};

/// Nodes and skins, checked: a forest, all indices in range.
struct Scene {
  std::vector<Node> nodes;
  std::vector<Skin> skins;
  std::vector<std::string> vrm_roles;  ///< [node] VRM 1.0 humanoid name or ""
  bool is_vrm = false;
};
Scene read_scene(Document&, Warnings&);
Eigen::Matrix4d local_matrix(const Node&);

/// The nodes that became joints, and the scale that was folded out of them.
struct Joints {
  std::vector<std::int32_t> node_of_joint;
  std::vector<std::int32_t> joint_of_node;  ///< -1: not in the skeleton
  std::vector<double> parent_scale;         ///< [joint] product of the ancestors' scales
  std::vector<Eigen::Vector3d> own_scale;   ///< [joint]
  /// metres per file unit and the turn to +Y up
  double unit_m = 1.0;
  Eigen::Quaterniond canonical_from_file{1, 0, 0, 0};

  /// Canonical parent_from_joint of a joint's translation and rotation in the file.
  DualQuaternion local(const Skeleton&, std::int32_t joint, const Eigen::Vector3d& translation,
                       const Eigen::Quaterniond& rotation) const;
  /// Affine: what a joint's scale does to points given in its file space.
  Eigen::Matrix4d joint_from_file_joint(std::int32_t joint) const;
};
Joints build_skeleton(Document&, const Scene&, const ImportOptions&, Character&, Warnings&);
void build_bind_pose(const Scene&, const Joints&, Character&);

void build_meshes(Document&, const Scene&, const Joints&, Character&, Warnings&);
void build_materials(Document&, const UriResolver&, Character&, Warnings&);

/// What the clips are sampled from, before any densifying.
struct RawTiming {
  double rate_hz = 0.0;
  std::int64_t frames = 0;
};
std::vector<Clip> build_clips(Document&, const Scene&, const Joints&, const Skeleton&,
                              RawTiming& first, Warnings&);
/// Nodes whose translation, rotation or scale some animation drives.
std::vector<std::int32_t> animated_nodes(Document&);

}  // namespace limber::gltf
