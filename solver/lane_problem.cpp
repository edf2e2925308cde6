#include "solver/lane_problem.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "solver/ik_tree.h"

namespace limber {

namespace lanes_sse2 {
void follow_frame(const LaneProblem&, LaneState&, const double*);
std::size_t scratch_packs(const LaneProblem&);
}  // namespace lanes_sse2
#ifdef LIMBER_HAS_AVX2
namespace lanes_avx2 {
void follow_frame(const LaneProblem&, LaneState&, const double*);
}  // namespace lanes_avx2
#endif

namespace {

constexpr double kFloatDamping = 1e-5;  // what floats can tell from nothing
// rad: a float angle within half a turn and its half angle's cosine and sine are wrong by less
// than half of this together.
constexpr double kMargin = 1e-6;
constexpr double kThin = 16.0 * kMargin;

// The doubles that kernels read and write.
static_assert(sizeof(DualQuaternion) == 8 * sizeof(double));
static_assert(sizeof(EffectorTarget) % sizeof(double) == 0);
static_assert(offsetof(EffectorTarget, weight) == sizeof(DualQuaternion));

using Quaternions = std::array<Eigen::Quaterniond, 4>;

template <class Real>
void copy(const Eigen::Vector3d& from, Real (&to)[3]) {
  for (int i = 0; i < 3; ++i) to[i] = static_cast<Real>(from[i]);
}
template <class Real>
void copy(const Eigen::Quaterniond& from, Real (&to)[4]) {
  to[0] = static_cast<Real>(from.w());
  for (int i = 0; i < 3; ++i) to[i + 1] = static_cast<Real>(from.vec()[i]);
}

Eigen::Quaterniond pure(const Eigen::Vector3d& v) { return {0.0, v.x(), v.y(), v.z()}; }

LaneNode::Motion motion_of(const IkNode& node) {
  if (node.chart) return LaneNode::Motion::swing_twist;
  if (node.type == JointType::hinge) return LaneNode::Motion::hinge;
  if (node.type == JointType::universal) return LaneNode::Motion::universal;
  return LaneNode::Motion::turn;
}

/// What the four numbers of a motion are multiplied by.
Quaternions basis_of(const IkNode& node) {
  const Eigen::Quaterniond one = Eigen::Quaterniond::Identity();
  const Eigen::Quaterniond i = pure(node.axis0), j = pure(node.axis1);
  switch (motion_of(node)) {
    case LaneNode::Motion::hinge:
      return {one, i, pure(Eigen::Vector3d::Zero()), pure(Eigen::Vector3d::Zero())};
    case LaneNode::Motion::universal:
      return {one, i, j, i * j};
    default:
      return {one, pure(Eigen::Vector3d::UnitX()), pure(Eigen::Vector3d::UnitY()),
              pure(Eigen::Vector3d::UnitZ())};
  }
}

template <class Real>
LinearRotation<Real> linear(const Eigen::Quaterniond& before, const IkNode& node,
                            const Eigen::Quaterniond& after) {
  const Quaternions basis = basis_of(node);
  LinearRotation<Real> out;
  out.columns = motion_of(node) == LaneNode::Motion::hinge ? 2 : 4;
  for (int i = 0; i < 4; ++i) copy(before * basis[i] * after, out.column[i]);
  return out;
}

/// Rounding grows with the angle.
double margin(double bound) { return kMargin * std::max(1.0, std::abs(bound)); }

bool is_thin(const IkTree& tree, const IkNode& node) {
  for (std::int32_t k = node.coordinate; k < node.coordinate + node.coordinates; ++k) {
    if (tree.max[k] - tree.min[k] < kThin * std::max(1.0, std::abs(tree.max[k]))) return true;
  }
  const SwingEllipse& e = node.swing;
  return node.ellipse && std::min({-e.min0, e.max0, -e.min1, e.max1}) < kThin;
}

LaneNode lane_node(const IkTree& tree, const Rig& rig, std::size_t n) {
  const IkNode& node = tree.nodes[n];
  const RigJoint& joint = rig.joints[node.joint];
  LaneNode out;
  out.motion = motion_of(node);
  out.free = node.type == JointType::free;
  out.ellipse = node.ellipse;
  out.thin = is_thin(tree, node);
  out.parent = node.parent;
  out.joint = node.joint;
  out.coordinate = node.coordinate;
  out.coordinates = node.coordinates;
  out.first_child = tree.children_begin[n];
  out.last_child = tree.children_begin[n + 1];
  copy(node.offset, out.offset);
  copy(node.slide, out.slide);
  copy(node.before, out.before);
  copy(node.before * node.axis0, out.axis);
  copy(node.axis1, out.inner_axis);
  const double radius[2][2] = {{-node.swing.min0, node.swing.max0},
                               {-node.swing.min1, node.swing.max1}};
  for (int axis = 0; axis < 2; ++axis) {
    for (int side = 0; side < 2; ++side) {
      const double r = radius[axis][side];
      out.radius[axis][side] = static_cast<float>(std::max(r - margin(r), kMargin));
    }
  }
  out.parent_from_node = linear<float>(node.before, node, node.after);
  out.parent_from_joint = linear<double>(joint.rest * node.after.conjugate(), node, node.after);
  copy(0.5 * joint.offset, out.half_offset);
  return out;
}

std::vector<float> floats(const Eigen::VectorXd& v) {
  std::vector<float> out(static_cast<std::size_t>(v.size()));
  for (std::size_t k = 0; k < out.size(); ++k) out[k] = static_cast<float>(v[k]);
  return out;
}

float squared(double v) { return static_cast<float>(v * v); }

}  // namespace

LaneProblem::LaneProblem(const IkTree& tree, const Rig& rig, const IkOptions& options)
    : children(tree.children),
      min(floats(tree.min)),
      max(floats(tree.max)),
      middle(floats(tree.middle)),
      limited(floats(tree.limited)),
      armature(floats(tree.damping)),
      joints(rig.joints.size()),
      target_stride(sizeof(EffectorTarget) / sizeof(double)),
      stop_position2(squared(options.stop_position_m)),
      stop_rotation2(squared(options.stop_orientation_rad)),
      damping(static_cast<float>(std::max(options.damping, kFloatDamping))),
      extrapolate(options.extrapolate) {
  for (std::size_t k = 0; k < min.size(); ++k) {
    if (!std::isfinite(tree.min[k])) continue;
    const double middle_k = tree.middle[k];
    min[k] = static_cast<float>(std::min(tree.min[k] + margin(tree.min[k]), middle_k));
    max[k] = static_cast<float>(std::max(tree.max[k] - margin(tree.max[k]), middle_k));
  }
  for (std::size_t n = 0; n < tree.nodes.size(); ++n) {
    nodes.push_back(lane_node(tree, rig, n));
    nodes.back().first_effector = static_cast<std::int32_t>(carried.size());
    for (std::size_t e = 0; e < tree.effectors.size(); ++e) {
      if (tree.effectors[e].node == std::int32_t(n)) carried.push_back(std::int32_t(e));
    }
    nodes.back().last_effector = static_cast<std::int32_t>(carried.size());
  }
  for (const IkEffector& effector : tree.effectors) {
    LaneEffector out;
    out.node = effector.node;
    out.strong = effector.strong;
    copy(effector.offset, out.offset);
    copy(effector.rotation, out.rotation);
    out.weight_pos = effector.weight_pos;
    out.weight_rot = effector.weight_rot;
    effectors.push_back(out);
  }
}

LaneState::LaneState(const LaneProblem& p)
    : x(p.min.size(), Pack{}),
      last(x),
      before(x),
      turn(4 * p.nodes.size(), Pack{}),
      last_turn(turn),
      before_turn(turn),
      goal_position(3 * p.effectors.size(), Pack{}),
      goal_rotation(4 * p.effectors.size(), Pack{}),
      mass(p.effectors.size(), Pack{}),
      inertia(mass),
      scratch(lanes_sse2::scratch_packs(p), Pack{}),
      fresh{},
      damping{},
      missed{},
      relinearisations{},
      tree_passes{} {}

std::span<const NamedLaneKernel> lane_kernels() {
  static const std::vector<NamedLaneKernel> kernels = [] {
    std::vector<NamedLaneKernel> all;
#ifdef LIMBER_HAS_AVX2
    if (__builtin_cpu_supports("avx2")) all.push_back({"avx2", lanes_avx2::follow_frame});
#endif
    all.push_back({"sse2", lanes_sse2::follow_frame});
    return all;
  }();
  return kernels;
}

}  // namespace limber
