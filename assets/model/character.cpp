#include "assets/model/character.h"

#include <cmath>

namespace limber {
namespace {

Result<void> validate_mesh(const Mesh& mesh, const Character& character) {
  const auto invalid = [&](std::string message) {
    return Error{.code = "character-invalid",
                 .message = "mesh '" + mesh.name + "': " + message,
                 .hint = "re-export the mesh"};
  };
  const std::size_t n = mesh.positions.size();
  if (!mesh.normals.empty() && mesh.normals.size() != n) return invalid("normals do not match");
  if (!mesh.uvs.empty() && mesh.uvs.size() != n) return invalid("texture coordinates do not match");
  if (mesh.triangles.size() % 3 != 0) return invalid("triangles are cut");
  for (const std::uint32_t index : mesh.triangles) {
    if (index >= n) return invalid("a triangle points beyond the vertices");
  }
  if (mesh.influence_begin.size() != n + 1 || mesh.influence_begin[0] != 0 ||
      mesh.influence_begin[n] != mesh.influences.size()) {
    return invalid("skin weights do not match");
  }
  for (std::size_t v = 0; v < n; ++v) {
    if (!mesh.positions[v].allFinite()) return invalid("a vertex is not finite");
    if (mesh.influence_begin[v] >= mesh.influence_begin[v + 1]) {
      return invalid("a vertex hangs on no joint");
    }
    double sum = 0.0;
    for (std::uint32_t i = mesh.influence_begin[v]; i < mesh.influence_begin[v + 1]; ++i) {
      if (mesh.influences[i].skin_joint >= mesh.skin.size()) return invalid("bad skin joint");
      if (!(mesh.influences[i].weight >= 0.0F)) return invalid("a negative skin weight");
      sum += mesh.influences[i].weight;
    }
    if (std::abs(sum - 1.0) > 1e-3) return invalid("a vertex's weights do not sum to one");
  }
  for (const SkinJoint& s : mesh.skin) {
    if (s.joint < 0 || s.joint >= character.skeleton.size()) return invalid("bad skin joint");
    if (!s.joint_from_mesh.allFinite()) return invalid("an inverse bind matrix is not finite");
  }
  const auto materials = static_cast<std::int32_t>(character.materials.size());
  if (mesh.material < -1 || mesh.material >= materials) return invalid("bad material");
  return {};
}

}  // namespace

Result<void> validate(const Character& character) {
  if (auto r = validate(character.skeleton); !r) return r;
  const std::size_t n = character.skeleton.parents.size();
  if (character.deforming.size() != n || character.roles.size() != n ||
      (!character.bind_model_from_joint.empty() && character.bind_model_from_joint.size() != n)) {
    return Error{.code = "character-invalid", .message = "the joint arrays differ in length"};
  }
  for (const Mesh& mesh : character.meshes) {
    if (auto r = validate_mesh(mesh, character); !r) return r;
  }
  return {};
}

}  // namespace limber
