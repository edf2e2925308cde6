#pragma once

#include <cmath>
#include <string>
#include <vector>

#include "assets/model/character.h"

namespace limber::test {

/// A small biped of 1.7 m that faces +Z, T-pose at rest, with VRM roles.
inline Character walker_skeleton() {
  Character c;
  c.name = "walker";
  const auto joint = [&](const char* name, const char* parent, double x, double y, double z) {
    c.skeleton.names.emplace_back(name);
    c.skeleton.parents.push_back(*parent ? c.skeleton.find(parent) : kNoJoint);
    c.skeleton.rest_parent_from_joint.push_back(
        DualQuaternion::from_translation(Eigen::Vector3d(x, y, z)));
    c.roles.emplace_back(name);
    c.deforming.push_back(1);
  };
  joint("hips", "", 0, 0.93, 0);
  joint("spine", "hips", 0, 0.12, 0);
  joint("chest", "spine", 0, 0.17, 0);
  joint("neck", "chest", 0, 0.24, 0);
  joint("head", "neck", 0, 0.10, 0);
  for (const std::string side : {"left", "right"}) {
    const double s = side == "left" ? 1.0 : -1.0;
    joint((side + "UpperLeg").c_str(), "hips", 0.09 * s, -0.03, 0);
    joint((side + "LowerLeg").c_str(), (side + "UpperLeg").c_str(), 0, -0.42, 0);
    joint((side + "Foot").c_str(), (side + "LowerLeg").c_str(), 0, -0.40, 0);
    joint((side + "Toes").c_str(), (side + "Foot").c_str(), 0, -0.06, 0.14);
    joint((side + "UpperArm").c_str(), "chest", 0.17 * s, 0.20, 0);
    joint((side + "LowerArm").c_str(), (side + "UpperArm").c_str(), 0.28 * s, 0, 0);
    joint((side + "Hand").c_str(), (side + "LowerArm").c_str(), 0.25 * s, 0, 0);
  }
  return c;
}

/// Rings of a capsule between two points in model space, hung on one joint.
inline void add_capsule(Mesh& mesh, std::uint32_t skin_joint, const Eigen::Vector3d& from,
                        const Eigen::Vector3d& to, double r0, double r1, int around, int rings) {
  const Eigen::Vector3d w = (to - from).normalized(), u = w.unitOrthogonal(), v = w.cross(u);
  const auto base = static_cast<std::uint32_t>(mesh.positions.size());
  for (int r = 0; r <= rings; ++r) {
    const double t = double(r) / rings, a = M_PI * (t - 0.5);
    const Eigen::Vector3d centre =
        from + 0.5 * (1.0 + std::sin(a)) * (to - from) + std::sin(a) * (t < 0.5 ? r0 : r1) * w;
    const double radius = std::max(std::cos(a), 0.01) * ((1 - t) * r0 + t * r1);
    for (int k = 0; k < around; ++k) {
      const double b = 2.0 * M_PI * k / around;
      const Eigen::Vector3d p = centre + radius * (std::cos(b) * u + std::sin(b) * v);
      mesh.positions.push_back(p.cast<float>());
      mesh.influences.push_back({skin_joint, 1.0F});
      mesh.influence_begin.push_back(static_cast<std::uint32_t>(mesh.influences.size()));
    }
  }
  const auto n = static_cast<std::uint32_t>(around);
  for (std::uint32_t r = 0; r < static_cast<std::uint32_t>(rings); ++r) {
    for (std::uint32_t k = 0; k < n; ++k) {
      const std::uint32_t a = base + r * n + k, b = base + r * n + (k + 1) % n;
      mesh.triangles.insert(mesh.triangles.end(), {a, b, a + n, b, b + n, a + n});
    }
  }
}

/// The same with a capsule along every bone: about 5,000 triangles.
inline Character walker_with_mesh() {
  Character c = walker_skeleton();
  std::vector<DualQuaternion> rest(c.skeleton.parents.size());
  model_from_local(c.skeleton, c.skeleton.rest_parent_from_joint, rest);
  c.bind_model_from_joint = rest;
  Mesh mesh;
  mesh.name = "body";
  mesh.influence_begin.push_back(0);
  for (std::int32_t i = 0; i < c.skeleton.size(); ++i) {
    mesh.skin.push_back({i, rest[i].conjugate().matrix()});
  }
  for (std::int32_t i = 1; i < c.skeleton.size(); ++i) {
    const std::int32_t parent = c.skeleton.parents[i];
    const Eigen::Vector3d from = rest[parent].translation(), to = rest[i].translation();
    const bool trunk = c.skeleton.names[i].find("t") == std::string::npos || i < 4;
    const double r = trunk ? 0.09 : 0.16 * (to - from).norm();
    add_capsule(mesh, static_cast<std::uint32_t>(parent), from, to, r, 0.8 * r, 14, 10);
  }
  const Eigen::Vector3d head = rest[4].translation();
  add_capsule(mesh, 4, head + Eigen::Vector3d(0, 0.04, 0.02), head + Eigen::Vector3d(0, 0.16, 0.02),
              0.08, 0.08, 18, 14);
  for (const int hand : {11, 18}) {
    const Eigen::Vector3d at = rest[hand].translation();
    const Eigen::Vector3d out = at + Eigen::Vector3d(at.x() > 0 ? 0.14 : -0.14, 0, 0);
    add_capsule(mesh, static_cast<std::uint32_t>(hand), at, out, 0.035, 0.03, 14, 10);
  }
  mesh.material = -1;
  c.meshes.push_back(std::move(mesh));
  return c;
}

/// A walk along +Z with a turn at the end: 1.2 steps a second, arms down and swinging.
inline Clip walk_clip(const Skeleton& skeleton, std::int64_t frames, double rate_hz) {
  Clip clip;
  clip.name = "walk";
  clip.rate_hz = rate_hz;
  clip.joints = skeleton.size();
  const auto about = [](const Eigen::Vector3d& axis, double angle) {
    return Eigen::Quaterniond(Eigen::AngleAxisd(angle, axis));
  };
  const Eigen::Vector3d x(1, 0, 0), y(0, 1, 0), z(0, 0, 1);
  for (std::int64_t f = 0; f < frames; ++f) {
    const double t = double(f) / rate_hz, phase = 2.0 * M_PI * 0.9 * t;
    const double turn = 1.6 / (1.0 + std::exp(-4.0 * (t - 0.7 * double(frames) / rate_hz)));
    std::vector<DualQuaternion> pose = skeleton.rest_parent_from_joint;
    const auto set = [&](const std::string& name, const Eigen::Quaterniond& r) {
      const std::int32_t i = skeleton.find(name);
      pose[i] = DualQuaternion::from_rotation_translation(r, pose[i].translation());
    };
    pose[0] = DualQuaternion::from_rotation_translation(
        about(y, turn), Eigen::Vector3d(0.3 * turn, 0.905 + 0.015 * std::cos(2 * phase), 1.1 * t));
    set("spine", about(y, 0.1 * std::sin(phase)) * about(x, 0.06));
    for (const std::string side : {"left", "right"}) {
      const double s = side == "left" ? 1.0 : -1.0, p = phase + (s > 0 ? 0.0 : M_PI);
      const double lift = std::max(0.0, std::sin(p + 0.5));
      set(side + "UpperLeg", about(x, -0.45 * std::sin(p) - 0.25 * lift));
      set(side + "LowerLeg", about(x, 0.12 + 0.9 * lift));
      set(side + "Foot", about(x, 0.2 * std::sin(p) - 0.2 * lift));
      set(side + "UpperArm", about(x, 0.5 * std::sin(p)) * about(z, -1.35 * s));
      set(side + "LowerArm", about(y, -0.5 * s));
    }
    clip.parent_from_joint.insert(clip.parent_from_joint.end(), pose.begin(), pose.end());
  }
  return clip;
}

}  // namespace limber::test
