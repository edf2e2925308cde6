#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "assets/model/dual_quaternion.h"

namespace limber {

/// One solution of a run of frames: poses and their costs.
struct Pass {
  Pass(std::int64_t frames, std::size_t rows);

  std::span<DualQuaternion> pose(std::int64_t frame) {
    return {poses.data() + frame * std::int64_t(rows), rows};
  }
  std::span<const DualQuaternion> pose(std::int64_t frame) const {
    return {poses.data() + frame * std::int64_t(rows), rows};
  }
  std::int64_t frames() const { return std::int64_t(cost.size()); }

  std::size_t rows = 0;
  std::vector<DualQuaternion> poses;  ///< [frame * rows + row], row local
  std::vector<double> cost;           ///< [frame], m^2
};

/// True where two passes have one solution of a frame.
bool same_solution(const Pass&, const Pass&, std::int64_t frame);

/// The cheapest way through the frames that takes each of them from one of the passes, where a
/// change of pose costs 0.01 m^2 per squared radian (dynamic programming over frames).
std::vector<DualQuaternion> join_passes(std::span<const Pass* const>);

}  // namespace limber
