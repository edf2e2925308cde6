// The arithmetic of ik_tree.cpp and jacobian.cpp in lanes.
#pragma once

#include "solver/lane_frame.h"
#include "solver/lane_swing.h"

namespace limber::LIMBER_LANES {
namespace {

// As the anchor of ik_solver.cpp, slower: a lane has no one to mend what a quick way home meets.
constexpr float kEase = 5e-4f, kCalm = 0.9f;
constexpr float kOnLimit = 1e-5f;  // rad, m: a start nearer to a limit is held by it

inline Lane within_half_turn(const Lane& angle) {
  return angle - Lane(2.0 * M_PI) * round(angle * Lane(0.5 / M_PI));
}

/// cos and sin of half an angle, whole turns dropped.
inline void half_turn(const Lane& angle, Lane& cosine, Lane& sine) {
  const Lane a = within_half_turn(angle);
  const HalfAngle<Lane> half = half_angle(a * a);
  cosine = half.cosine;
  sine = half.sinc * a;
}

inline Quaternion exp_of(const Vector3& v) {
  const HalfAngle<Lane> half = half_angle(v.squaredNorm());
  return {half.cosine, half.sinc * v.x(), half.sinc * v.y(), half.sinc * v.z()};
}

/// Rotation vector of a unit quaternion, the short way.
inline Vector3 log_of(const Quaternion& q) {
  const Lane sign = select(q.w() < Lane(0), Lane(-1), Lane(1));
  const Lane n2 = q.vec().squaredNorm();
  Lane scale =
      Lane(2) +
      n2 * (Lane(1.0 / 3) +  // 2 asin(n) / n
            n2 * (Lane(3.0 / 20) +
                  n2 * (Lane(5.0 / 56) + n2 * (Lane(35.0 / 576) + n2 * Lane(63.0 / 1408)))));
  const Mask wide = n2 > Lane(0.05f);
  if (any(wide)) {  // 8 atan(tan(angle / 8)) / n
    const Lane n = sqrt(max(n2, Lane(1e-20f)));
    const Lane quarter = n / (Lane(1) + abs(q.w()));
    const Lane t = quarter / (Lane(1) + sqrt(Lane(1) + quarter * quarter)), t2 = t * t;
    Lane sum = Lane(-1.0 / 19);
    for (int k = 17; k >= 1; k -= 2) sum = Lane((k % 4 == 1 ? 1.0 : -1.0) / k) + t2 * sum;
    scale = select(wide, Lane(8) * t * sum / n, scale);
  }
  return (sign * scale) * q.vec();
}

void Frame::set_turn(std::size_t n, const Quaternion& q, Mask lanes) {
  const Lane norm = Lane(1) / sqrt(q.w() * q.w() + q.vec().squaredNorm());
  const auto set = [&](Pack& p, const Lane& v) { lane(p) = select(lanes, v * norm, lane(p)); };
  set(s_.turn[4 * n], q.w());
  for (int i = 0; i < 3; ++i) set(s_.turn[4 * n + 1 + i], q.vec()[i]);
}

void Frame::start() {
  const Mask fresh = is_set(lane(s_.fresh));
  if (any(fresh)) start_fresh(fresh);
  const Lane extrapolation = p_.extrapolate ? 1 : 0;
  for (std::size_t k = 0; k < p_.min.size(); ++k) {
    const Lane last = lane(s_.last[k]);
    const Lane speed = extrapolation * (last - lane(s_.before[k]));
    coordinate_[k].anchor =
        last + Lane(kEase * p_.limited[k]) * (Lane(p_.middle[k]) - last) + Lane(kCalm) * speed;
    x(k) = last + speed;
  }
  for (std::size_t n = 0; n < p_.nodes.size(); ++n) {
    if (p_.nodes[n].motion != LaneNode::Motion::turn) continue;
    const Quaternion last = turn(s_.last_turn, n), before = turn(s_.before_turn, n);
    set_turn(n, p_.extrapolate ? last * before.conjugate() * last : last, all());
  }
  project(all());
}

/// What the frames before would have left behind.
void Frame::start_fresh(Mask fresh) {
  lane(s_.damping) = select(fresh, Lane(p_.damping), lane(s_.damping));
  for (std::size_t k = 0; k < p_.min.size(); ++k) {
    const Lane last = lane(s_.last[k]);
    const Lane lock = select(last > Lane(p_.max[k] - kOnLimit), Lane(1),
                             select(last < Lane(p_.min[k] + kOnLimit), Lane(-1), Lane(0)));
    coordinate_[k].lock = select(fresh, lock, coordinate_[k].lock);
  }
  for (std::size_t n = 0; n < p_.nodes.size(); ++n) {
    const LaneNode& node = p_.nodes[n];
    if (!node.ellipse) continue;
    Swing& swing = node_[n].swing;
    const Lane s0 = lane(s_.last[node.coordinate]), s1 = lane(s_.last[node.coordinate + 1]);
    swing.active = select(fresh, Lane(0), swing.active);
    swing.next_press = select(fresh, Lane(0), swing.next_press);
    hold(node, swing, fresh & (level(node, s0, s1) > Lane(1.0f - kOnLimit)), s0, s1);
  }
  lane(s_.fresh) = 0;
}

/// parent_from_node; leaves the factors for write_poses() and linearise().
Quaternion Frame::motion(const LaneNode& node, std::size_t n) {
  Lane(&f)[4] = node_[n].factor;
  const std::int32_t k = node.coordinate;
  Lane m[4];
  switch (node.motion) {
    case LaneNode::Motion::hinge:
      half_turn(x(k), f[0], f[1]);
      m[0] = f[0], m[1] = f[1], m[2] = m[3] = 0;
      break;
    case LaneNode::Motion::universal:
      half_turn(x(k), f[0], f[1]);
      half_turn(x(k + 1), f[2], f[3]);
      m[0] = f[0] * f[2], m[1] = f[1] * f[2], m[2] = f[0] * f[3], m[3] = f[1] * f[3];
      break;
    case LaneNode::Motion::swing_twist: {
      const HalfAngle<Lane> swing = half_angle(x(k) * x(k) + x(k + 1) * x(k + 1));
      f[0] = swing.cosine, f[1] = swing.sinc;
      half_turn(x(k + 2), f[2], f[3]);
      const Lane s0 = f[1] * x(k), s1 = f[1] * x(k + 1);
      m[0] = f[0] * f[2], m[1] = s0 * f[2] + s1 * f[3];
      m[2] = s1 * f[2] - s0 * f[3], m[3] = f[0] * f[3];
      break;
    }
    default:
      for (int i = 0; i < 4; ++i) m[i] = f[i] = lane(s_.turn[4 * n + i]);
  }
  const LinearRotation<float>& map = node.parent_from_node;
  Lane q[4];
  for (int row = 0; row < 4; ++row) {
    q[row] = m[0] * Lane(map.column[0][row]) + m[1] * Lane(map.column[1][row]);
    if (map.columns > 2) {
      q[row] += m[2] * Lane(map.column[2][row]) + m[3] * Lane(map.column[3][row]);
    }
  }
  return {q[0], q[1], q[2], q[3]};
}

void Frame::evaluate() {
  for (std::size_t n = 0; n < p_.nodes.size(); ++n) {
    const LaneNode& node = p_.nodes[n];
    const Quaternion local = motion(node, n);
    Vector3 offset = vector(node.offset);
    if (node.free) {
      const std::int32_t k = node.coordinate;
      offset += quaternion(node.slide) * Vector3(x(k), x(k + 1), x(k + 2));
    }
    NodeWork& out = node_[n];
    if (node.parent < 0) {
      out.rotation = local;
      out.position = offset;
    } else {
      const NodeWork& parent = node_[node.parent];
      out.rotation = parent.rotation * local;
      out.position = parent.position + parent.rotation * offset;
    }
  }
  for (std::size_t e = 0; e < p_.effectors.size(); ++e) {
    const LaneEffector& effector = p_.effectors[e];
    const NodeWork& node = node_[effector.node];
    const Pack* goal = &s_.goal_position[3 * e];
    EffectorWork& out = effector_[e];
    out.point = node.position + node.rotation * vector(effector.offset);
    out.position = Vector3(lane(goal[0]), lane(goal[1]), lane(goal[2])) - out.point;
    if (effector.weight_rot > 0.0) {
      const Quaternion current = node.rotation * quaternion(effector.rotation);
      out.rotation = log_of(turn(s_.goal_rotation, e) * current.conjugate());
    } else {
      out.rotation = Vector3(0, 0, 0);
    }
  }
}

/// Lanes whose strong effectors are all within tolerance.
Mask Frame::done() const {
  Mask within = all();
  for (std::size_t e = 0; e < p_.effectors.size(); ++e) {
    if (!p_.effectors[e].strong) continue;
    const Mask placed = lane(s_.mass[e]) > Lane(0), turned = lane(s_.inertia[e]) > Lane(0);
    const Mask near = effector_[e].position.squaredNorm() <= Lane(p_.stop_position2);
    const Mask aligned = effector_[e].rotation.squaredNorm() <= Lane(p_.stop_rotation2);
    within = within & ((!placed) | near) & ((!turned) | aligned);
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

/// The axes of a ball's or a free joint's coordinates, k the first of them.
void Frame::linearise_ball(std::size_t n, std::int32_t k, const Vector3& p) {
  const LaneNode& node = p_.nodes[n];
  Quaternion q = quaternion(node.before);
  if (node.parent >= 0) q = node_[node.parent].rotation * q;
  const Matrix3 m = q.toRotationMatrix();
  Matrix3 axes = m;
  if (node.motion == LaneNode::Motion::swing_twist) {
    const Lane s0 = x(k), s1 = x(k + 1), angle2 = s0 * s0 + s1 * s1;
    const Lane cosine = node_[n].factor[0], sinc = node_[n].factor[1];
    const Lane a = Lane(2) * sinc * cosine, b = Lane(2) * sinc * sinc;
    const Lane c = select(angle2 < Lane(0.01f), Lane(1.0 / 6) - angle2 * Lane(1.0 / 120),
                          (Lane(1) - a) / max(angle2, Lane(0.01f)));
    axes.col(0) = m * Vector3(a + c * s0 * s0, c * s0 * s1, -b * s1);
    axes.col(1) = m * Vector3(c * s0 * s1, a + c * s1 * s1, b * s0);
    axes.col(2) = m * Vector3(a * s1, -a * s0, Lane(1) - b * angle2);
  }
  for (int i = 0; i < 3; ++i) coordinate_[k + i].axis << axes.col(i), p.cross(axes.col(i));
}

void Frame::linearise(Mask lanes) {
  const Vector3 origin = node_[0].position;
  for (std::size_t n = 0; n < p_.nodes.size(); ++n) {
    const LaneNode& node = p_.nodes[n];
    const Vector3 p = node_[n].position - origin;
    const std::int32_t k = node.coordinate;
    if (node.motion == LaneNode::Motion::hinge || node.motion == LaneNode::Motion::universal) {
      Vector3 axis = vector(node.axis);
      if (node.parent >= 0) axis = node_[node.parent].rotation * axis;
      coordinate_[k].axis << axis, p.cross(axis);
      if (node.motion == LaneNode::Motion::hinge) continue;
      axis = node_[n].rotation * vector(node.inner_axis);
      coordinate_[k + 1].axis << axis, p.cross(axis);
      continue;
    }
    if (node.free) {
      Quaternion slide = quaternion(node.slide);
      if (node.parent >= 0) slide = node_[node.parent].rotation * slide;
      const Matrix3 axes = slide.toRotationMatrix();
      for (int i = 0; i < 3; ++i) coordinate_[k + i].axis << Vector3(0, 0, 0), axes.col(i);
    }
    linearise_ball(n, node.free ? k + 3 : k, p);
    if (node.ellipse) {  // a held swing touches where x has gone
      Swing& swing = node_[n].swing;
      const Mask held = lanes & is_set(swing.active);
      if (!any(held)) continue;
      hold(node, swing, held, x(k), x(k + 1));
      swing.press = select(held, swing.next_press, swing.press);
    }
  }
}

void Frame::load() {
  const Vector3 origin = node_[0].position;
  for (std::size_t e = 0; e < p_.effectors.size(); ++e) {
    EffectorWork& effector = effector_[e];
    effector.arm = effector.point - origin;
    const Vector3 force = lane(s_.mass[e]) * effector.position;
    effector.pull << effector.arm.cross(force) + lane(s_.inertia[e]) * effector.rotation, force;
  }
}

void Frame::project(Mask lanes) {
  for (std::size_t k = 0; k < p_.min.size(); ++k) {
    x(k) = select(lanes, min(max(x(k), Lane(p_.min[k])), Lane(p_.max[k])), x(k));
  }
  for (const LaneNode& node : p_.nodes) {
    if (!node.ellipse) continue;
    Lane &s0 = x(node.coordinate), &s1 = x(node.coordinate + 1);
    const Mask outside = lanes & (level(node, s0, s1) > Lane(1));
    if (!any(outside)) continue;
    Lane p0 = s0, p1 = s1;
    nearest(node, p0, p1);
    s0 = select(outside, p0, s0);
    s1 = select(outside, p1, s1);
  }
}

/// Turns a rotation without limits by scale times its step, from the left.
void Frame::turn_by_step(const LaneNode& node, std::size_t n, Mask lanes, const Lane& scale) {
  const CoordinateWork* c = coordinate_ + node.coordinate + (node.free ? 3 : 0);
  const Vector3 v(scale * c[0].step, scale * c[1].step, scale * c[2].step);
  set_turn(n, exp_of(v) * turn(s_.turn, n), lanes);
}

void Frame::move(Mask lanes) {
  for (std::size_t n = 0; n < p_.nodes.size(); ++n) {
    const LaneNode& node = p_.nodes[n];
    const bool turns = node.motion == LaneNode::Motion::turn;
    std::int32_t k = node.coordinate;
    const std::int32_t end = k + node.coordinates, first_turn = turns ? end - 3 : end;
    for (; k < first_turn; ++k) {
      CoordinateWork& c = coordinate_[k];
      c.kept = x(k);
      x(k) = select(lanes, x(k) + c.step, x(k));
    }
    for (; k < end; ++k) {
      Lane& step = coordinate_[k].step;
      step = min(max(step, Lane(-1)), Lane(1));
    }
    if (turns) turn_by_step(node, n, lanes, 1);
  }
  project(lanes);
}

/// Undoes the last move.
void Frame::put_back(Mask lanes) {
  for (std::size_t n = 0; n < p_.nodes.size(); ++n) {
    const LaneNode& node = p_.nodes[n];
    const bool turns = node.motion == LaneNode::Motion::turn;
    const std::int32_t end = node.coordinate + node.coordinates - (turns ? 3 : 0);
    for (std::int32_t k = node.coordinate; k < end; ++k) {
      x(k) = select(lanes, coordinate_[k].kept, x(k));
    }
    if (turns) turn_by_step(node, n, lanes, -1);
  }
}

}  // namespace
}  // namespace limber::LIMBER_LANES
