#include "validation/figure_model.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <numeric>
#include <unordered_map>

namespace limber {
namespace {

float display_to_linear(float s) {
  return s <= 0.04045F ? s / 12.92F : std::pow((s + 0.055F) / 1.055F, 2.4F);
}

/// Normals of a mesh without any: area-weighted over all triangles that meet in one place, so that
/// seams of the texture do not show.
std::vector<Eigen::Vector3f> smooth_normals(const Mesh& mesh) {
  struct Hash {
    std::size_t operator()(const std::array<std::uint32_t, 3>& k) const {
      return k[0] * 73856093U ^ k[1] * 19349663U ^ k[2] * 83492791U;
    }
  };
  std::unordered_map<std::array<std::uint32_t, 3>, std::uint32_t, Hash> first_at;
  std::vector<std::uint32_t> place(mesh.positions.size());
  for (std::uint32_t i = 0; i < mesh.positions.size(); ++i) {
    std::array<std::uint32_t, 3> bits;
    std::memcpy(bits.data(), mesh.positions[i].data(), sizeof bits);
    place[i] = first_at.emplace(bits, i).first->second;
  }
  std::vector<Eigen::Vector3f> sum(mesh.positions.size(), Eigen::Vector3f::Zero());
  for (std::size_t t = 0; t + 2 < mesh.triangles.size(); t += 3) {
    const std::uint32_t* k = &mesh.triangles[t];
    const Eigen::Vector3f n = (mesh.positions[k[1]] - mesh.positions[k[0]])
                                  .cross(mesh.positions[k[2]] - mesh.positions[k[0]]);
    for (int c = 0; c < 3; ++c) sum[place[k[c]]] += n;
  }
  std::vector<Eigen::Vector3f> normals(mesh.positions.size());
  for (std::size_t i = 0; i < normals.size(); ++i) normals[i] = sum[place[i]].stableNormalized();
  return normals;
}

/// A figure of one or two colours, as mannequins are: it may be coloured by side.
bool is_plain(const Character& character) {
  for (const Material& material : character.materials) {
    if (material.base_color_texture >= 0) return false;
  }
  return character.materials.size() <= 2;
}

/// How near a vertex is to a tinted joint that moves it: 1 at the joint, 0 from the radius on.
struct Patch {
  std::int32_t joint, parent;
  Eigen::Vector3f centre;
  float radius;
};

std::vector<Patch> patches_of(const Character& character, std::span<const std::uint8_t> tinted) {
  const std::vector<DualQuaternion> rest = rest_model(character);
  double size = 0.0;
  for (const DualQuaternion& q : rest) {
    size = std::max(size, (q.translation() - rest[0].translation()).norm());
  }
  std::vector<Patch> patches;
  for (std::int32_t j = 0; j < character.skeleton.size(); ++j) {
    if (!tinted[j]) continue;
    double shortest = 0.12 * size;
    for (std::int32_t k = 0; k < character.skeleton.size(); ++k) {
      const std::int32_t parent = character.skeleton.parents[k];
      if (parent == kNoJoint || (k != j && parent != j)) continue;
      const double length = (rest[k].translation() - rest[parent].translation()).norm();
      if (length > 0.01 * size) shortest = std::min(shortest, length);
    }
    patches.push_back({j, character.skeleton.parents[j], rest[j].translation().cast<float>(),
                       static_cast<float>(0.6 * shortest)});
  }
  return patches;
}

/// The triangles whose corners all hang mostly on the given joints.
std::vector<std::uint32_t> cropped(const Mesh& mesh, const std::vector<std::uint8_t>& joints) {
  std::vector<float> inside(mesh.positions.size(), 0.0F);
  for (std::size_t v = 0; v < inside.size(); ++v) {
    for (std::uint32_t i = mesh.influence_begin[v]; i < mesh.influence_begin[v + 1]; ++i) {
      const Influence& influence = mesh.influences[i];
      if (joints[mesh.skin[influence.skin_joint].joint]) inside[v] += influence.weight;
    }
  }
  std::vector<std::uint32_t> kept;
  for (std::size_t t = 0; t + 2 < mesh.triangles.size(); t += 3) {
    const std::uint32_t* k = &mesh.triangles[t];
    if (std::min({inside[k[0]], inside[k[1]], inside[k[2]]}) >= 0.5F) {
      kept.insert(kept.end(), k, k + 3);
    }
  }
  return kept;
}

}  // namespace

Eigen::Vector3f linear_color(int r, int g, int b) {
  return {display_to_linear(static_cast<float>(r) / 255.0F),
          display_to_linear(static_cast<float>(g) / 255.0F),
          display_to_linear(static_cast<float>(b) / 255.0F)};
}

const Eigen::Vector3f& SideColors::of(const BodyPlan& plan, std::int32_t joint) const {
  if (plan.hand_only) {
    const std::int8_t finger = plan.fingers[joint];
    return finger < 0 ? centre : fingers[finger];
  }
  const BodySide side = plan.sides[joint];
  return side == BodySide::left ? left : side == BodySide::right ? right : centre;
}

/// A mesh at rest and its surface. The copy is moved along its normals: the difference of the two,
/// skinned, is the skinned normal, for skinning is affine.
struct FigureModel::SkinnedPart {
  const Mesh* mesh = nullptr;
  Mesh along_normals;
};

FigureModel::~FigureModel() = default;
FigureModel::FigureModel(FigureModel&&) noexcept = default;

FigureModel::FigureModel(const Character& character, BodyPlan plan,
                         std::span<const std::int32_t> tinted_joints)
    : character_(character), plan_(std::move(plan)) {
  std::vector<std::uint8_t> tinted(character.skeleton.parents.size(), 0);
  for (const std::int32_t j : tinted_joints) {
    if (j >= 0 && j < character.skeleton.size()) tinted[j] = 1;
  }
  if (character.meshes.empty()) {
    add_bones(tinted);
  } else {
    add_meshes(tinted);
  }
}

void FigureModel::load_textures() {
  textures_.resize(character_.textures.size());
  for (const Material& material : character_.materials) {
    const std::int32_t t = material.base_color_texture;
    if (t < 0 || t >= static_cast<std::int32_t>(textures_.size()) || textures_[t]) continue;
    Result<TextureImage> image = decode_image(character_.textures[t].bytes);
    if (image.ok() && image->width > 0 && image->height > 0) {
      textures_[t] = std::make_unique<TexturePyramid>(pyramid_of(std::move(*image)));
    }
  }
}

void FigureModel::add_meshes(Tinted tinted) {
  load_textures();
  const bool plain = is_plain(character_);
  for (const Mesh& mesh : character_.meshes) {
    Material material;
    if (mesh.material >= 0 &&
        mesh.material < static_cast<std::int32_t>(character_.materials.size())) {
      material = character_.materials[mesh.material];
    }
    if (material.base_color.w() >= 0.05F) add_part(mesh, material, plain, tinted);
  }
}

void FigureModel::add_part(const Mesh& mesh, const Material& material, bool plain, Tinted tinted) {
  const SideColors sides;
  const std::vector<Patch> patches = patches_of(character_, tinted);
  std::vector<Eigen::Vector3f> at_rest(mesh.positions.size());
  if (!patches.empty()) skin_positions(mesh, rest_model(character_), at_rest);
  const Eigen::Vector3f own = material.base_color.head<3>();
  Surface surface;
  const std::int32_t t = material.base_color_texture;
  if (t >= 0 && mesh.uvs.size() == mesh.positions.size()) surface.texture = textures_[t].get();
  surface.uvs = mesh.uvs;
  surface.triangles = cropped(mesh, joints_below(character_.skeleton, plan_.crop));
  surface.positions.resize(mesh.positions.size());
  surface.normals.resize(mesh.positions.size());
  for (std::size_t v = 0; v < mesh.positions.size(); ++v) {
    Eigen::Vector3f color = Eigen::Vector3f::Zero();
    float tint = 0.0F;
    for (std::uint32_t i = mesh.influence_begin[v]; i < mesh.influence_begin[v + 1]; ++i) {
      const float weight = mesh.influences[i].weight;
      const std::int32_t joint = mesh.skin[mesh.influences[i].skin_joint].joint;
      const Eigen::Vector3f& side = sides.of(plan_, joint);
      const bool coloured = plain && &side != &sides.centre;
      color += weight * (coloured ? Eigen::Vector3f(0.3F * own + 0.7F * side) : own);
      for (const Patch& patch : patches) {
        if (joint != patch.joint && joint != patch.parent) continue;
        tint = std::max(tint, 1.0F - (at_rest[v] - patch.centre).norm() / patch.radius);
      }
    }
    surface.colors.push_back(color + std::min(1.0F, 3.0F * tint) * (sides.tint - color));
  }
  SkinnedPart part;
  part.mesh = &mesh;
  part.along_normals = mesh;
  const std::vector<Eigen::Vector3f> normals =
      mesh.normals.size() == mesh.positions.size() ? mesh.normals : smooth_normals(mesh);
  for (std::size_t v = 0; v < normals.size(); ++v) part.along_normals.positions[v] += normals[v];
  parts_.push_back(std::move(part));
  surfaces_.push_back(std::move(surface));
}

std::span<const Surface> FigureModel::pose(std::span<const DualQuaternion> model_from_joint,
                                           double scale, const Eigen::Vector3d& offset) {
  if (parts_.empty()) {
    pose_bones(model_from_joint);
  } else {
    for (std::size_t p = 0; p < parts_.size(); ++p) {
      Surface& s = surfaces_[p];
      skin_positions(*parts_[p].mesh, model_from_joint, s.positions);
      skin_positions(parts_[p].along_normals, model_from_joint, s.normals);
      for (std::size_t v = 0; v < s.normals.size(); ++v) {
        s.normals[v] = (s.normals[v] - s.positions[v]).stableNormalized();
      }
    }
  }
  const auto k = static_cast<float>(scale);
  const Eigen::Vector3f shift = offset.cast<float>();
  if (k != 1.0F || !shift.isZero()) {
    for (Surface& s : surfaces_) {
      for (Eigen::Vector3f& p : s.positions) p = k * p + shift;
    }
  }
  return surfaces_;
}

}  // namespace limber
