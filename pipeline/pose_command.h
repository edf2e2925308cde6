#pragma once

#include <filesystem>
#include <string>

#include "assets/model/rig.h"
#include "pipeline/retarget.h"

namespace limber {

/// `limber pose RIG --targets targets.json -o sheet.png`: a rig pulled to targets, as an artist
/// tries it, one picture per pose (Kenwright 2013, section III): ideal effectors red, reached ones
/// green.
struct PoseArgs {
  std::string rig;      ///< a shipped rig's name, a rig JSON or a character
  std::string targets;  ///< a file, or the name of a shipped one (assets/data/poses)
  std::filesystem::path sheet;
  SolverChoice solver = SolverChoice::pgs;
  bool example = false;  ///< print targets to start from, and do no more
  bool json = false;     ///< one JSON document on standard output, else a few lines
};

/// Exit code 0 also where targets are out of reach: the best reach is the answer. 1: a pose broke a
/// limit or is not finite; 2: the rig or the targets cannot be used; 3: the sheet cannot be
/// written.
int pose_command(const PoseArgs&);

/// Targets for the rig that show what the format can say. The rig has at least one effector.
std::string example_targets(const Rig&);

}  // namespace limber
