#pragma once

#include <memory>
#include <string>
#include <vector>

#include "tests/bench/peers/contestant.h"

namespace limber::peers {

struct ContestOptions {
  int rounds = 5;
  /// What one contestant may spend on one workload, about; it cuts rounds first, then frames.
  double budget_s = 3.0;
};

/// One contestant on one workload.
struct Score {
  std::string name;
  std::string setting;
  bool ours = false;   ///< Limber's default solver, whatever its start
  std::string absent;  ///< why there are no figures; empty where there are
  Start start = Start::previous;
  std::size_t frames = 0;  ///< solved, from the first on
  int rounds = 0;
  std::vector<double> us;  ///< [frame] median over the rounds
  double us_median = 0.0, us_mean = 0.0, us_p99 = 0.0;
  double iterations_mean = 0.0;
  double position_mm_median = 0.0, position_mm_p99 = 0.0;
  double orientation_deg_median = 0.0, orientation_deg_p99 = 0.0;
  double success = 0.0;         ///< share of frames: within tolerance and limits
  std::int64_t violations = 0;  ///< joint-frames beyond 1e-4 rad
  double max_violation_deg = 0.0;
  double jerk_ratio = 0.0;  ///< largest second difference of any joint, over the truth's; 0: none
  std::size_t heap_bytes = 0;  ///< held after preparing and one frame
};

/// All contestants on one workload, in turns: round after round each solves the whole set, and a
/// frame's time is its median over the rounds.
std::vector<Score> hold_contest(const Workload&, std::vector<std::unique_ptr<Contestant>>&,
                                const ContestOptions&);

}  // namespace limber::peers
