#pragma once

#include <filesystem>
#include <string>

namespace limber {

/// `limber bench WORKLOAD.json[.gz]`: one inverse-kinematics workload (format ikwork/1), one
/// solver. An iteration is one relinearisation; of Ceres, one of its own.
struct BenchArgs {
  std::filesystem::path workload;
  std::string solver = "pgs";         ///< pgs, pgs-paper or ceres
  bool pos = false;                   ///< judge and pull positions alone (weight_rot := 0)
  std::string start = "extrapolate";  ///< or previous: the last solution as it is
  bool cycle = false;     ///< the workload is a cycle, solved as one (solver/ik_cycle.h)
  int lanes = 1;          ///< the clip is cut into so many runs, each starting at its truth
  double stop_mm = 0.0;   ///< > 0: tolerance at which the solver may stop; else the workload's
  double stop_deg = 0.0;  ///< likewise
  int sweeps = 0;         ///< > 0: pgs-paper, per iteration; else the solver's default
  std::filesystem::path solutions;  ///< raw float64, frames x (ndof + 1), where not empty
  bool json = false;                ///< one JSON document on standard output, else a few lines
};

/// Prints the result on standard output, faults on standard error. Returns the exit code: 0, or 2
/// for a bad option, workload or output path.
int bench_command(const BenchArgs&);

}  // namespace limber
