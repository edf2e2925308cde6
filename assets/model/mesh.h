#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "assets/model/dual_quaternion.h"

namespace limber {

/// One joint that a mesh hangs on. `joint_from_mesh` is the inverse bind matrix, affine: it also
/// holds every scale between the file's mesh space and the canonical metres of the joint.
struct SkinJoint {
  std::int32_t joint = 0;  ///< row in the skeleton
  Eigen::Matrix4d joint_from_mesh = Eigen::Matrix4d::Identity();
};

struct Influence {
  std::uint32_t skin_joint = 0;  ///< row in Mesh::skin
  float weight = 0.0F;           ///< >= 0; a vertex's weights sum to one
};

/// Triangles of one material, skinned (an unskinned part hangs on one joint with weight one).
/// Posed vertex = sum_i weight_i * model_from_joint_i * joint_from_mesh_i * position.
struct Mesh {
  std::string name;
  std::vector<Eigen::Vector3f> positions;      ///< mesh space, as the file has them
  std::vector<Eigen::Vector3f> normals;        ///< unit, mesh space; empty or one per position
  std::vector<Eigen::Vector2f> uvs;            ///< empty or one per position; v runs down (glTF)
  std::vector<std::uint32_t> triangles;        ///< three indices each
  std::vector<std::uint32_t> influence_begin;  ///< positions + 1 offsets into influences
  std::vector<Influence> influences;
  std::vector<SkinJoint> skin;
  std::int32_t material = -1;  ///< row in Character::materials; -1: default grey
};

/// An encoded picture (PNG or JPEG) as the file has it.
struct Texture {
  std::string mime_type;
  std::vector<std::byte> bytes;
};

struct Material {
  std::string name;
  Eigen::Vector4f base_color{0.8F, 0.8F, 0.8F, 1.0F};  ///< linear RGBA
  std::int32_t base_color_texture = -1;                ///< row in Character::textures
  bool double_sided = false;
};

/// Linear-blend-skinned positions in model space, metres. `out` has one entry per position.
void skin_positions(const Mesh&, std::span<const DualQuaternion> model_from_joint,
                    std::span<Eigen::Vector3f> out);

}  // namespace limber
