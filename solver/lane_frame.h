// What a lane kernel works on: one frame in eight lanes. Its parts are lane_transfer.h (doubles in
// and out), lane_kinematics.h and lane_elimination.h; lane_kernel.h is the outer loop.
#pragma once

#include "solver/lane.h"
#include "solver/lane_problem.h"
#include "solver/spatial_inertia.h"

namespace limber::LIMBER_LANES {
namespace {

using Vector6L = Vector6T<Lane>;
using Matrix3 = Eigen::Matrix<Lane, 3, 3>;

/// A swing held on its ellipse's border; see tree_elimination.cpp.
struct Swing {
  Lane active;  ///< 0 or 1
  Lane point0, point1, normal0, normal1, curvature;
  Lane press, next_press;  ///< multiplier of the normal, for this elimination and the next
};
struct NodeWork {
  Quaternion rotation;  ///< world_from_node
  Vector3 position;
  /// What the motion is made of. hinge: cos, sin of the half angle; universal: of both; turn: the
  /// quaternion (w, x, y, z); swing_twist: cos and sin / angle of the swing's half angle, then cos
  /// and sin of the twist's.
  Lane factor[4];
  SpatialInertia<Lane> outside;  ///< felt by the parent
  Vector6L bias, twist;
  Swing swing;
  bool dirty;  ///< limits changed in some lane since its elimination
};
struct CoordinateWork {
  Vector6L axis;    ///< twist of a unit step
  Vector6L turned;  ///< swings of an ellipse: that of the tangent and the normal, where held
  Vector6L momentum;
  Lane inverse, drive, diagonal, held, locked, multiplier;
  Lane lock;                ///< -1, 0, 1: held at min, free, held at max
  Lane step, anchor, kept;  ///< kept: x before the step
};
struct EffectorWork {
  Vector3 point, position, rotation;  ///< where it is, errors
  Vector3 arm;                        ///< from the origin of twists to the point
  Vector6L pull;
};

inline Quaternion quaternion(const float* q) { return {q[0], q[1], q[2], q[3]}; }
inline Vector3 vector(const float* v) { return {v[0], v[1], v[2]}; }
inline Lane& lane(Pack& p) { return reinterpret_cast<Lane&>(p); }
inline const Lane& lane(const Pack& p) { return reinterpret_cast<const Lane&>(p); }
inline Mask is_set(const Lane& flag) { return flag > Lane(0.5f); }
inline Lane flag(Mask m) { return select(m, Lane(1), Lane(0)); }

/// What is felt of a part of the tree from its inner side.
struct Felt {
  const SpatialInertia<Lane>* inertia;
  const Vector6L* bias;
};

class Frame {
 public:
  Frame(const LaneProblem& p, LaneState& s) : p_(p), s_(s) {
    auto* memory = reinterpret_cast<char*>(s.scratch.data());
    node_ = reinterpret_cast<NodeWork*>(memory);
    coordinate_ = reinterpret_cast<CoordinateWork*>(node_ + p.nodes.size());
    effector_ = reinterpret_cast<EffectorWork*>(coordinate_ + p.min.size());
  }
  static std::size_t packs(const LaneProblem& p) {
    return (p.nodes.size() * sizeof(NodeWork) + p.min.size() * sizeof(CoordinateWork) +
            p.effectors.size() * sizeof(EffectorWork)) /
           sizeof(Pack);
  }

  void follow(const double* targets);

 private:
  Lane& x(std::int32_t k) { return lane(s_.x[k]); }
  static Quaternion turn(const std::vector<Pack>& turns, std::size_t n) {
    const Pack* q = &turns[4 * n];
    return {lane(q[0]), lane(q[1]), lane(q[2]), lane(q[3])};
  }
  void set_turn(std::size_t n, const Quaternion& q, Mask lanes);

  // lane_transfer.h
  void read_goals(const double* targets);
  void write_poses();
  void write_pose(const LaneNode&, const NodeWork&, int half);

  // lane_kinematics.h
  void start();
  void start_fresh(Mask fresh);
  Quaternion motion(const LaneNode&, std::size_t n);
  void evaluate();
  Mask done() const;
  Lane cost() const;
  void linearise(Mask lanes);
  void linearise_ball(std::size_t n, std::int32_t k, const Vector3& p);
  void load();
  void turn_by_step(const LaneNode&, std::size_t n, Mask lanes, const Lane& scale);
  void move(Mask lanes);
  void put_back(Mask lanes);
  void project(Mask lanes);

  // lane_elimination.h
  void prepare(std::size_t n, const Lane& damping);
  Felt collect(std::size_t n);
  void eliminate(std::size_t n, const Lane& damping);
  Lane substitute();
  Mask update_box(std::size_t n, Mask lanes, bool may_release);
  Mask update_swing(std::size_t n, Mask lanes, bool may_release, const Lane& slide_tolerance,
                    float bend);
  void solve(const Lane& damping, Mask lanes, bool early);

  const LaneProblem& p_;
  LaneState& s_;
  NodeWork* node_;
  CoordinateWork* coordinate_;
  EffectorWork* effector_;
};

}  // namespace
}  // namespace limber::LIMBER_LANES
