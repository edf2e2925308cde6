#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "assets/model/rig.h"
#include "pipeline/calibration.h"
#include "pipeline/figure.h"
#include "pipeline/target.h"
#include "solver/ik_solver.h"

namespace limber {

enum class RootMode : std::uint8_t { scale, keep, in_place };
enum class FingerMode : std::uint8_t { rest, curl };

/// A clip and the figure that performs it.
struct SourceMotion {
  const Character* character = nullptr;
  const Figure* figure = nullptr;
  const Calibration* calibration = nullptr;
  const Clip* clip = nullptr;
};

struct EffectorOptions {
  RootMode root = RootMode::scale;
  FingerMode fingers = FingerMode::rest;
  bool contacts = true;
};

/// What the solver is asked for, frame by frame.
struct EffectorTrack {
  std::vector<RigEffector> effectors;  ///< on the target rig's rows
  std::int64_t frames = 0;
  std::vector<EffectorTarget> targets;  ///< [frame * effectors + effector]
  /// First guess: the source's calibrated rotations on the target's bones, fingers within their
  /// limits, the rest not yet.
  std::vector<DualQuaternion> guess;   ///< [frame * rows + row], row local
  std::vector<DualQuaternion> unbent;  ///< the same before fingers were bent into their limits
  double scale = 1.0;                  ///< target size / source size (leg, or hand length)
  double ground_offset = 0.0;          ///< y of the source's floor (m)
  double floor_y = 0.0;                ///< y of the output's floor; 0 but for a figure's own clip
  std::vector<std::uint8_t> left_contact, right_contact;  ///< [frame]

  std::span<const EffectorTarget> at(std::int64_t frame) const {
    return {targets.data() + frame * std::int64_t(effectors.size()), effectors.size()};
  }
};

/// Extracts per-frame effectors from a source and scales them to the target's limbs. Feet that
/// stand still in the source are pinned; soles stay on or above the floor.
/// Error: `map-figures-differ`.
Result<EffectorTrack> extract_effectors(const SourceMotion&, const Target&, const EffectorOptions&);

}  // namespace limber
