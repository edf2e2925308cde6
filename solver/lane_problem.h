#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "solver/ik_tree.h"

namespace limber {

inline constexpr int kLanes = 8;

/// One number per lane. Plain storage: only a lane kernel computes with it.
struct alignas(32) Pack {
  float lane[kLanes];
};

/// An IkTree in floats, laid out for a lane kernel.
struct LaneNode {
  bool chart = false, ellipse = false, free = false, turns = false;  ///< turns: by a quaternion
  bool universal = false, root = false;
  std::int32_t parent = -1, coordinate = 0, coordinates = 0, first_child = 0, last_child = 0;
  float offset[3], slide[4], before[4], after[4], axis0[3], axis1[3];  ///< quaternions w, x, y, z
  float swing_min[2], swing_max[2];
};
struct LaneEffector {
  std::int32_t node = -1;
  bool strong = true;
  float offset[3], rotation[4];
};

/// What every lane shares, and what a frame needs of the options.
struct LaneProblem {
  explicit LaneProblem(const IkTree&);

  std::vector<LaneNode> nodes;
  std::vector<std::int32_t> children;
  std::vector<LaneEffector> effectors;
  std::vector<float> min, max, middle, limited, armature;  ///< [coordinate]
  float stop_position2 = 0, stop_rotation2 = 0;            ///< m^2, rad^2
  float ease = 0, calm = 0, damping = 0;
  bool extrapolate = true;
};

/// What differs by lane. The kernel's scratch is in here too, so that a frame allocates nothing.
struct LaneState {
  explicit LaneState(const LaneProblem&);

  std::vector<Pack> x, last, before;               ///< [coordinate]
  std::vector<Pack> turn, last_turn, before_turn;  ///< [node * 4] where the node turns
  std::vector<Pack> goal_position, goal_rotation;  ///< [effector * 3], [effector * 4]
  std::vector<Pack> mass, inertia;                 ///< [effector] m^2
  std::vector<Pack> scratch;
  int answers = 0;                            ///< how many of `last`, `before` hold one
  Pack damping;                               ///< as the last frame left it
  std::uint8_t missed[kLanes];                ///< out: not within tolerance
  int relinearisations = 0, tree_passes = 0;  ///< out: of the lane that took most
};

/// One frame in every lane: from last and before to x.
using LaneKernel = void (*)(const LaneProblem&, LaneState&);

/// The kernels that this processor can run, the fastest first. All give the same bytes.
struct NamedLaneKernel {
  const char* level;
  LaneKernel follow;
};
std::span<const NamedLaneKernel> lane_kernels();

}  // namespace limber
