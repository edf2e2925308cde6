// One frame of the tree solver in eight lanes: the arithmetic of ik_tree.cpp, jacobian.cpp and
// tree_elimination.cpp (whose heads derive it), in floats and without branches on data. What is a
// branch there is a mask here; a part that few lanes need (the nearest point on an ellipse, another
// pass of the active set) runs where any lane needs it and is kept where a lane asked for it.
//
// Gauss-Newton with damping per lane: a step that made a lane worse is taken back and tried with
// more damping. Lanes that do not get within tolerance in kMostRelinearisations say so in `missed`
// and are for the caller.
//
// Included once per SIMD level (solver/lane.h says how levels are kept apart).
#pragma once

#include "solver/lane.h"
#include "solver/lane_problem.h"
#include "solver/spatial_inertia.h"

namespace limber::LIMBER_LANES {
namespace {

constexpr int kMostRelinearisations = 5;
constexpr int kMostPasses = 5, kReleasePasses = 3, kTangentPasses = 3;
constexpr float kTouch = 1e-6f;         // rad, m: nearer to a limit counts as on it
constexpr float kThinnest = 1e-6f;      // rad: a narrower side of an ellipse counts as this wide
constexpr float kMostCurvature = 1e3f;  // 1/rad
constexpr float kSlidePart = 0.02f;  // of the largest step: shorter ways along a tangent are none
constexpr float kLeastDamping = 1e-7f, kMoreDamping = 32.0f;
constexpr int kEllipseSteps = 6;

using Vector6L = Vector6T<Lane>;

struct Swing {
  Lane active, point0, point1, normal0, normal1, curvature, press;  ///< active: 0 or 1
};
struct NodeWork {
  Quaternion rotation;
  Vector3 position;
  SpatialInertia<Lane> load, outside;
  Vector6L pull, bias, twist;
  Swing swing;
  Lane dirty;  ///< 1 where the limits changed since its elimination
};
struct CoordinateWork {
  Vector6L axis;    ///< twist of a unit step
  Vector6L turned;  ///< the same, of the tangent or normal where a swing is held
  Vector6L momentum;
  Lane inverse, drive, diagonal, held, locked, multiplier;
  Lane lock;                ///< -1, 0, 1: held at min, free, held at max
  Lane step, anchor, kept;  ///< kept: x before the step
};
struct EffectorWork {
  Vector3 point, position, rotation;  ///< where it is, errors
};

Quaternion quaternion(const float* q) { return {q[0], q[1], q[2], q[3]}; }
Vector3 vector(const float* v) { return {v[0], v[1], v[2]}; }
Lane& lane(Pack& p) { return reinterpret_cast<Lane&>(p); }
Mask is_set(const Lane& flag) { return flag > Lane(0.5f); }
Lane flag(Mask m) { return select(m, Lane(1), Lane(0)); }

Lane within_half_turn(const Lane& angle) {
  return angle - Lane(2.0 * M_PI) * round(angle * Lane(0.5 / M_PI));
}

Quaternion about(const Vector3& axis, const Lane& angle) {
  const Lane a = within_half_turn(angle);
  const HalfAngle<Lane> half = half_angle(a * a);
  const Lane s = half.sinc * a;
  return {half.cosine, s * axis.x(), s * axis.y(), s * axis.z()};
}

Quaternion swing_twist(const Lane& s0, const Lane& s1, const Lane& twist) {
  const HalfAngle<Lane> swing = half_angle(s0 * s0 + s1 * s1);
  const Lane t = within_half_turn(twist);
  const HalfAngle<Lane> half = half_angle(t * t);
  const Lane k = half.cosine, m = half.sinc * t, x = swing.sinc * s0, y = swing.sinc * s1;
  return {swing.cosine * k, x * k + y * m, y * k - x * m, swing.cosine * m};
}

/// Rotation vector of a unit quaternion, the short way.
Vector3 log_of(const Quaternion& q) {
  const Lane sign = select(q.w() < Lane(0), Lane(-1), Lane(1));
  const Lane n2 = q.vec().squaredNorm();
  Lane scale;
  if (!any(n2 > Lane(0.05f))) {  // 2 asin(n) / n
    scale = Lane(2) +
            n2 * (Lane(1.0 / 3) +
                  n2 * (Lane(3.0 / 20) +
                        n2 * (Lane(5.0 / 56) + n2 * (Lane(35.0 / 576) + n2 * Lane(63.0 / 1408)))));
  } else {  // 8 atan(tan(angle / 8)) / n
    const Lane n = sqrt(max(n2, Lane(1e-20f)));
    const Lane quarter = n / (Lane(1) + abs(q.w()));
    const Lane t = quarter / (Lane(1) + sqrt(Lane(1) + quarter * quarter)), t2 = t * t;
    Lane sum = Lane(-1.0 / 19);
    for (int k = 17; k >= 1; k -= 2) sum = Lane((k % 4 == 1 ? 1.0 : -1.0) / k) + t2 * sum;
    scale = Lane(8) * t * sum / n;
  }
  return (sign * scale) * q.vec();
}

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

  void follow();

 private:
  Lane& x(std::int32_t k) { return lane(s_.x[k]); }
  Quaternion turn(const std::vector<Pack>& turns, std::size_t n) const {
    const auto at = [&](int i) { return reinterpret_cast<const Lane&>(turns[4 * n + i]); };
    return {at(0), at(1), at(2), at(3)};
  }
  void set_turn(std::size_t n, const Quaternion& q) {
    const Lane norm = Lane(1) / sqrt(q.w() * q.w() + q.vec().squaredNorm());
    lane(s_.turn[4 * n]) = q.w() * norm;
    for (int i = 0; i < 3; ++i) lane(s_.turn[4 * n + 1 + i]) = q.vec()[i] * norm;
  }

  void start();
  void evaluate();
  Mask done() const;
  Lane cost() const;
  void linearise();
  void load();
  void prepare(std::size_t n, const Lane& damping);
  void eliminate(std::size_t n, const Lane& damping);
  void substitute();
  Mask update_box(std::size_t n, bool may_release);
  Mask update_swing(std::size_t n, bool may_release, const Lane& slide_tolerance);
  void solve(const Lane& damping);
  void move(Mask lanes);
  void put_back(Mask lanes);
  void project();

  Lane level(const LaneNode& node, const Lane& s0, const Lane& s1) const;
  void nearest(const LaneNode& node, Lane& s0, Lane& s1) const;
  void hold(const LaneNode& node, Swing& swing, Mask lanes, const Lane& s0, const Lane& s1) const;

  const LaneProblem& p_;
  LaneState& s_;
  NodeWork* node_;
  CoordinateWork* coordinate_;
  EffectorWork* effector_;
};

// ---- swings and their ellipses

Lane radius(const LaneNode& node, int axis, const Lane& s) {
  const float low = std::max(-node.swing_min[axis], kThinnest);
  const float high = std::max(node.swing_max[axis], kThinnest);
  return select(s < Lane(0), Lane(low), Lane(high));
}

Lane Frame::level(const LaneNode& node, const Lane& s0, const Lane& s1) const {
  const Lane u = s0 / radius(node, 0, s0), v = s1 / radius(node, 1, s1);
  return u * u + v * v;
}

/// The nearest point of the ellipse, for lanes outside of it (swing_twist.cpp derives it).
void Frame::nearest(const LaneNode& node, Lane& s0, Lane& s1) const {
  const Lane a = radius(node, 0, s0), b = radius(node, 1, s1), a2 = a * a, b2 = b * b;
  const Lane ap = a * abs(s0), bp = b * abs(s1);
  Lane t = max(Lane(0), max(ap - a2, bp - b2));
  for (int i = 0; i < kEllipseSteps; ++i) {
    const Lane u = ap / (t + a2), v = bp / (t + b2), u2 = u * u, v2 = v * v;
    const Lane f = max(u2 + v2 - Lane(1), Lane(0));
    t += Lane(0.5f) * f / (u2 / (t + a2) + v2 / (t + b2) + Lane(1e-30f));
  }
  const Lane u = ap / (t + a2), v = bp / (t + b2);
  const Lane norm = Lane(1) / sqrt(max(u * u + v * v, Lane(1e-30f)));
  s0 = select(s0 < Lane(0), -a, a) * (u * norm);
  s1 = select(s1 < Lane(0), -b, b) * (v * norm);
}

/// Where `lanes`: held to the tangent at the border's point nearest to s (outside or on it).
void Frame::hold(const LaneNode& node, Swing& swing, Mask lanes, const Lane& s0,
                 const Lane& s1) const {
  Lane p0 = s0, p1 = s1;
  nearest(node, p0, p1);
  const Lane a = radius(node, 0, s0), b = radius(node, 1, s1);
  const Lane g0 = p0 / (a * a), g1 = p1 / (b * b);
  const Lane norm = Lane(1) / sqrt(max(g0 * g0 + g1 * g1, Lane(1e-30f)));
  const Lane u = a * p1 / b, v = b * p0 / a, speed2 = max(u * u + v * v, Lane(1e-12f));
  swing.point0 = select(lanes, p0, swing.point0);
  swing.point1 = select(lanes, p1, swing.point1);
  swing.normal0 = select(lanes, g0 * norm, swing.normal0);
  swing.normal1 = select(lanes, g1 * norm, swing.normal1);
  swing.curvature =
      select(lanes, min(a * b / (speed2 * sqrt(speed2)), Lane(kMostCurvature)), swing.curvature);
  swing.active = select(lanes, Lane(1), swing.active);
}

void Frame::project() {
  for (std::size_t k = 0; k < p_.min.size(); ++k) {
    x(k) = min(max(x(k), Lane(p_.min[k])), Lane(p_.max[k]));
  }
  for (const LaneNode& node : p_.nodes) {
    if (!node.ellipse) continue;
    Lane &s0 = x(node.coordinate), &s1 = x(node.coordinate + 1);
    const Mask outside = level(node, s0, s1) > Lane(1);
    if (!any(outside)) continue;
    Lane p0 = s0, p1 = s1;
    nearest(node, p0, p1);
    s0 = select(outside, p0, s0);
    s1 = select(outside, p1, s1);
  }
}

// ---- kinematics

void Frame::start() {
  const bool moving = p_.extrapolate && s_.answers > 1;
  for (std::size_t k = 0; k < p_.min.size(); ++k) {
    const Lane last = lane(s_.last[k]), before = lane(s_.before[k]);
    const Lane speed = moving ? last - before : Lane(0);
    coordinate_[k].anchor =
        last + Lane(p_.ease * p_.limited[k]) * (Lane(p_.middle[k]) - last) + Lane(p_.calm) * speed;
    x(k) = last + speed;
  }
  for (std::size_t n = 0; n < p_.nodes.size(); ++n) {
    if (!p_.nodes[n].turns) continue;
    const Quaternion last = turn(s_.last_turn, n), before = turn(s_.before_turn, n);
    set_turn(n, moving ? last * before.conjugate() * last : last);
  }
  project();
}

void Frame::evaluate() {
  for (std::size_t n = 0; n < p_.nodes.size(); ++n) {
    const LaneNode& node = p_.nodes[n];
    const std::int32_t k = node.coordinate;
    Vector3 offset = vector(node.offset);
    Quaternion motion;
    if (node.chart) {
      motion = swing_twist(x(k), x(k + 1), x(k + 2)) * quaternion(node.after);
    } else if (node.turns) {
      motion = turn(s_.turn, n);
      if (node.free) offset += quaternion(node.slide) * Vector3(x(k), x(k + 1), x(k + 2));
    } else {
      motion = about(vector(node.axis0), x(k));
      if (node.universal) motion = motion * about(vector(node.axis1), x(k + 1));
    }
    motion = quaternion(node.before) * motion;
    NodeWork& out = node_[n];
    if (node.parent < 0) {
      out.rotation = motion;
      out.position = offset;
    } else {
      const NodeWork& parent = node_[node.parent];
      out.rotation = parent.rotation * motion;
      out.position = parent.position + parent.rotation * offset;
    }
  }
  for (std::size_t e = 0; e < p_.effectors.size(); ++e) {
    const LaneEffector& effector = p_.effectors[e];
    const NodeWork& node = node_[effector.node];
    const auto goal = [&](int i) { return lane(s_.goal_position[3 * e + i]); };
    EffectorWork& out = effector_[e];
    out.point = node.position + node.rotation * vector(effector.offset);
    out.position = Vector3(goal(0), goal(1), goal(2)) - out.point;
    const Quaternion current = node.rotation * quaternion(effector.rotation);
    out.rotation = log_of(turn(s_.goal_rotation, e) * current.conjugate());
  }
}

Mask Frame::done() const {
  Mask within = Lane(0) < Lane(1);
  for (std::size_t e = 0; e < p_.effectors.size(); ++e) {
    if (!p_.effectors[e].strong) continue;
    const Mask placed = lane(s_.mass[e]) > Lane(0), turned = lane(s_.inertia[e]) > Lane(0);
    within = within &
             (!(placed & (effector_[e].position.squaredNorm() > Lane(p_.stop_position2)))) &
             (!(turned & (effector_[e].rotation.squaredNorm() > Lane(p_.stop_rotation2))));
  }
  return within;
}

Lane Frame::cost() const {
  Lane sum = 0;
  for (std::size_t e = 0; e < p_.effectors.size(); ++e) {
    sum += lane(s_.mass[e]) * effector_[e].position.squaredNorm() +
           lane(s_.inertia[e]) * effector_[e].rotation.squaredNorm();
  }
  return sum;
}

void Frame::linearise() {
  const Vector3 origin = node_[0].position;
  for (std::size_t n = 0; n < p_.nodes.size(); ++n) {
    const LaneNode& node = p_.nodes[n];
    const Vector3 p = node_[n].position - origin;
    Quaternion q = quaternion(node.before);
    if (node.parent >= 0) q = node_[node.parent].rotation * q;
    std::int32_t k = node.coordinate;
    const auto set = [&](const Vector3& axis) {
      coordinate_[k].axis.head<3>() = axis;
      coordinate_[k++].axis.tail<3>() = p.cross(axis);
    };
    if (node.chart) {
      const Lane s0 = x(k), s1 = x(k + 1), angle2 = s0 * s0 + s1 * s1;
      const HalfAngle<Lane> half = half_angle(angle2);
      const Lane a = Lane(2) * half.sinc * half.cosine, b = Lane(2) * half.sinc * half.sinc;
      const Lane c = select(angle2 < Lane(0.01f), Lane(1.0 / 6) - angle2 * Lane(1.0 / 120),
                            (Lane(1) - a) / max(angle2, Lane(0.01f)));
      const Eigen::Matrix<Lane, 3, 3> m = q.toRotationMatrix();
      set(m * Vector3(a + c * s0 * s0, c * s0 * s1, -b * s1));
      set(m * Vector3(c * s0 * s1, a + c * s1 * s1, b * s0));
      set(m * Vector3(a * s1, -a * s0, Lane(1) - b * angle2));
    } else if (node.turns) {
      if (node.free) {
        Quaternion slide = quaternion(node.slide);
        if (node.parent >= 0) slide = node_[node.parent].rotation * slide;
        const Eigen::Matrix<Lane, 3, 3> axes = slide.toRotationMatrix();
        for (int i = 0; i < 3; ++i) {
          coordinate_[k].axis.head<3>() = Vector3(0, 0, 0);
          coordinate_[k++].axis.tail<3>() = axes.col(i);
        }
      }
      const Eigen::Matrix<Lane, 3, 3> m = q.toRotationMatrix();
      for (int i = 0; i < 3; ++i) set(m.col(i));
    } else {
      set(q * vector(node.axis0));
      if (node.universal) set(node_[n].rotation * vector(node.axis1));
    }
  }
  for (std::size_t n = 0; n < p_.nodes.size(); ++n) {  // held swings move on with x
    const LaneNode& node = p_.nodes[n];
    if (!node.ellipse || !any(is_set(node_[n].swing.active))) continue;
    const Lane s0 = x(node.coordinate), s1 = x(node.coordinate + 1);
    const Lane out = Lane(1) / sqrt(min(max(level(node, s0, s1), Lane(0.25f)), Lane(1)));
    hold(node, node_[n].swing, is_set(node_[n].swing.active), s0 * out, s1 * out);
  }
}

void Frame::load() {
  for (std::size_t n = 0; n < p_.nodes.size(); ++n) {
    node_[n].load.set_zero();
    node_[n].pull.fill(Lane(0));
  }
  const Vector3 origin = node_[0].position;
  for (std::size_t e = 0; e < p_.effectors.size(); ++e) {
    const EffectorWork& effector = effector_[e];
    NodeWork& node = node_[p_.effectors[e].node];
    const Lane mass = lane(s_.mass[e]), inertia = lane(s_.inertia[e]);
    const Vector3 d = effector.point - origin, force = mass * effector.position;
    node.load.add_point(mass, d);
    node.load.add_angular(inertia);
    node.pull.head<3>() += d.cross(force) + inertia * effector.rotation;
    node.pull.tail<3>() += force;
  }
}

// ---- elimination

void Frame::prepare(std::size_t n, const Lane& damping) {
  const LaneNode& node = p_.nodes[n];
  for (std::int32_t k = node.coordinate; k < node.coordinate + node.coordinates; ++k) {
    CoordinateWork& c = coordinate_[k];
    c.turned = c.axis;
    c.locked = abs(c.lock);
    c.held = select(c.lock > Lane(0), Lane(p_.max[k]), Lane(p_.min[k])) - x(k);
    c.held = select(is_set(c.locked), c.held, Lane(0));
    c.diagonal = damping * Lane(p_.armature[k]);
    c.drive = c.diagonal * Lane(p_.limited[k]) * (c.anchor - x(k));
  }
  const Swing& swing = node_[n].swing;
  if (!node.ellipse || !any(is_set(swing.active))) return;
  // Coordinate 0 becomes the tangent (-n1, n0), coordinate 1 the normal; free lanes keep theirs.
  CoordinateWork &tangent = coordinate_[node.coordinate],
                 &normal = coordinate_[node.coordinate + 1];
  const Mask on = is_set(swing.active);
  const Lane n0 = select(on, swing.normal0, Lane(0)), n1 = select(on, swing.normal1, Lane(1));
  const Lane ahead0 = swing.point0 - x(node.coordinate);
  const Lane ahead1 = swing.point1 - x(node.coordinate + 1);
  tangent.turned = n0 * normal.axis - n1 * tangent.axis;
  normal.turned = n0 * tangent.axis + n1 * normal.axis;
  const Lane drive0 = tangent.drive, drive1 = normal.drive;
  const Lane stiffness = select(on, swing.press * swing.curvature, Lane(0));
  tangent.diagonal += stiffness;
  tangent.drive = n0 * drive1 - n1 * drive0 + stiffness * (n0 * ahead1 - n1 * ahead0);
  normal.drive = n0 * drive0 + n1 * drive1;
  normal.locked = flag(on);
  normal.held = select(on, n0 * ahead0 + n1 * ahead1, Lane(0));
}

void Frame::eliminate(std::size_t n, const Lane& damping) {
  prepare(n, damping);
  const LaneNode& node = p_.nodes[n];
  SpatialInertia<Lane> inertia = node_[n].load;
  Vector6L bias = -node_[n].pull;
  for (std::int32_t i = node.first_child; i < node.last_child; ++i) {
    inertia += node_[p_.children[i]].outside;
    bias += node_[p_.children[i]].bias;
  }
  for (std::int32_t k = node.coordinate + node.coordinates - 1; k >= node.coordinate; --k) {
    CoordinateWork& c = coordinate_[k];
    c.momentum = inertia * c.turned;
    c.diagonal += c.turned.dot(c.momentum);
    c.drive -= c.turned.dot(bias);
    c.inverse = select(is_set(c.locked), Lane(0), Lane(1) / c.diagonal);
    // Held: the push of its step. Free: what is left when it gives way.
    bias += select(is_set(c.locked), c.held, c.drive * c.inverse) * c.momentum;
    inertia.add_outer(c.momentum, -c.inverse);
  }
  node_[n].outside = inertia;
  node_[n].bias = bias;
}

void Frame::substitute() {
  for (std::size_t n = 0; n < p_.nodes.size(); ++n) {
    const LaneNode& node = p_.nodes[n];
    Vector6L twist;
    if (node.parent < 0) {
      twist.fill(Lane(0));
    } else {
      twist = node_[node.parent].twist;
    }
    for (std::int32_t k = node.coordinate; k < node.coordinate + node.coordinates; ++k) {
      CoordinateWork& c = coordinate_[k];
      const Lane feel = c.momentum.dot(twist);
      c.multiplier = feel + c.diagonal * c.held - c.drive;
      c.step = select(is_set(c.locked), c.held, (c.drive - feel) * c.inverse);
      twist += c.step * c.turned;
    }
    node_[n].twist = twist;
    const Swing& swing = node_[n].swing;
    if (!node.ellipse || !any(is_set(swing.active))) continue;
    CoordinateWork &c0 = coordinate_[node.coordinate], &c1 = coordinate_[node.coordinate + 1];
    const Mask on = is_set(swing.active);
    const Lane n0 = select(on, swing.normal0, Lane(0)), n1 = select(on, swing.normal1, Lane(1));
    const Lane along = c0.step, out = c1.step;
    c0.step = out * n0 - along * n1;
    c1.step = out * n1 + along * n0;
  }
}

Mask Frame::update_box(std::size_t n, bool may_release) {
  const LaneNode& node = p_.nodes[n];
  Mask changed = Lane(1) < Lane(0);
  for (std::int32_t k = node.coordinate; k < node.coordinate + node.coordinates; ++k) {
    if (!(p_.limited[k] > 0.0f) || (node.ellipse && k < node.coordinate + 2)) continue;
    CoordinateWork& c = coordinate_[k];
    const Lane end = x(k) + c.step;
    const Mask free = abs(c.lock) < Lane(0.5f);
    const Mask above = free & (end > Lane(p_.max[k] + kTouch));
    const Mask below = free & (end < Lane(p_.min[k] - kTouch));
    const Mask inward = (!free) & (c.multiplier * c.lock > Lane(0));
    const bool wide = p_.max[k] > p_.min[k];
    const Mask release = may_release && wide ? inward : Lane(1) < Lane(0);
    c.lock = select(above, Lane(1), select(below, Lane(-1), select(release, Lane(0), c.lock)));
    changed = changed | above | below | release;
  }
  return changed;
}

Mask Frame::update_swing(std::size_t n, bool may_release, const Lane& slide_tolerance) {
  const LaneNode& node = p_.nodes[n];
  Swing& swing = node_[n].swing;
  const std::int32_t k = node.coordinate;
  const Lane end0 = x(k) + coordinate_[k].step, end1 = x(k + 1) + coordinate_[k + 1].step;
  const Mask on = is_set(swing.active);
  const Mask outside = (!on) & (level(node, end0, end1) > Lane(1.0f + kTouch));
  if (!any(on | outside)) return outside;
  const Lane press = -coordinate_[k + 1].multiplier;
  const Mask release = may_release ? (on & (press < Lane(0))) : (Lane(1) < Lane(0));
  swing.press = select(on, max(press, Lane(0)), Lane(0));
  const Lane slide = swing.normal0 * (end1 - swing.point1) - swing.normal1 * (end0 - swing.point0);
  const Mask slid = on & (!release) & (abs(slide) > slide_tolerance);
  const Lane wish0 = select(on, swing.point0 - swing.normal1 * slide, end0);
  const Lane wish1 = select(on, swing.point1 + swing.normal0 * slide, end1);
  if (any(outside | slid)) hold(node, swing, outside | slid, wish0, wish1);
  swing.active = select(release, Lane(0), swing.active);
  swing.press = select(release, Lane(0), swing.press);
  return outside | slid | release;
}

void Frame::solve(const Lane& damping) {
  const auto nodes = p_.nodes.size();
  for (std::size_t n = 0; n < nodes; ++n) node_[n].dirty = 1;
  for (int pass = 0; pass < kMostPasses; ++pass) {
    ++s_.tree_passes;
    for (std::size_t n = nodes; n-- > 0;) {
      if (!any(is_set(node_[n].dirty))) continue;
      eliminate(n, damping);
      node_[n].dirty = 0;
      if (p_.nodes[n].parent >= 0) node_[p_.nodes[n].parent].dirty = 1;
    }
    substitute();
    Lane largest = 0;
    for (std::size_t k = 0; k < p_.min.size(); ++k) {
      largest = max(largest, abs(coordinate_[k].step));
    }
    const bool may_release = pass < kReleasePasses;
    Mask changed = Lane(1) < Lane(0);
    for (std::size_t n = 0; n < nodes; ++n) {
      Mask here = update_box(n, may_release);
      if (p_.nodes[n].ellipse && pass < kTangentPasses) {
        here = here | update_swing(n, may_release, max(Lane(kSlidePart) * largest, Lane(kTouch)));
      }
      node_[n].dirty = flag(here);
      changed = changed | here;
    }
    if (!any(changed)) return;
  }
}

// ---- the outer loop

void Frame::move(Mask lanes) {
  for (std::size_t k = 0; k < p_.min.size(); ++k) {
    coordinate_[k].kept = x(k);
    x(k) = select(lanes, x(k) + coordinate_[k].step, x(k));
  }
  for (std::size_t n = 0; n < p_.nodes.size(); ++n) {
    const LaneNode& node = p_.nodes[n];
    if (!node.turns) continue;
    const std::int32_t k = node.coordinate + (node.free ? 3 : 0);
    Vector3 v;
    for (int i = 0; i < 3; ++i) {
      v[i] = select(lanes, min(max(coordinate_[k + i].step, Lane(-1)), Lane(1)), Lane(0));
      x(k + i) = 0;
    }
    const HalfAngle<Lane> half = half_angle(v.squaredNorm());
    const Quaternion q(half.cosine, half.sinc * v.x(), half.sinc * v.y(), half.sinc * v.z());
    set_turn(n, q * turn(s_.turn, n));
    for (int i = 0; i < 3; ++i) coordinate_[k + i].step = v[i];
  }
  project();
}

/// Undoes the last move.
void Frame::put_back(Mask lanes) {
  for (std::size_t k = 0; k < p_.min.size(); ++k) x(k) = select(lanes, coordinate_[k].kept, x(k));
  for (std::size_t n = 0; n < p_.nodes.size(); ++n) {
    const LaneNode& node = p_.nodes[n];
    if (!node.turns) continue;
    const std::int32_t k = node.coordinate + (node.free ? 3 : 0);
    Vector3 v;
    for (int i = 0; i < 3; ++i) v[i] = select(lanes, -coordinate_[k + i].step, Lane(0));
    const HalfAngle<Lane> half = half_angle(v.squaredNorm());
    const Quaternion q(half.cosine, half.sinc * v.x(), half.sinc * v.y(), half.sinc * v.z());
    set_turn(n, q * turn(s_.turn, n));
  }
}

void Frame::follow() {
  s_.relinearisations = s_.tree_passes = 0;
  start();
  evaluate();
  Mask active = Lane(0) < Lane(1);
  Lane damping = lane(s_.damping), was = cost();
  while (s_.relinearisations < kMostRelinearisations) {
    ++s_.relinearisations;
    linearise();
    load();
    solve(damping);
    move(active);
    evaluate();
    const Mask arrived = done();
    const Lane is = cost();
    const Mask rose = active & (!arrived) & (!(is <= was));
    damping = select(rose, damping * Lane(kMoreDamping),
                     select(active, max(damping * Lane(0.1f), Lane(kLeastDamping)), damping));
    was = select(rose, was, is);
    active = active & (!arrived);
    if (!any(active)) break;
    if (any(rose)) {
      put_back(rose);
      evaluate();
    }
  }
  lane(s_.damping) = min(damping, Lane(p_.damping));
  for (int i = 0; i < kLanes; ++i) s_.missed[i] = active.bits[i] != 0;
}

}  // namespace

void follow_frame(const LaneProblem& problem, LaneState& state) { Frame(problem, state).follow(); }
std::size_t scratch_packs(const LaneProblem& problem) { return Frame::packs(problem); }

}  // namespace limber::LIMBER_LANES
