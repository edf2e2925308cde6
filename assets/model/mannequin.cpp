#include "assets/model/mannequin.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

namespace limber {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3i;

constexpr std::int32_t kBodyMaterial = 0;
constexpr std::int32_t kJointMaterial = 1;

// ---- what each joint's part is made of

bool contains(const std::string& text, const char* part) {
  return text.find(part) != std::string::npos;
}

bool is_trunk(const std::string& role) {
  static const std::array<const char*, 8> kTrunk = {
      "hips", "spine", "chest", "upperChest", "neck", "head", "leftShoulder", "rightShoulder"};
  return std::find(kTrunk.begin(), kTrunk.end(), role) != kTrunk.end();
}

/// Radius as a share of the bone's length, for joints that bring no capsules.
double slenderness(const std::string& role) {
  if (role == "hips" || role == "spine" || contains(role, "hest")) return 0.7;
  if (role == "head") return 0.6;
  if (role == "neck") return 0.5;
  if (contains(role, "UpperLeg")) return 0.17;
  if (contains(role, "UpperArm")) return 0.15;
  if (contains(role, "LowerLeg") || contains(role, "LowerArm")) return 0.12;
  if (contains(role, "Foot") || contains(role, "Toes")) return 0.3;
  if (contains(role, "Thumb") || contains(role, "Index") || contains(role, "Middle") ||
      contains(role, "Ring") || contains(role, "Little")) {
    return 0.24;
  }
  return 0.15;
}

/// Where a terminal joint's bone ends: at its farthest effector, else along its parent's bone.
Vector3d terminal_end(const Rig& rig, std::int32_t joint) {
  Vector3d end = Vector3d::Zero();
  for (const RigEffector& effector : rig.effectors) {
    if (effector.joint == joint && effector.offset.norm() > end.norm()) end = effector.offset;
  }
  const RigJoint& j = rig.joints[joint];
  return end.norm() > 1e-3 ? end : Vector3d(0.6 * (j.rest.conjugate() * j.offset));
}

std::vector<std::vector<Capsule>> capsules_of(const Rig& rig) {
  std::vector<std::vector<Vector3d>> ends(rig.joints.size());
  for (const RigJoint& joint : rig.joints) {
    if (joint.parent != kNoJoint) ends[joint.parent].push_back(joint.offset);
  }
  std::vector<std::vector<Capsule>> capsules(rig.joints.size());
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    capsules[i] = rig.joints[i].capsules;
    if (!capsules[i].empty()) continue;
    if (ends[i].empty()) ends[i].push_back(terminal_end(rig, i));
    for (const Vector3d& end : ends[i]) {
      if (end.norm() < 1e-3) continue;
      capsules[i].push_back({Vector3d::Zero(), end, slenderness(rig.joints[i].role) * end.norm()});
    }
  }
  return capsules;
}

/// Capsules in model space that make one smooth surface, each with the joint it follows.
struct Part {
  std::vector<Capsule> capsules;
  std::vector<std::int32_t> joints;

  void add(const Capsule& c, std::int32_t joint, const DualQuaternion& model_from_joint) {
    capsules.push_back({model_from_joint.transform_point(c.from),
                        model_from_joint.transform_point(c.to), c.radius});
    joints.push_back(joint);
  }
  double thinnest() const {
    double radius = capsules[0].radius;
    for (const Capsule& c : capsules) radius = std::min(radius, c.radius);
    return radius;
  }
};

/// The trunk in one piece, whose skin bends; every limb joint a piece of its own, as on an artist's
/// wooden figure. Capsules much thinner than a joint's thickest (a nose) would ask for a far finer
/// mesh than the rest needs, so they are a piece of their own too.
std::vector<Part> parts_of(const Rig& rig, const std::vector<std::vector<Capsule>>& capsules,
                           std::span<const DualQuaternion> model_from_joint) {
  std::vector<Part> parts(1);
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    double thickest = 0.0;
    for (const Capsule& c : capsules[i]) thickest = std::max(thickest, c.radius);
    const bool trunk = is_trunk(rig.joints[i].role) && rig.joints[i].role != "head";
    Part thick, thin;
    for (const Capsule& c : capsules[i]) {
      Part& part = trunk ? parts[0] : c.radius < 0.4 * thickest ? thin : thick;
      part.add(c, i, model_from_joint[i]);
    }
    parts.push_back(std::move(thick));
    parts.push_back(std::move(thin));
  }
  std::erase_if(parts, [](const Part& part) { return part.capsules.empty(); });
  return parts;
}

// ---- the smooth surface of a part

double distance_to(const Capsule& capsule, const Vector3d& p) {
  const Vector3d along = capsule.to - capsule.from;
  const double length2 = along.squaredNorm();
  const double t =
      length2 > 0.0 ? std::clamp((p - capsule.from).dot(along) / length2, 0.0, 1.0) : 0.0;
  return (p - capsule.from - t * along).norm() - capsule.radius;
}

/// Union of capsules whose creases are rounded over `blend` metres (polynomial smooth minimum).
struct Solid {
  const std::vector<Capsule>& capsules;
  double blend;

  double operator()(const Vector3d& p) const {
    double d = distance_to(capsules[0], p);
    for (std::size_t i = 1; i < capsules.size(); ++i) {
      const double e = distance_to(capsules[i], p);
      const double h = std::max(blend - std::abs(d - e), 0.0) / blend;
      d = std::min(d, e) - 0.25 * h * h * blend;
    }
    return d;
  }

  Vector3d gradient(const Vector3d& p) const {
    const double step = 1e-5;
    Vector3d g;
    for (int k = 0; k < 3; ++k) {
      const Vector3d e = step * Vector3d::Unit(k);
      g[k] = ((*this)(p + e) - (*this)(p - e)) / (2.0 * step);
    }
    return g;
  }
};

struct Surface {
  std::vector<Vector3d> positions, normals;
  std::vector<std::uint32_t> triangles;
};

/// A regular grid of samples of a solid.
struct Grid {
  Vector3d origin;
  double cell;
  Vector3i size;  // samples
  std::vector<double> value;

  std::size_t index(const Vector3i& c) const {
    return (std::size_t(c.z()) * size.y() + c.y()) * size.x() + c.x();
  }
  Vector3d point(const Vector3i& c) const { return origin + cell * c.cast<double>(); }
};

Grid sample(const Solid& solid, double cell) {
  Vector3d low = Vector3d::Constant(1e9), high = -low;
  for (const Capsule& c : solid.capsules) {
    const Vector3d r = Vector3d::Constant(c.radius + solid.blend);
    low = low.cwiseMin(c.from.cwiseMin(c.to) - r);
    high = high.cwiseMax(c.from.cwiseMax(c.to) + r);
  }
  // Bounds that a symmetric limb shares with its mirror image keep both sides' meshes alike.
  Grid grid{0.5 * (low + high), cell, Vector3i::Zero(), {}};
  for (int k = 0; k < 3; ++k) {
    grid.size[k] = static_cast<int>(std::ceil((high[k] - low[k]) / cell)) + 3;
    grid.origin[k] -= 0.5 * cell * (grid.size[k] - 1);
  }
  grid.value.resize(std::size_t(grid.size.x()) * grid.size.y() * grid.size.z());
  for (Vector3i c(0, 0, 0); c.z() < grid.size.z(); ++c.z()) {
    for (c.y() = 0; c.y() < grid.size.y(); ++c.y()) {
      for (c.x() = 0; c.x() < grid.size.x(); ++c.x()) {
        grid.value[grid.index(c)] = solid(grid.point(c));
      }
    }
  }
  return grid;
}

/// Mean of the points where the cell's edges cross the surface; false where none does.
bool cell_vertex(const Grid& grid, const Vector3i& cell, Vector3d& vertex) {
  Vector3d sum = Vector3d::Zero();
  int crossings = 0;
  for (int corner = 0; corner < 8; ++corner) {
    const Vector3i a = cell + Vector3i(corner & 1, (corner >> 1) & 1, corner >> 2);
    for (int k = 0; k < 3; ++k) {
      if (a[k] != cell[k]) continue;
      const Vector3i b = a + Vector3i::Unit(k);
      const double va = grid.value[grid.index(a)], vb = grid.value[grid.index(b)];
      if ((va < 0.0) == (vb < 0.0)) continue;
      sum += grid.point(a) + va / (va - vb) * (grid.point(b) - grid.point(a));
      ++crossings;
    }
  }
  if (crossings > 0) vertex = sum / crossings;
  return crossings > 0;
}

void add_quad(Surface& s, std::array<std::uint32_t, 4> q, bool flip) {
  if (flip) std::swap(q[1], q[3]);
  const bool other = (s.positions[q[0]] - s.positions[q[2]]).squaredNorm() >
                     (s.positions[q[1]] - s.positions[q[3]]).squaredNorm();
  const std::array<int, 6> corner =
      other ? std::array<int, 6>{0, 1, 3, 1, 2, 3} : std::array<int, 6>{0, 1, 2, 0, 2, 3};
  for (const int c : corner) s.triangles.push_back(q[c]);
}

/// Naive surface nets (Gibson 1998): one vertex per cell that the surface crosses, one quad per
/// edge; each vertex is then moved onto the surface by Newton steps along the gradient.
Surface surface_nets(const Solid& solid, double cell) {
  const Grid grid = sample(solid, cell);
  Surface surface;
  std::vector<std::int64_t> vertex_of(grid.value.size(), -1);
  const auto each_cell = [&](auto&& visit) {
    for (Vector3i c(0, 0, 0); c.z() + 1 < grid.size.z(); ++c.z()) {
      for (c.y() = 0; c.y() + 1 < grid.size.y(); ++c.y()) {
        for (c.x() = 0; c.x() + 1 < grid.size.x(); ++c.x()) visit(c);
      }
    }
  };
  each_cell([&](const Vector3i& c) {
    Vector3d p;
    if (!cell_vertex(grid, c, p)) return;
    for (int step = 0; step < 3; ++step) {
      const Vector3d g = solid.gradient(p);
      p -= solid(p) / std::max(g.squaredNorm(), 0.25) * g;
    }
    vertex_of[grid.index(c)] = static_cast<std::int64_t>(surface.positions.size());
    surface.positions.push_back(p);
    surface.normals.push_back(solid.gradient(p).normalized());
  });
  each_cell([&](const Vector3i& c) {
    for (int k = 0; k < 3; ++k) {
      const Vector3i u = Vector3i::Unit((k + 1) % 3), v = Vector3i::Unit((k + 2) % 3);
      if (c.dot(u) == 0 || c.dot(v) == 0) continue;
      const bool inside = grid.value[grid.index(c)] < 0.0;
      if (inside == (grid.value[grid.index(c + Vector3i::Unit(k))] < 0.0)) continue;
      const std::array<Vector3i, 4> around = {c - u - v, c - v, c, c - u};
      std::array<std::uint32_t, 4> quad;
      for (int i = 0; i < 4; ++i) {
        quad[i] = static_cast<std::uint32_t>(vertex_of[grid.index(around[i])]);
      }
      add_quad(surface, quad, !inside);
    }
  });
  return surface;
}

// ---- skinning the parts

/// A vertex follows the joint whose capsules are nearest; where another is hardly farther, both.
std::vector<Influence> influences_at(const Part& part, const Vector3d& p) {
  std::vector<std::pair<std::int32_t, double>> distances;
  double nearest = 1e9;
  for (std::size_t i = 0; i < part.capsules.size(); ++i) {
    const double d = distance_to(part.capsules[i], p);
    nearest = std::min(nearest, d);
    if (!distances.empty() && distances.back().first == part.joints[i]) {
      distances.back().second = std::min(distances.back().second, d);
    } else {
      distances.push_back({part.joints[i], d});
    }
  }
  const double reach = 0.8 * part.thinnest();
  std::vector<Influence> influences;
  double sum = 0.0;
  for (const auto& [joint, distance] : distances) {
    const double share = std::max(0.0, 1.0 - (distance - nearest) / reach);
    if (share <= 0.0) continue;
    influences.push_back({static_cast<std::uint32_t>(joint), static_cast<float>(share * share)});
    sum += share * share;
  }
  for (Influence& influence : influences) influence.weight /= static_cast<float>(sum);
  return influences;
}

void add_part(Mesh& mesh, const Part& part, double blend, double cell) {
  const Surface surface = surface_nets({part.capsules, blend}, cell);
  const auto base = static_cast<std::uint32_t>(mesh.positions.size());
  for (std::size_t v = 0; v < surface.positions.size(); ++v) {
    mesh.positions.push_back(surface.positions[v].cast<float>());
    mesh.normals.push_back(surface.normals[v].cast<float>());
    mesh.influence_begin.push_back(static_cast<std::uint32_t>(mesh.influences.size()));
    for (const Influence& i : influences_at(part, surface.positions[v])) {
      mesh.influences.push_back(i);
    }
  }
  for (const std::uint32_t index : surface.triangles) mesh.triangles.push_back(base + index);
}

/// The ball drawn in a limb's joint: as thick as the limb there; 0 where the trunk moves.
double ball_radius(const Rig& rig, const std::vector<std::vector<Capsule>>& capsules,
                   std::int32_t i) {
  const RigJoint& joint = rig.joints[i];
  if (joint.type == JointType::fixed || is_trunk(joint.role)) return 0.0;
  const auto thickness = [](const std::vector<Capsule>& parts, const Vector3d& p) {
    double radius = 0.0;
    for (const Capsule& c : parts) {
      if (distance_to(c, p) < 0.25 * c.radius) radius = std::max(radius, c.radius);
    }
    return radius;
  };
  double radius = thickness(capsules[i], Vector3d::Zero());
  const bool on_trunk = joint.parent == kNoJoint || is_trunk(rig.joints[joint.parent].role);
  if (!on_trunk) radius = std::max(radius, thickness(capsules[joint.parent], joint.offset));
  return 1.07 * radius;
}

Mesh make_mesh(const Rig& rig, const char* name, std::int32_t material,
               std::span<const DualQuaternion> model_from_joint) {
  Mesh mesh;
  mesh.name = rig.name + " " + name;
  mesh.material = material;
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    mesh.skin.push_back({i, model_from_joint[i].conjugate().matrix()});
  }
  return mesh;
}

/// Diagonal of the joints' bounding box.
double extent(std::span<const DualQuaternion> model_from_joint) {
  Vector3d low = Vector3d::Constant(1e9), high = -low;
  for (const DualQuaternion& joint : model_from_joint) {
    low = low.cwiseMin(joint.translation());
    high = high.cwiseMax(joint.translation());
  }
  return (high - low).norm();
}

void add_materials(Character& character) {
  character.materials.push_back({"body", {0.78F, 0.62F, 0.45F, 1.0F}, -1, false});
  character.materials.push_back({"joints", {0.23F, 0.16F, 0.12F, 1.0F}, -1, false});
}

}  // namespace

Character mannequin(const Rig& rig) {
  Character character;
  character.name = rig.name;
  character.skeleton = skeleton_of(rig);
  character.deforming.assign(rig.joints.size(), 1);
  for (const RigJoint& joint : rig.joints) character.roles.push_back(joint.role);
  std::vector<DualQuaternion> model_from_joint(rig.joints.size());
  model_from_local(character.skeleton, character.skeleton.rest_parent_from_joint, model_from_joint);
  character.bind_model_from_joint = model_from_joint;
  add_materials(character);

  Mesh body = make_mesh(rig, "body", kBodyMaterial, model_from_joint);
  Mesh balls = make_mesh(rig, "joints", kJointMaterial, model_from_joint);
  const std::vector<std::vector<Capsule>> capsules = capsules_of(rig);
  const double finest = std::max(0.0045, 0.005 * extent(model_from_joint));
  for (const Part& part : parts_of(rig, capsules, model_from_joint)) {
    const double thinnest = part.thinnest();
    const bool trunk = is_trunk(rig.joints[part.joints[0]].role);
    add_part(body, part, (trunk ? 1.2 : 0.6) * thinnest,
             std::clamp((trunk ? 0.6 : 0.85) * thinnest, finest, 0.032));
  }
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    const double radius = ball_radius(rig, capsules, i);
    if (radius <= 0.0) continue;
    Part ball;
    ball.add({Vector3d::Zero(), Vector3d::Zero(), radius}, i, model_from_joint[i]);
    add_part(balls, ball, 0.1 * radius, 0.5 * radius);
  }
  for (Mesh* mesh : {&body, &balls}) {
    mesh->influence_begin.push_back(static_cast<std::uint32_t>(mesh->influences.size()));
    if (!mesh->positions.empty()) character.meshes.push_back(std::move(*mesh));
  }
  return character;
}

}  // namespace limber
