#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "assets/model/result.h"
#include "assets/model/rig.h"

namespace limber {

/// Where one effector is to go, world space. What is absent is left free; at least one is there.
struct TargetRow {
  std::int32_t effector = 0;                   ///< row of Rig::effectors
  std::optional<Eigen::Vector3d> position;     ///< m
  std::optional<Eigen::Quaterniond> rotation;  ///< unit
  double weight = 1.0;                         ///< >= 0, scales the effector's own weights
};

enum class PoseStart : std::uint8_t { rest, previous };

/// One pose that is asked of a rig: at most one row per effector.
struct PoseTargets {
  std::string name;
  PoseStart start = PoseStart::rest;
  std::vector<TargetRow> rows;
};

/// A file of format `limber/targets/1` (assets/data/schemas/targets.schema.json).
struct TargetsFile {
  std::string description;
  std::vector<PoseTargets> poses;  ///< at least one
};

/// Parses targets for a rig. Rows given relative to where effectors stand at rest (q = 0), or in
/// the `posture` that a pose names, come back in world space.
/// Errors, with the JSON pointer: `targets-json`; `targets-effector` and `targets-joint` for names
/// that the rig does not have.
Result<TargetsFile> read_targets_json(std::string_view text, const Rig&);

}  // namespace limber
