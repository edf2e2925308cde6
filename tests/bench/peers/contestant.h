#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "assets/model/clip.h"
#include "assets/model/result.h"
#include "pipeline/workload.h"

namespace limber::peers {

/// From where a frame of a motion is solved. Sets of lone poses always start at rest.
enum class Start { previous, extrapolated };

/// What a contestant made of the first frames of a workload.
struct Answer {
  Clip clip;                    ///< parent_from_joint, one row per frame
  std::vector<double> us;       ///< [frame] from targets to solution, start included
  std::vector<int> iterations;  ///< [frame] linearisations, or passes over the joints
};

/// One entry of the comparison. A new solver joins by its line in `all_contestants`.
class Contestant {
 public:
  virtual ~Contestant() = default;

  virtual std::string name() const = 0;
  /// Its setting in a few words, printed above the table: nobody is to be beaten by neglect.
  virtual std::string setting() const = 0;
  /// Limber's default solver, the measure of all others.
  virtual bool ours() const { return false; }
  virtual Start start() const { return Start::previous; }

  /// Takes a workload, which outlives this; nothing of it is timed. Error: a rig that it cannot do.
  virtual Result<void> prepare(const Workload&) = 0;
  /// Solves the first `frames` frames from the workload's start, as if for the first time: every
  /// call gives the same clip.
  virtual Answer solve_all(std::size_t frames) = 0;
};

}  // namespace limber::peers
