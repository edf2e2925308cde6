#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "pipeline/clip_refinement.h"
#include "pipeline/effectors.h"
#include "pipeline/self_contacts.h"
#include "pipeline/target.h"
#include "validation/limit_check.h"

namespace limber {

enum class SolverChoice : std::uint8_t { pgs, pgs_paper, ceres };
enum class RefineMode : std::uint8_t { none, frame, clip };

struct RetargetOptions {
  EffectorOptions effectors;
  SolverChoice solver = SolverChoice::pgs;
  RefineMode refine = RefineMode::frame;
  bool limits = true;
  bool collision = true;
  bool cycles = true;  ///< clips that go round are solved as what they are
  /// Frames [first, last] of the result to keep. Ground, contacts and scale come from the whole
  /// clip, so that a range gives the frames that the whole clip gives.
  std::optional<std::pair<std::int64_t, std::int64_t>> range;
};

struct EffectorError {
  std::string name;
  std::int64_t reachable_frames = 0;
  std::vector<double> position_mm, orientation_deg;  ///< [frame]; empty where it has no such target
};

struct SolverFigures {
  std::string name;
  std::vector<double> relinearisations;  ///< [frame of the whole clip], all passes together
  std::int64_t tree_passes = 0, sweeps = 0;
  double residual_max = 0.0;
};

/// A joint whose source rotation lies beyond the target's limits.
struct BentJoint {
  std::string joint;
  JointExcess excess;
};

/// A joint that stands on a limit.
struct JointAtLimit {
  std::string joint;
  std::int64_t frames = 0;
};

struct RefineFigures {
  std::vector<double> gap_percent;  ///< one per checked frame
  std::vector<std::int64_t> frames;
  std::optional<ClipRefinement> clip;  ///< RefineMode::clip
};

/// A clip that goes round (source_cycle.h).
struct CycleFigures {
  std::int64_t period = 0;             ///< frames
  bool repeats_first = false;          ///< its last frame is its first once more
  double way_m = 0.0, turn_deg = 0.0;  ///< of the source in a lap, over the floor
  /// How much the result of a frame and that of the same frame a lap later differ: the joint that
  /// does so most, relative to its parent, and the root's height.
  double seam_deg = 0.0, seam_mm = 0.0;
};

struct Retargeted {
  Clip clip;      ///< on the target's skeleton
  Rig rig;        ///< the target's rig with this clip's effectors
  Clip rig_clip;  ///< the same motion on the rig's rows
  EffectorTrack track;
  std::vector<EffectorError> errors;   ///< strong effectors
  std::vector<double> worst_error_mm;  ///< [frame], over strong effectors
  SolverFigures solver;
  std::vector<BentJoint> bent;                      ///< most frames first
  std::vector<JointAtLimit> at_limit;               ///< most frames first
  double source_excess_deg = 0.0;                   ///< largest, of the bent joints
  std::vector<double> frame_excess_deg;             ///< [frame] the source's, largest of any joint
  std::vector<std::int32_t> frame_joints_at_limit;  ///< [frame] how many stand on a limit
  SelfContactFigures self_contacts;
  std::optional<CycleFigures> cycle;
  RefineFigures refine;
  Warnings warnings;
};

/// Retargets one clip: extracts effectors, solves every frame within limits, measures the gap to
/// Ceres or puts the whole clip's optimum in its place. The source's clip must be on its
/// character's skeleton.
Result<Retargeted> retarget_clip(const SourceMotion&, const Target&, const RetargetOptions&);

}  // namespace limber
