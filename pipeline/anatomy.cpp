#include "pipeline/anatomy.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>

#include "pipeline/embedded.h"

namespace limber {
namespace {

using Eigen::Vector3d;
using nlohmann::json;

constexpr double kDeg = M_PI / 180.0;

JointType type_named(const std::string& name) {
  for (const JointType type : {JointType::hinge, JointType::universal, JointType::ball}) {
    if (name == to_string(type)) return type;
  }
  return JointType::fixed;
}

/// Type, axes (completed to a right-handed triad) and the ranges under `ranges_key`.
AnatomicalLimit read_limit(const json& entry, const char* ranges_key) {
  AnatomicalLimit limit;
  limit.type = type_named(entry.at("type").get<std::string>());
  const json& axes = entry.at("axes");
  for (std::size_t k = 0; k < axes.size() && k < 3; ++k) {
    limit.axes[k] = Vector3d(axes[k][0], axes[k][1], axes[k][2]).normalized();
  }
  if (axes.size() == 1) limit.axes[1] = limit.axes[0].unitOrthogonal();
  if (axes.size() < 3) limit.axes[2] = limit.axes[0].cross(limit.axes[1]);
  const json& ranges = entry.at(ranges_key);
  for (std::size_t k = 0; k < ranges.size() && k < 3; ++k) {
    limit.ranges[k] = {ranges[k][0].get<double>() * kDeg, ranges[k][1].get<double>() * kDeg};
  }
  limit.citation = entry.value("citation", "");
  return limit;
}

const json& anatomy() {
  static const json document = json::parse(embedded_file("limits/anatomy.json"), nullptr, false);
  return document;
}

AnatomicalLimit shared_limit(const char* chain, std::size_t joints) {
  const json& entry = anatomy().at("shares").at(chain);
  AnatomicalLimit limit = read_limit(entry, "total_deg");
  const AnatomicalLimit one = read_limit(entry, "one_joint_deg");
  for (std::size_t k = 0; k < 3; ++k) {
    limit.ranges[k].min = std::max(limit.ranges[k].min / double(joints), one.ranges[k].min);
    limit.ranges[k].max = std::min(limit.ranges[k].max / double(joints), one.ranges[k].max);
  }
  return limit;
}

}  // namespace

std::optional<AnatomicalLimit> anatomical_limit(Role role) {
  static const auto limits = [] {
    std::map<Role, AnatomicalLimit> out;
    for (const auto& [name, entry] : anatomy().at("roles").items()) {
      if (const auto known = role_named(name)) out.emplace(*known, read_limit(entry, "ranges_deg"));
    }
    return out;
  }();
  const bool right = side_of(role) == Side::right;
  const auto found = limits.find(right ? mirrored(role) : role);
  if (found == limits.end()) return std::nullopt;
  AnatomicalLimit limit = found->second;
  if (right) {
    // The mirror x -> -x takes an axis of rotation (a, b, c) to (a, -b, -c).
    for (Vector3d& axis : limit.axes) axis = Vector3d(axis.x(), -axis.y(), -axis.z());
  }
  return limit;
}

AnatomicalLimit shared_spine_limit(std::size_t joints) { return shared_limit("spine", joints); }
AnatomicalLimit shared_neck_limit(std::size_t joints) { return shared_limit("neck", joints); }

}  // namespace limber
