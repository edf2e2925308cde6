#include "solver/lane_problem.h"

#include <algorithm>

namespace limber {

namespace lanes_sse2 {
void follow_frame(const LaneProblem&, LaneState&);
std::size_t scratch_packs(const LaneProblem&);
}  // namespace lanes_sse2
#ifdef LIMBER_HAS_AVX2
namespace lanes_avx2 {
void follow_frame(const LaneProblem&, LaneState&);
}  // namespace lanes_avx2
#endif

namespace {

void copy(const Eigen::Vector3d& from, float (&to)[3]) {
  for (int i = 0; i < 3; ++i) to[i] = static_cast<float>(from[i]);
}
void copy(const Eigen::Quaterniond& from, float (&to)[4]) {
  to[0] = static_cast<float>(from.w());
  for (int i = 0; i < 3; ++i) to[i + 1] = static_cast<float>(from.vec()[i]);
}

LaneNode lane_node(const IkTree& tree, std::size_t n) {
  const IkNode& node = tree.nodes[n];
  LaneNode out;
  out.chart = node.chart;
  out.ellipse = node.ellipse;
  out.free = node.type == JointType::free;
  out.turns = !node.chart && (node.type == JointType::ball || out.free);
  out.universal = node.type == JointType::universal;
  out.parent = node.parent;
  out.coordinate = node.coordinate;
  out.coordinates = node.coordinates;
  out.first_child = tree.children_begin[n];
  out.last_child = tree.children_begin[n + 1];
  copy(node.offset, out.offset);
  copy(node.slide, out.slide);
  copy(node.before, out.before);
  copy(node.after, out.after);
  copy(node.axis0, out.axis0);
  copy(node.axis1, out.axis1);
  out.swing_min[0] = static_cast<float>(node.swing.min0);
  out.swing_max[0] = static_cast<float>(node.swing.max0);
  out.swing_min[1] = static_cast<float>(node.swing.min1);
  out.swing_max[1] = static_cast<float>(node.swing.max1);
  return out;
}

std::vector<float> floats(const Eigen::VectorXd& v) {
  std::vector<float> out(static_cast<std::size_t>(v.size()));
  for (std::size_t k = 0; k < out.size(); ++k) out[k] = static_cast<float>(v[k]);
  return out;
}

}  // namespace

LaneProblem::LaneProblem(const IkTree& tree)
    : children(tree.children),
      min(floats(tree.min)),
      max(floats(tree.max)),
      middle(floats(tree.middle)),
      limited(floats(tree.limited)),
      armature(floats(tree.damping)) {
  for (std::size_t n = 0; n < tree.nodes.size(); ++n) nodes.push_back(lane_node(tree, n));
  for (const IkEffector& effector : tree.effectors) {
    LaneEffector out;
    out.node = effector.node;
    out.strong = effector.strong;
    copy(effector.offset, out.offset);
    copy(effector.rotation, out.rotation);
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
      damping{},
      missed{} {
  std::fill(std::begin(damping.lane), std::end(damping.lane), p.damping);
}

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
