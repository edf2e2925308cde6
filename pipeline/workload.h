#pragma once

#include <cstddef>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "assets/model/result.h"
#include "assets/model/rig.h"
#include "solver/ik_solver.h"

namespace limber {

/// An inverse-kinematics workload (format ikwork/1): a rig, and per frame one target for each of
/// its effectors, made from a pose that reaches them.
struct Workload {
  std::string name;  ///< rig and set
  Rig rig;
  bool rest_start = false;  ///< every frame starts at q = 0, else frame 0 at its truth
  double stop_pos = 1e-4, stop_rot = 8.7266e-4;        ///< m, rad: when a solver may stop
  double success_pos = 1e-3, success_rot = 8.7266e-3;  ///< m, rad: what counts as solved
  std::vector<std::vector<double>> truth_q;            ///< [frame][ndof]
  std::vector<std::vector<EffectorTarget>> targets;    ///< [frame][effector]
  std::size_t frames() const { return targets.size(); }
};

/// Reads a workload, plain or gzipped. Error: `bench-workload`.
Result<Workload> read_workload(const std::filesystem::path&);

/// How Limber is set up for a workload, wherever it is measured.
IkOptions options_for(const Workload&, IkMethod);

/// The largest miss of any strong effector, as far as its kind and weights ask for it.
struct EffectorMiss {
  double position_mm = 0.0, orientation_deg = 0.0;
};
EffectorMiss worst_miss(const Rig&, std::span<const EffectorTarget>,
                        std::span<const DualQuaternion> world_from_joint);

}  // namespace limber
