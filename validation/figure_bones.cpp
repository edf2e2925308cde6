#include <algorithm>
#include <array>
#include <cmath>

#include "validation/figure_model.h"

namespace limber {
namespace {

constexpr int kAround = 10;  // sides of a bone

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

/// Joints that only mark where a bone ends.
bool is_end(const std::string& name) {
  for (const char* word : {"End", "end", "Nub", "nub", "Top", "Tip", "tip", "Site"}) {
    if (name.find(word) != std::string::npos) return true;
  }
  return false;
}

}  // namespace

void FigureModel::add_bones(Tinted tinted) {
  const Skeleton& skeleton = character_.skeleton;
  const auto children = children_of(skeleton);
  const std::vector<std::uint8_t> drawn = joints_below(skeleton, plan_.crop);
  in_body_.assign(skeleton.parents.size(), 0);
  double longest = 0.0, longest_of_trunk = 0.0;
  for (std::int32_t i = 0; i < skeleton.size(); ++i) {
    const std::int32_t parent = skeleton.parents[i];
    // Joints above the pelvis only place the figure in the world.
    const bool inside = parent != kNoJoint && in_body_[parent];
    in_body_[i] = drawn[i] && (i == plan_.pelvis || plan_.hand_only || inside);
    if (!inside) continue;
    const bool limb = plan_.hand_only || plan_.sides[i] != BodySide::centre;
    // Markers that hang on the pelvis (3ds Max's footsteps) are no limb.
    const bool marker = !limb && plan_.stands && parent == plan_.pelvis && children[i].empty();
    in_body_[i] = !marker && !inside_head(i);
    if (!in_body_[i]) continue;
    double& most = limb ? longest : longest_of_trunk;
    most = std::max(most, skeleton.rest_parent_from_joint[i].translation().norm());
  }
  if (longest == 0.0) longest = longest_of_trunk;
  if (longest == 0.0) longest = 0.1;  // a single joint
  for (std::int32_t i = 0; i < skeleton.size(); ++i) {
    if (in_body_[i]) add_bones_of(i, children[i], longest, tinted);
  }
  surfaces_.resize(1);
}

/// The way on from the joint above, in the joint's space.
Eigen::Vector3d FigureModel::onwards(std::int32_t joint) const {
  const DualQuaternion& rest = character_.skeleton.rest_parent_from_joint[joint];
  const Eigen::Vector3d way = rest.rotation().conjugate() * rest.translation();
  return way.norm() < 1e-6 ? Eigen::Vector3d(0, 1, 0) : Eigen::Vector3d(way.normalized());
}

/// A joint at the top of the head, which the head's ball shows.
bool FigureModel::inside_head(std::int32_t joint) const {
  const Skeleton& skeleton = character_.skeleton;
  if (plan_.head == kNoJoint || skeleton.parents[joint] != plan_.head) return false;
  if (is_end(skeleton.names[joint])) return true;
  const Eigen::Vector3d way = skeleton.rest_parent_from_joint[joint].translation();
  return way.dot(onwards(plan_.head)) > 0.6 * way.norm();
}

void FigureModel::add_bones_of(std::int32_t i, std::span<const std::int32_t> children,
                               double longest, Tinted tinted) {
  const Skeleton& skeleton = character_.skeleton;
  const SideColors colors;
  Bone bone;
  bone.from = i;
  bone.joint_color = tinted[i] ? colors.tint : Eigen::Vector3f(0.8F * colors.of(plan_, i));
  const DualQuaternion& rest = skeleton.rest_parent_from_joint[i];
  double crown = 0.0;  // how far the head's own end lies
  for (const std::int32_t child : children) {
    if (inside_head(child)) {
      crown = std::max(crown, skeleton.rest_parent_from_joint[child].translation().norm());
    }
    if (!in_body_[child]) continue;
    const Eigen::Vector3d way = skeleton.rest_parent_from_joint[child].translation();
    const bool trunk = plan_.sides[child] == BodySide::centre && !plan_.hand_only;
    const bool outwards = plan_.sides[i] == BodySide::centre && !plan_.hand_only;
    bone.to = child;
    bone.radius = std::clamp(0.13 * way.norm(), (trunk ? 0.05 : 0.02) * longest, 0.10 * longest);
    bone.end_radius = 0.5 * bone.radius;
    bone.color = colors.of(plan_, outwards ? child : i);
    bones_.push_back(bone);
  }
  // The head's ball; hands and feet that end in a joint get a stub, going on the same way.
  bone.ball = i == plan_.head;
  const bool ends = children.empty() && !is_end(skeleton.names[i]) &&
                    (rest.translation().norm() >= 0.12 * longest || i == 0);
  if (!bone.ball && !ends) return;
  bone.to = kNoJoint;
  bone.radius =
      bone.ball ? std::clamp(0.5 * crown, 0.24 * longest, 0.32 * longest) : 0.06 * longest;
  bone.end_radius = 0.6 * bone.radius;
  bone.along = onwards(i) * (bone.ball ? 0.9 * bone.radius : 0.3 * longest);
  bone.color = colors.of(plan_, i);
  bones_.push_back(bone);
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

}  // namespace limber
