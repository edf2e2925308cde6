#include "validation/figure_model.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <numeric>
#include <unordered_map>

namespace limber {
namespace {

constexpr int kAround = 10;  // sides of a bone

float display_to_linear(float s) {
  return s <= 0.04045F ? s / 12.92F : std::pow((s + 0.055F) / 1.055F, 2.4F);
}

/// A surface of revolution about `to - from`, closed at its ends; rings at (t, radius).
void add_lathe(Surface& s, const Eigen::Vector3d& from, const Eigen::Vector3d& to,
               std::span<const Eigen::Vector2d> rings, const Eigen::Vector3f& color) {
  const Eigen::Vector3d along = to - from;
  const double length = along.norm();
  if (length < 1e-9) return;
  const Eigen::Vector3d w = along / length, u = w.unitOrthogonal(), v = w.cross(u);
  const auto base = static_cast<std::uint32_t>(s.positions.size());
  for (std::size_t r = 0; r < rings.size(); ++r) {
    const std::size_t before = r == 0 ? 0 : r - 1, after = std::min(r + 1, rings.size() - 1);
    const Eigen::Vector2d slope = rings[after] - rings[before];
    for (int k = 0; k < kAround; ++k) {
      const double a = 2.0 * M_PI * k / kAround;
      const Eigen::Vector3d out = std::cos(a) * u + std::sin(a) * v;
      const Eigen::Vector3d p = from + rings[r][0] * along + rings[r][1] * out;
      const Eigen::Vector3d n = (slope[0] * length * out - slope[1] * w).normalized();
      s.positions.push_back(p.cast<float>());
      s.normals.push_back(n.cast<float>());
      s.colors.push_back(color);
    }
  }
  for (std::uint32_t r = 0; r + 1 < rings.size(); ++r) {
    for (std::uint32_t k = 0; k < kAround; ++k) {
      const std::uint32_t a = base + r * kAround + k, b = base + r * kAround + (k + 1) % kAround;
      s.triangles.insert(s.triangles.end(), {a, b, a + kAround, b, b + kAround, a + kAround});
    }
  }
}

void add_ball(Surface& s, const Eigen::Vector3d& centre, double radius,
              const Eigen::Vector3f& color) {
  constexpr int kRings = 9;
  std::array<Eigen::Vector2d, kRings> rings;
  for (int r = 0; r < kRings; ++r) {
    const double a = M_PI * (r + 0.001) / (kRings - 0.998);
    rings[r] = {0.5 - 0.5 * std::cos(a), radius * std::sin(a)};
  }
  const Eigen::Vector3d half(0, radius, 0);
  add_lathe(s, centre - half, centre + half, rings, color);
}

/// Thick near its joint, tapering to the next: the eye sees which way a bone points.
void add_bone(Surface& s, const Eigen::Vector3d& from, const Eigen::Vector3d& to, double radius,
              double end_radius, const Eigen::Vector3f& color) {
  const std::array<Eigen::Vector2d, 6> rings = {
      Eigen::Vector2d(0.0, 0.55 * radius), Eigen::Vector2d(0.06, 0.85 * radius),
      Eigen::Vector2d(0.18, radius),       Eigen::Vector2d(0.5, 0.6 * radius + 0.4 * end_radius),
      Eigen::Vector2d(0.94, end_radius),   Eigen::Vector2d(1.0, 0.5 * end_radius)};
  add_lathe(s, from, to, rings, color);
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

bool greyish(const Eigen::Vector3f& c) { return c.maxCoeff() - c.minCoeff() < 0.12F; }

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

FigureModel::FigureModel(const Character& character, std::span<const std::int32_t> tinted_joints)
    : character_(character), plan_(plan_of(character)) {
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

void FigureModel::add_meshes(std::span<const std::uint8_t> tinted) {
  const SideColors sides;
  textures_.resize(character_.textures.size());
  for (const Material& material : character_.materials) {
    const std::int32_t t = material.base_color_texture;
    if (t < 0 || t >= static_cast<std::int32_t>(textures_.size()) || textures_[t]) continue;
    Result<TextureImage> image = decode_image(character_.textures[t].bytes);
    if (image.ok() && image->width > 0 && image->height > 0) {
      textures_[t] = std::make_unique<TexturePyramid>(pyramid_of(std::move(*image)));
    }
  }
  for (const Mesh& mesh : character_.meshes) {
    Material material;
    if (mesh.material >= 0 &&
        mesh.material < static_cast<std::int32_t>(character_.materials.size())) {
      material = character_.materials[mesh.material];
    }
    if (material.base_color.w() < 0.05F) continue;  // invisible
    Surface surface;
    const std::int32_t t = material.base_color_texture;
    if (t >= 0 && mesh.uvs.size() == mesh.positions.size()) surface.texture = textures_[t].get();
    const bool by_side = surface.texture == nullptr && greyish(material.base_color.head<3>());
    surface.uvs = mesh.uvs;
    surface.triangles = mesh.triangles;
    surface.positions.resize(mesh.positions.size());
    for (std::size_t v = 0; v < mesh.positions.size(); ++v) {
      Eigen::Vector3f color = material.base_color.head<3>(), side_color = Eigen::Vector3f::Zero();
      float tint = 0.0F;
      for (std::uint32_t i = mesh.influence_begin[v]; i < mesh.influence_begin[v + 1]; ++i) {
        const Influence& influence = mesh.influences[i];
        const std::int32_t joint = mesh.skin[influence.skin_joint].joint;
        side_color += influence.weight * sides.of(plan_, joint);
        tint += influence.weight * static_cast<float>(tinted[joint]);
      }
      if (by_side) color = 0.15F * color + 0.85F * side_color;
      surface.colors.push_back(color + 0.45F * tint * (sides.tint - color));
    }
    SkinnedPart part;
    part.mesh = &mesh;
    part.along_normals = mesh;
    const std::vector<Eigen::Vector3f> normals =
        mesh.normals.size() == mesh.positions.size() ? mesh.normals : smooth_normals(mesh);
    for (std::size_t v = 0; v < normals.size(); ++v) part.along_normals.positions[v] += normals[v];
    surface.normals.resize(mesh.positions.size());
    parts_.push_back(std::move(part));
    surfaces_.push_back(std::move(surface));
  }
}

void FigureModel::add_bones(std::span<const std::uint8_t> tinted) {
  const Skeleton& skeleton = character_.skeleton;
  const SideColors colors;
  const auto children = children_of(skeleton);
  std::vector<std::uint8_t> in_body(skeleton.parents.size(), 0);
  std::vector<double> length(skeleton.parents.size(), 0.0);
  double longest = 0.0;
  for (std::int32_t i = 0; i < skeleton.size(); ++i) {
    const std::int32_t parent = skeleton.parents[i];
    // Joints above the pelvis only place the figure in the world.
    in_body[i] = i == plan_.pelvis || plan_.hand_only || (parent != kNoJoint && in_body[parent]);
    if (!in_body[i] || parent == kNoJoint || !in_body[parent]) continue;
    length[i] = skeleton.rest_parent_from_joint[i].translation().norm();
    longest = std::max(longest, length[i]);
  }
  const auto look = [&](Bone& bone, std::int32_t joint, std::int32_t side_of) {
    bone.color = colors.of(plan_, side_of);
    bone.joint_color = tinted[joint] ? colors.tint : Eigen::Vector3f(0.8F * bone.color);
  };
  for (std::int32_t i = 0; i < skeleton.size(); ++i) {
    if (!in_body[i]) continue;
    for (const std::int32_t child : children[i]) {
      Bone bone;
      bone.from = i;
      bone.to = child;
      const bool trunk = plan_.sides[child] == BodySide::centre && !plan_.hand_only;
      const double thinnest = (trunk ? 0.05 : 0.02) * longest;
      bone.radius = std::clamp(0.13 * length[child], thinnest, 0.10 * longest);
      bone.end_radius = 0.5 * bone.radius;
      look(bone, i, plan_.sides[i] == BodySide::centre ? child : i);
      bone.joint_color = tinted[i] ? colors.tint : Eigen::Vector3f(0.8F * colors.of(plan_, i));
      bones_.push_back(bone);
    }
    const bool is_head = i == plan_.head;
    if (!is_head && (!children[i].empty() || length[i] < 0.12 * longest)) continue;
    // The head's ball; hands and feet that end in a joint get a stub, going on the same way.
    Bone stub;
    stub.from = i;
    const Eigen::Quaterniond turn = skeleton.rest_parent_from_joint[i].rotation().conjugate();
    Eigen::Vector3d way = turn * skeleton.rest_parent_from_joint[i].translation();
    if (is_head && !children[i].empty()) {
      way = skeleton.rest_parent_from_joint[children[i][0]].translation();
    }
    if (way.norm() < 1e-6) way = Eigen::Vector3d(0, 1, 0);
    stub.ball = is_head;
    stub.radius = is_head ? 0.26 * longest : 0.06 * longest;
    stub.end_radius = 0.6 * stub.radius;
    stub.along = way.normalized() * (is_head ? 0.9 * stub.radius : 0.3 * longest);
    look(stub, i, i);
    bones_.push_back(stub);
  }
  surfaces_.resize(1);
}

void FigureModel::pose_bones(std::span<const DualQuaternion> model_from_joint) {
  Surface& s = surfaces_[0];
  s = {};
  for (const Bone& bone : bones_) {
    const Eigen::Vector3d from = model_from_joint[bone.from].translation();
    const Eigen::Vector3d to = bone.to == kNoJoint
                                   ? model_from_joint[bone.from].transform_point(bone.along)
                                   : model_from_joint[bone.to].translation();
    if (bone.ball) {
      add_ball(s, to, bone.radius, bone.color);
    } else {
      add_bone(s, from, to, bone.radius, bone.end_radius, bone.color);
      add_ball(s, from, 0.8 * bone.radius, bone.joint_color);
    }
  }
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
