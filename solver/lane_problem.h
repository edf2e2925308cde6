#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

// What a kernel sees is plain numbers: classes of Eigen's have another alignment at another SIMD
// level.
namespace limber {

class IkTree;
struct IkOptions;
struct Rig;

inline constexpr int kLanes = 8;

/// One number per lane. Plain storage: only a lane kernel computes with it.
struct alignas(32) Pack {
  float lane[kLanes];
};

/// A rotation that is linear in four numbers, the motion: its quaternion is the sum of
/// column[i] * motion[i]. By how the joint moves, the motion is
///  - hinge: (cos, sin) of its half angle;
///  - universal: the products (cos cos, sin cos, cos sin, sin sin) of its two half angles;
///  - swing_twist, turn: a quaternion (w, x, y, z).
template <class Real>
struct LinearRotation {
  int columns = 4;
  Real column[4][4];  ///< each (w, x, y, z)
};

/// A node of the IkTree in floats, laid out for a lane kernel. Quaternions are (w, x, y, z).
struct LaneNode {
  enum class Motion : std::uint8_t { hinge, universal, swing_twist, turn };
  Motion motion = Motion::hinge;
  bool free = false;     ///< a turn whose first three coordinates slide
  bool ellipse = false;  ///< the first two coordinates are bounded by `radius`
  bool thin = false;     ///< a range too narrow for floats: the answer is for doubles to give
  std::int32_t parent = -1, joint = 0, coordinate = 0, coordinates = 0;
  std::int32_t first_child = 0, last_child = 0;        ///< of LaneProblem::children
  std::int32_t first_effector = 0, last_effector = 0;  ///< of LaneProblem::carried
  float offset[3], slide[4], before[4];                ///< as IkNode's
  float axis[3];        ///< hinge, universal: the first axis, in the parent node's space
  float inner_axis[3];  ///< universal: the second one, in the node's
  float radius[2][2];   ///< of the ellipse: [axis][0: negative side, 1: positive], rad
  LinearRotation<float> parent_from_node;
  LinearRotation<double> parent_from_joint;  ///< of the rig: what a pose holds
  double half_offset[3];                     ///< half the rig joint's, for the dual part
};
struct LaneEffector {
  std::int32_t node = -1;
  bool strong = true;
  float offset[3], rotation[4];
  double weight_pos = 0.0, weight_rot = 0.0;
};

/// What every lane shares, and what a frame needs of the options. Ranges are narrower than the
/// rig's by what floats may be wrong, so that what keeps them in floats keeps the rig's in doubles.
struct LaneProblem {
  LaneProblem(const IkTree&, const Rig&, const IkOptions&);

  std::vector<LaneNode> nodes;
  std::vector<std::int32_t> children, carried;  ///< nodes; effectors
  std::vector<LaneEffector> effectors;
  std::vector<float> min, max, middle, limited, armature;  ///< [coordinate]
  std::size_t joints = 0;                                  ///< of the rig
  std::size_t target_stride = 0;                           ///< doubles from target to target
  float stop_position2 = 0, stop_rotation2 = 0;            ///< m^2, rad^2
  float damping = 0;
  bool extrapolate = true;
};

/// What differs by lane. The kernel's scratch is in here too, so that a frame allocates nothing.
struct LaneState {
  explicit LaneState(const LaneProblem&);

  std::vector<Pack> x, last, before;               ///< [coordinate] answers, newest first
  std::vector<Pack> turn, last_turn, before_turn;  ///< [node * 4] where the motion is a turn
  std::vector<Pack> goal_position, goal_rotation;  ///< [effector * 3], [effector * 4]
  std::vector<Pack> mass, inertia;                 ///< [effector] m^2
  std::vector<Pack> scratch;
  double* poses = nullptr;  ///< [(lane * joints + joint) * 8] out, where the joint is a node
  Pack fresh;    ///< 1: `last` is a start, not an answer: nothing is known of its active limits
  Pack damping;  ///< as the last frame left it
  Pack missed;   ///< out: 1 where not within tolerance
  Pack relinearisations, tree_passes;  ///< out
};

/// One frame in every lane: from last and before to x. `targets`: [(lane * effectors + effector) *
/// target_stride], EffectorTargets. They and the poses are a dual quaternion's eight doubles (real
/// x, y, z, w, dual likewise), a target's weight comes ninth.
using LaneKernel = void (*)(const LaneProblem&, LaneState&, const double* targets);

/// The kernels that this processor can run, the fastest first. All give the same bytes.
struct NamedLaneKernel {
  const char* level;
  LaneKernel follow;
};
std::span<const NamedLaneKernel> lane_kernels();

}  // namespace limber
