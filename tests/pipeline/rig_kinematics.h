#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/pipeline/program.h"

/// Kinematics and limits of a rig file, from the text of ikrig/1 alone: nothing of ours in it.
namespace limber_test::kinematics {

using Eigen::Quaterniond;
using Eigen::Vector3d;
using nlohmann::json;

inline constexpr double kRadians = M_PI / 180.0;

inline double number(const json& j, std::size_t i) { return j.at(i).get<double>(); }
inline Vector3d vector_of(const json& j) { return {number(j, 0), number(j, 1), number(j, 2)}; }
inline Quaterniond quaternion_of(const json& j) {
  return {number(j, 0), number(j, 1), number(j, 2), number(j, 3)};
}
inline json json_of(const Vector3d& v) { return {v.x(), v.y(), v.z()}; }
inline json json_of(const Quaterniond& q) { return {q.w(), q.x(), q.y(), q.z()}; }

inline json rig_file(const std::string& name) {
  return json::parse(text_of(source_root() / "assets/data/rigs" / (name + ".json")));
}

using Coordinates = std::vector<std::vector<double>>;  // [joint]

inline Quaterniond about(const json& axis, double angle) {
  return Quaterniond(Eigen::AngleAxisd(angle, vector_of(axis)));
}

inline Quaterniond of_vector(const Vector3d& v) {
  return v.norm() < 1e-12 ? Quaterniond::Identity()
                          : Quaterniond(Eigen::AngleAxisd(v.norm(), v.normalized()));
}

inline Quaterniond rotation_of(const json& joint, const std::vector<double>& q) {
  const std::string type = joint["type"];
  if (type == "hinge") return about(joint["axes"][0], q[0]);
  if (type == "universal") return about(joint["axes"][0], q[0]) * about(joint["axes"][1], q[1]);
  if (type == "ball") return of_vector({q[0], q[1], q[2]});
  if (type == "free") return of_vector({q[3], q[4], q[5]});
  return Quaterniond::Identity();
}

inline std::vector<Eigen::Isometry3d> world_of(const json& rig, const Coordinates& q) {
  std::vector<Eigen::Isometry3d> world;
  for (std::size_t j = 0; j < rig["joints"].size(); ++j) {
    const json& joint = rig["joints"][j];
    Vector3d offset = vector_of(joint["offset"]);
    if (joint["type"] == "free") offset += Vector3d(q[j][0], q[j][1], q[j][2]);
    Eigen::Isometry3d local = Eigen::Isometry3d::Identity();
    local.translate(offset);
    if (joint.contains("rest")) local.rotate(quaternion_of(joint["rest"]));
    local.rotate(rotation_of(joint, q[j]));
    const int parent = joint["parent"];
    world.push_back(parent < 0 ? local : Eigen::Isometry3d(world[parent] * local));
  }
  return world;
}

inline std::size_t dof_of(const json& joint) {
  static const std::map<std::string, std::size_t> kDof = {
      {"fixed", 0}, {"hinge", 1}, {"universal", 2}, {"ball", 3}, {"free", 6}};
  return kDof.at(joint["type"]);
}

/// By how much (rad) a joint leaves its limits; for a ball's swing, how far its level exceeds 1.
inline double excess_of(const json& joint, const std::vector<double>& q) {
  const std::string type = joint["type"];
  double excess = 0.0;
  if (type == "hinge" || type == "universal") {
    for (std::size_t k = 0; k < q.size(); ++k) {
      excess = std::max(
          {excess, double(joint["limits"][k][0]) - q[k], q[k] - double(joint["limits"][k][1])});
    }
  }
  if (type != "ball") return excess;
  const Vector3d axis = vector_of(joint["axes"][2]);
  const Quaterniond r = of_vector({q[0], q[1], q[2]});
  const double twist = std::remainder(2.0 * std::atan2(r.vec().dot(axis), r.w()), 2.0 * M_PI);
  const Eigen::AngleAxisd swing(r * Quaterniond(Eigen::AngleAxisd(-twist, axis)));
  const Vector3d s = std::remainder(swing.angle(), 2.0 * M_PI) * swing.axis();
  double level = 0.0;
  for (int k = 0; k < 2; ++k) {
    const double along = s.dot(vector_of(joint["axes"][k]));
    const double bound = joint["twist_swing"][k == 0 ? "swing0" : "swing1"][along < 0.0 ? 0 : 1];
    level += std::pow(along / bound, 2);
  }
  const json& range = joint["twist_swing"]["twist"];
  return std::max({std::sqrt(level) - 1.0, double(range[0]) - twist, twist - double(range[1])});
}

}  // namespace limber_test::kinematics
