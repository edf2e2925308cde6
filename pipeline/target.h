#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "assets/model/character.h"
#include "assets/model/rig.h"
#include "importers/importer.h"
#include "pipeline/calibration.h"
#include "pipeline/figure.h"

namespace limber {

/// What motion is retargeted onto: a character (a rig's mannequin, a skinned file or a BVH's bare
/// skeleton), the figure it is, its calibrated T-pose and the limited rig that the solver moves.
struct Target {
  std::string label;  ///< file stem or shipped rig name
  std::string path;   ///< as the user gave it
  std::string sha256;
  Character character;
  Figure figure;
  Calibration calibration;
  /// Turns the canonical T-pose to a rig's own rest orientation (the rig `hand` points along +X);
  /// identity for figures that move freely.
  Eigen::Quaterniond world_from_t_pose{1, 0, 0, 0};
  /// Row i is joint `joint_of_row[i]` of the character's skeleton; parents follow the figure's own
  /// hierarchy, q = 0 is the calibrated T-pose, effectors are empty.
  Rig rig;
  std::vector<std::int32_t> joint_of_row;
  SourceFacts facts;
  Warnings warnings;
};

struct TargetOptions {
  bool limits = true;
  ImportOptions import;
  RoleOverrides roles;
};

/// A shipped rig by name, or nothing. Its text is in assets/data/rigs.
std::optional<Rig> shipped_rig(const std::string& name);
std::vector<std::string> shipped_rig_names();

/// A shipped rig's name, a rig JSON, a skinned character or a BVH. Errors keep the file's name.
Result<Target> load_target(const std::string& name_or_path, const TargetOptions&);

/// The rig of a calibrated figure: every joint with a role gets that role's anatomical limits
/// (assets/data/limits), turned into the joint's space by the calibration; the others are fixed.
Rig limited_rig(const Character&, const Figure&, const Calibration&, bool limits);

/// Forward kinematics of a rig's rows; the spans have one entry per row.
void model_from_rows(const Rig&, std::span<const DualQuaternion> row_local,
                     std::span<DualQuaternion> model_from_row);

/// A pose of a skeleton from a pose of a rig's rows, both local; row i is joint `joint_of_row[i]`.
void skeleton_local_from_rows(const Rig&, std::span<const std::int32_t> joint_of_row,
                              const Skeleton&, std::span<const DualQuaternion> row_local,
                              std::span<DualQuaternion> parent_from_joint);

/// A pose of the target's skeleton from a pose of the rig's rows, both local.
void skeleton_local_from_rig(const Target&, std::span<const DualQuaternion> row_local,
                             std::span<DualQuaternion> parent_from_joint);

}  // namespace limber
