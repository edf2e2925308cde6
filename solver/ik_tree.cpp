// Coordinates, kinematics and twists.
//
// A coordinate k of a node moves everything outside it by the twist S_k = (a, (p - o) x a): a is
// its axis in world space, p the node's position, o the origin of all twists. A point r then moves
// by v + a x (r - o). By type, with Q = world_from_parent before:
//  - hinge: a = Q axis0.   universal: a = Q axis0 and Q R0 axis1.
//  - limited ball, R = exp(s) exp(t z), s = (s0, s1, 0) in its triad: turning by ds turns the joint
//    by Jl(s) ds from the left, Jl(s) = A 1 + B [s] + C s s',
//    A = sin|s| / |s|, B = (1 - cos|s|) / |s|^2, C = (1 - A) / |s|^2, and dt turns it about exp(s)
//    z.
//  - ball and free without limits: R <- exp(d) R, the axes are Q's own.
//  - free translation: S = (0, axes of the parent).
// The limits are then a box and an ellipse in coordinates, exact and convex.
#include "solver/ik_tree.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "assets/model/eye_head_shoulder.h"
#include "solver/half_angle.h"

namespace limber {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNoWidth = 1e-9;         // rad
constexpr double kMetresPerRadian = 0.1;  // of the effector cost (DESIGN section 3)

constexpr double kSeriesAngle2 = 16.0;  // rad^2: half_angle() holds, with a margin

/// About a unit axis. The quaternion's sign is of no account, so whole turns may be dropped.
Eigen::Quaterniond about(const Eigen::Vector3d& axis, double angle) {
  if (std::abs(angle) > M_PI) angle -= 2.0 * M_PI * std::round(angle / (2.0 * M_PI));
  const HalfAngle<double> half = half_angle(angle * angle);
  const double s = half.sinc * angle;
  return {half.cosine, s * axis.x(), s * axis.y(), s * axis.z()};
}

Eigen::Quaterniond exp_of(const Eigen::Vector3d& v) {
  const double angle2 = v.squaredNorm();
  if (angle2 < kSeriesAngle2) {
    const HalfAngle<double> half = half_angle(angle2);
    return {half.cosine, half.sinc * v.x(), half.sinc * v.y(), half.sinc * v.z()};
  }
  const double angle = std::sqrt(angle2), f = std::sin(0.5 * angle) / angle;
  return {std::cos(0.5 * angle), f * v.x(), f * v.y(), f * v.z()};
}

/// Rotation vector of a unit quaternion, the short way.
Eigen::Vector3d log_of(const Eigen::Quaterniond& q) {
  const double n2 = q.vec().squaredNorm();
  const double sign = q.w() < 0.0 ? -1.0 : 1.0;
  if (n2 < 0.01) {  // 2 asin(n) / n
    constexpr double c[] = {2.0,          1.0 / 3.0,     3.0 / 20.0,     5.0 / 56.0,
                            35.0 / 576.0, 63.0 / 1408.0, 231.0 / 6656.0, 143.0 / 5120.0};
    double sum = c[7];
    for (int k = 6; k >= 0; --k) sum = sum * n2 + c[k];
    return (sign * sum) * q.vec();
  }
  const double n = std::sqrt(n2);
  return (sign * 2.0 * std::atan2(n, sign * q.w()) / n) * q.vec();
}

/// The shortest rotation vector that turns unit a to unit b.
Eigen::Vector3d turn(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  const Eigen::Vector3d across = a.cross(b);
  const double sine = across.norm(), cosine = a.dot(b);
  if (sine > 1e-12) return (std::atan2(sine, cosine) / sine) * across;
  if (cosine > 0.0) return across;
  return M_PI * a.unitOrthogonal();  // opposite: any way round
}

Eigen::Quaterniond triad_of(const RigJoint& joint) {
  Eigen::Matrix3d m;
  m << joint.axes[0], joint.axes[1], joint.axes[2];
  return Eigen::Quaterniond(m).normalized();
}

Eigen::Quaterniond swing_twist_motion(double s0, double s1, double twist) {
  const Eigen::Quaterniond swing = exp_of({s0, s1, 0.0});
  if (std::abs(twist) > M_PI) twist -= 2.0 * M_PI * std::round(twist / (2.0 * M_PI));
  const HalfAngle<double> half = half_angle(twist * twist);
  const double k = half.cosine, m = half.sinc * twist;
  return {swing.w() * k, swing.x() * k + swing.y() * m, swing.y() * k - swing.x() * m,
          swing.w() * m};
}

/// Which joints carry an effector or what rows act on.
std::vector<char> felt_joints(const Rig& rig, bool collision) {
  std::vector<char> felt(rig.joints.size(), 0);
  for (const RigEffector& effector : rig.effectors) {
    felt[effector.joint] = 1;
    if (effector.relative_to != kNoJoint) felt[effector.relative_to] = 1;
  }
  for (const Coupling& coupling : rig.couplings) {
    felt[coupling.from_joint] = felt[coupling.to_joint] = 1;
  }
  if (collision) {
    for (const CollisionPair& pair : collision_pairs(rig)) {
      felt[pair.joint_a] = felt[pair.joint_b] = 1;
    }
  }
  for (std::int32_t i = rig.size() - 1; i >= 0; --i) {
    if (felt[i] && rig.joints[i].parent >= 0) felt[rig.joints[i].parent] = 1;
  }
  return felt;
}

}  // namespace

IkTree::IkTree(const Rig& rig, bool collision) : rig_(rig) {
  const std::vector<char> felt = felt_joints(rig, collision);
  // node_of[i]: the nearest moving joint at or above i; below it everything is rigid.
  node_of.assign(rig.joints.size(), -1);
  node_from_joint.resize(rig.joints.size());
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    const RigJoint& joint = rig.joints[i];
    if (!felt[i] || joint.type == JointType::fixed) outside.push_back(i);
    if (!felt[i]) continue;
    const std::int32_t above = joint.parent < 0 ? -1 : node_of[joint.parent];
    const DualQuaternion rigid =
        joint.parent < 0 ? DualQuaternion::identity() : node_from_joint[joint.parent];
    if (joint.type == JointType::fixed) {
      node_of[i] = above;
      node_from_joint[i] =
          rigid * DualQuaternion::from_rotation_translation(joint.rest, joint.offset);
      continue;
    }
    add_node(joint, i, above, rigid);
    node_of[i] = static_cast<std::int32_t>(nodes.size()) - 1;
    node_from_joint[i] = DualQuaternion::identity();
  }
  for (const RigEffector& effector : rig.effectors) {
    effectors.push_back(
        make_effector(effector, node_of[effector.joint], node_from_joint[effector.joint]));
  }
  // Where no effector pulls, rows alone do: such joints are not eased towards their middle.
  std::vector<char> pulled(nodes.size(), 0);
  for (const IkEffector& effector : effectors) {
    for (std::int32_t n = effector.node; n >= 0 && !pulled[n]; n = nodes[n].parent) pulled[n] = 1;
  }
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    if (!pulled[n]) limited.segment(nodes[n].coordinate, nodes[n].coordinates).setZero();
  }
  children_begin.assign(nodes.size() + 1, 0);
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    for (std::size_t c = n + 1; c < nodes.size(); ++c) {
      if (nodes[c].parent == std::int32_t(n)) children.push_back(static_cast<std::int32_t>(c));
    }
    children_begin[n + 1] = static_cast<std::int32_t>(children.size());
  }
}

void IkTree::add_node(const RigJoint& joint, std::int32_t index, std::int32_t parent_node,
                      const DualQuaternion& node_from_parent_joint) {
  IkNode node;
  node.type = joint.type;
  node.joint = index;
  node.parent = parent_node;
  node.coordinate = coordinate_count();
  node.coordinates = dof_count(joint.type);
  node.offset = node_from_parent_joint.transform_point(joint.offset);
  node.slide = node_from_parent_joint.rotation();
  node.before = node_from_parent_joint.rotation() * joint.rest;
  node.after = Eigen::Quaterniond::Identity();
  node.axis0 = joint.axes[0];
  node.axis1 = joint.axes[1];
  node.chart = joint.type == JointType::ball && joint.limited();
  if (node.chart) {
    const Eigen::Quaterniond triad = triad_of(joint);
    node.before = node.before * triad;
    node.after = triad.conjugate();
    node.swing = SwingEllipse::of(joint);
    // An ellipse without width is a range.
    node.ellipse = node.swing.max0 - node.swing.min0 > kNoWidth &&
                   node.swing.max1 - node.swing.min1 > kNoWidth;
  }
  node.local = joint.rest * node.after.conjugate();
  const Eigen::Index first = node.coordinate, count = first + node.coordinates;
  min.conservativeResize(count);
  max.conservativeResize(count);
  damping.conservativeResize(count);
  min.tail(node.coordinates).setConstant(-kInfinity);
  max.tail(node.coordinates).setConstant(kInfinity);
  damping.tail(node.coordinates).setConstant(joint.weight);
  for (int k = 0; k < node.coordinates && k < 3; ++k) {
    const bool boxed = joint.type == JointType::hinge || joint.type == JointType::universal ||
                       (node.chart && k == 2);
    if (boxed && is_limited(joint.limits[k])) {
      min[first + k] = joint.limits[k].min;
      max[first + k] = joint.limits[k].max;
    }
  }
  if (node.chart && !node.ellipse) {
    const bool wide0 = node.swing.max0 - node.swing.min0 > kNoWidth;
    const bool wide1 = node.swing.max1 - node.swing.min1 > kNoWidth;
    min[first] = wide0 ? node.swing.min0 : 0.0;
    max[first] = wide0 ? node.swing.max0 : 0.0;
    min[first + 1] = wide1 ? node.swing.min1 : 0.0;
    max[first + 1] = wide1 ? node.swing.max1 : 0.0;
  }
  middle.conservativeResize(count);
  limited.conservativeResize(count);
  for (Eigen::Index k = first; k < count; ++k) {
    limited[k] = std::isfinite(min[k]) || (node.ellipse && k < first + 2) ? 1.0 : 0.0;
    middle[k] = std::isfinite(min[k]) ? 0.5 * (min[k] + max[k]) : 0.0;
  }
  if (node.ellipse) {
    middle[first] = 0.5 * (node.swing.min0 + node.swing.max0);
    middle[first + 1] = 0.5 * (node.swing.min1 + node.swing.max1);
  }
  nodes.push_back(node);
}

IkEffector make_effector(const RigEffector& in, std::int32_t node,
                         const DualQuaternion& node_from_joint) {
  const bool placed = in.kind == EffectorKind::pose || in.kind == EffectorKind::position ||
                      in.kind == EffectorKind::line;
  const bool turned = in.kind != EffectorKind::position;
  IkEffector out;
  out.node = node;
  out.kind = in.kind;
  out.strong = in.strong;
  out.offset = node_from_joint.transform_point(in.offset);
  out.rotation = node_from_joint.rotation();
  out.axis = in.axis.normalized();
  out.weight_pos = placed ? in.weight_pos : 0.0;
  out.weight_rot = turned ? kMetresPerRadian * in.weight_rot : 0.0;
  return out;
}

IkGoal make_goal(const IkEffector& effector, const EffectorTarget& target) {
  IkGoal goal;
  goal.position = target.pose.translation();
  goal.rotation = target.pose.rotation();
  goal.axis = goal.rotation * effector.axis;
  const double wp = target.weight * effector.weight_pos;
  const double wr = target.weight * effector.weight_rot;
  goal.mass = wp * wp;
  goal.inertia = wr * wr;
  return goal;
}

void measure_error(const IkEffector& effector, const IkGoal& goal,
                   const Eigen::Quaterniond& world_from_effector, const Eigen::Vector3d& point,
                   IkError& error) {
  error.point = point;
  error.position.setZero();
  error.rotation.setZero();
  error.ray.setZero();
  if (goal.mass > 0.0) error.position = goal.position - point;
  if (effector.kind == EffectorKind::gaze) {
    error.axis = world_from_effector * effector.axis;
    const Eigen::Vector3d sight = goal.position - point;
    const double distance = sight.norm();
    if (goal.inertia > 0.0 && distance > kNearestGaze) {
      error.ray = sight / (distance * distance);
      error.rotation = turn(error.axis, sight / distance);
    }
  } else if (effector.kind == EffectorKind::direction || effector.kind == EffectorKind::line) {
    error.axis = world_from_effector * effector.axis;
    if (goal.inertia > 0.0) error.rotation = turn(error.axis, goal.axis);
    if (effector.kind == EffectorKind::line) {
      error.position -= goal.axis.dot(error.position) * goal.axis;
    }
  } else if (goal.inertia > 0.0) {
    error.rotation = log_of(goal.rotation * world_from_effector.conjugate());
  }
}

IkState IkTree::make_state() const {
  return {Eigen::VectorXd::Zero(coordinate_count()),
          std::vector<Eigen::Quaterniond>(nodes.size(), Eigen::Quaterniond::Identity())};
}

IkKinematics IkTree::make_kinematics() const {
  IkKinematics k;
  k.rotation.resize(nodes.size());
  k.position.resize(nodes.size());
  k.motion.resize(nodes.size(), Eigen::Quaterniond::Identity());
  k.axis.resize(coordinate_count(), Vector6::Zero());
  k.error.resize(effectors.size());
  k.origin.setZero();
  return k;
}

void IkTree::load(std::span<const DualQuaternion> pose, IkState& state) const {
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    const IkNode& node = nodes[n];
    const RigJoint& joint = rig_.joints[node.joint];
    const Eigen::Quaterniond motion = joint.rest.conjugate() * pose[node.joint].rotation();
    double* x = &state.x[node.coordinate];
    if (node.chart) {
      const SwingTwist st = decompose(motion, joint.axes);
      x[0] = st.swing0;
      x[1] = st.swing1;
      x[2] = wrap_into(joint.limits[2], st.twist);
    } else if (node.type == JointType::hinge || node.type == JointType::universal) {
      angles_from_rotation(joint, motion, x);
      for (int k = 0; k < node.coordinates; ++k) x[k] = wrap_into(joint.limits[k], x[k]);
    } else {
      state.rotation[n] = motion.normalized();
      for (int k = 0; k < node.coordinates; ++k) x[k] = 0.0;
      if (node.type == JointType::free) {
        Eigen::Map<Eigen::Vector3d>{x} = pose[node.joint].translation() - joint.offset;
      }
    }
  }
  project(state.x);
}

namespace {

Eigen::Quaterniond motion_of(const IkNode& node, const IkState& state, std::size_t n) {
  const double* x = &state.x[node.coordinate];
  if (node.chart) return swing_twist_motion(x[0], x[1], x[2]) * node.after;
  if (node.type == JointType::hinge) return about(node.axis0, x[0]);
  if (node.type == JointType::universal) return about(node.axis0, x[0]) * about(node.axis1, x[1]);
  return state.rotation[n];
}

}  // namespace

void IkTree::store(const IkState& state, std::span<DualQuaternion> pose) const {
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    store_node(n, state, motion_of(nodes[n], state, n), pose);
  }
}

void IkTree::store(const IkState& state, const IkKinematics& kinematics,
                   std::span<DualQuaternion> pose) const {
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    store_node(n, state, kinematics.motion[n], pose);
  }
}

void IkTree::store_node(std::size_t n, const IkState& state, const Eigen::Quaterniond& motion,
                        std::span<DualQuaternion> pose) const {
  const IkNode& node = nodes[n];
  const double* x = &state.x[node.coordinate];
  Eigen::Vector3d offset = rig_.joints[node.joint].offset;
  if (node.type == JointType::free) offset += Eigen::Vector3d(x[0], x[1], x[2]);
  Eigen::Quaterniond local = node.local * motion;
  local.coeffs() *= 1.5 - 0.5 * local.squaredNorm();  // a unit but for rounding
  pose[node.joint] = DualQuaternion::from_rotation_translation(local, offset);
}

void IkTree::resolve(std::span<const EffectorTarget> targets, std::span<IkGoal> goals) const {
  for (std::size_t e = 0; e < effectors.size(); ++e) goals[e] = make_goal(effectors[e], targets[e]);
}

void IkTree::evaluate(const IkState& state, std::span<const IkGoal> goals,
                      IkKinematics& out) const {
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    const IkNode& node = nodes[n];
    const double* x = &state.x[node.coordinate];
    Eigen::Vector3d offset = node.offset;
    if (node.type == JointType::free) offset += node.slide * Eigen::Vector3d(x[0], x[1], x[2]);
    const Eigen::Quaterniond motion = motion_of(node, state, n);
    out.motion[n] = motion;
    if (node.parent < 0) {
      out.rotation[n] = node.before * motion;
      out.position[n] = offset;
    } else {
      const Eigen::Quaterniond& parent = out.rotation[node.parent];
      out.rotation[n] = parent * (node.before * motion);
      out.position[n] = out.position[node.parent] + parent * offset;
    }
  }
  out.cost = 0.0;
  for (std::size_t e = 0; e < effectors.size(); ++e) {
    const IkEffector& effector = effectors[e];
    IkError& error = out.error[e];
    if (effector.node >= 0) {
      const Eigen::Quaterniond& world = out.rotation[effector.node];
      measure_error(effector, goals[e], world * effector.rotation,
                    out.position[effector.node] + world * effector.offset, error);
    } else {
      measure_error(effector, goals[e], effector.rotation, effector.offset, error);
    }
    out.cost += goals[e].mass * error.position.squaredNorm();
    out.cost += goals[e].inertia * error.rotation.squaredNorm();
  }
}

void IkTree::linearise(const IkState& state, IkKinematics& out) const {
  if (!nodes.empty()) out.origin = out.position[0];
  const auto set = [&](std::int32_t k, const Eigen::Vector3d& p, const Eigen::Vector3d& axis) {
    out.axis[k].head<3>() = axis;
    out.axis[k].tail<3>() = p.cross(axis);
  };
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    const IkNode& node = nodes[n];
    const Eigen::Vector3d p = out.position[n] - out.origin;
    const Eigen::Quaterniond parent =
        node.parent < 0 ? Eigen::Quaterniond::Identity() : out.rotation[node.parent];
    const Eigen::Quaterniond q = parent * node.before;
    const double* x = &state.x[node.coordinate];
    std::int32_t k = node.coordinate;
    if (node.type == JointType::hinge) {
      set(k, p, q * node.axis0);
    } else if (node.type == JointType::universal) {
      set(k, p, q * node.axis0);
      // The last axis is fixed in the joint too, where the kinematics have already put it.
      set(k + 1, p, out.rotation[n] * node.axis1);
    } else if (node.chart) {
      const double s0 = x[0], s1 = x[1], angle2 = s0 * s0 + s1 * s1;
      const HalfAngle<double> half = half_angle(angle2);
      const double a = 2.0 * half.sinc * half.cosine, b = 2.0 * half.sinc * half.sinc;
      const double c =
          angle2 < 1e-4 ? 1.0 / 6.0 - angle2 * (1.0 / 120.0 - angle2 / 5040.0) : (1.0 - a) / angle2;
      const Eigen::Matrix3d m = q.toRotationMatrix();
      set(k, p, m * Eigen::Vector3d(a + c * s0 * s0, c * s0 * s1, -b * s1));
      set(k + 1, p, m * Eigen::Vector3d(c * s0 * s1, a + c * s1 * s1, b * s0));
      set(k + 2, p, m * Eigen::Vector3d(a * s1, -a * s0, 1.0 - b * angle2));
    } else {
      if (node.type == JointType::free) {
        const Eigen::Matrix3d slide = (parent * node.slide).toRotationMatrix();
        for (int i = 0; i < 3; ++i) out.axis[k + i] << 0.0, 0.0, 0.0, slide.col(i);
        k += 3;
      }
      const Eigen::Matrix3d m = q.toRotationMatrix();
      for (int i = 0; i < 3; ++i) set(k + i, p, m.col(i));
    }
  }
}

void IkTree::move(const IkState& from, const Eigen::VectorXd& step, IkState& out) const {
  out.x = from.x + step;
  project(out.x);
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    const IkNode& node = nodes[n];
    if (node.chart || (node.type != JointType::ball && node.type != JointType::free)) continue;
    const std::int32_t k = node.coordinate + (node.type == JointType::free ? 3 : 0);
    const Eigen::Vector3d turn(step[k], step[k + 1], step[k + 2]);
    out.rotation[n] = (exp_of(turn) * from.rotation[n]).normalized();
    for (int i = 0; i < 3; ++i) out.x[k + i] = 0.0;
  }
}

void IkTree::project(Eigen::VectorXd& x) const {
  x = x.cwiseMax(min).cwiseMin(max);
  for (const IkNode& node : nodes) {
    if (!node.ellipse) continue;
    const Eigen::Vector2d swing(x[node.coordinate], x[node.coordinate + 1]);
    const Eigen::Vector2d inside = node.swing.project(swing);
    x[node.coordinate] = inside.x();
    x[node.coordinate + 1] = inside.y();
  }
}

}  // namespace limber
