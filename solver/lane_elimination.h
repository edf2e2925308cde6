// tree_elimination.cpp in lanes: the same derivation, limits as masks.
#pragma once

#include "solver/lane_frame.h"
#include "solver/lane_swing.h"

namespace limber::LIMBER_LANES {
namespace {

constexpr int kMostPasses = 5, kReleasePasses = 3, kTangentPasses = 3;
// rad, m, and of an ellipse's level: less beyond a limit is cut off without another pass. At a
// metre's distance that is a tenth of the tolerance, which is checked all the same.
constexpr float kTouch = 1e-5f;
// Of the largest step: shorter ways along a tangent are none. Five times the solver for one's: here
// a pass is for eight.
constexpr float kSlidePart = 0.1f;
constexpr int kEarly = 2;           // as ik_descent.cpp: in the first relinearisations ways along
constexpr float kEarlyBend = 0.2f;  // which the border turns by less (rad) are none either

/// Of a held swing, coordinate 0 becomes the tangent (-n1, n0), coordinate 1 the normal. Lanes that
/// are free take n = (0, 1), which is their own axes, the first one backwards: to the bit the same.
void Frame::prepare(std::size_t n, const Lane& damping) {
  const LaneNode& node = p_.nodes[n];
  for (std::int32_t k = node.coordinate; k < node.coordinate + node.coordinates; ++k) {
    CoordinateWork& c = coordinate_[k];
    c.diagonal = damping * Lane(p_.armature[k]);
    c.drive = c.diagonal * Lane(p_.limited[k]) * (c.anchor - x(k));
    c.locked = abs(c.lock);
    c.held = select(c.lock > Lane(0), Lane(p_.max[k]), Lane(p_.min[k])) - x(k);
    c.held = select(is_set(c.locked), c.held, Lane(0));
  }
  if (!node.ellipse) return;
  CoordinateWork &tangent = coordinate_[node.coordinate],
                 &normal = coordinate_[node.coordinate + 1];
  const Swing& swing = node_[n].swing;
  const Mask on = is_set(swing.active);
  if (!any(on)) {
    tangent.turned = tangent.axis;
    normal.turned = normal.axis;
    return;
  }
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

/// One coordinate: what is felt through it. `out` may be what is felt of it.
inline void eliminate_coordinate(const Vector6L& axis, CoordinateWork& c, const Felt& in,
                                 SpatialInertia<Lane>& inertia, Vector6L& bias) {
  const Vector6L momentum = *in.inertia * axis;
  const Mask locked = is_set(c.locked);
  const Lane diagonal = c.diagonal + axis.dot(momentum), drive = c.drive - axis.dot(*in.bias);
  const Lane inverse = select(locked, Lane(0), Lane(1) / diagonal);
  c.diagonal = diagonal;
  c.drive = drive;
  c.inverse = inverse;
  c.momentum = momentum;
  // Held: the push of its step. Free: what is left when it gives way.
  bias = *in.bias + select(locked, c.held, drive * inverse) * momentum;
  const Vector6L s = momentum * -inverse;
  constexpr int kRow[] = {0, 0, 0, 1, 1, 2}, kColumn[] = {0, 1, 2, 1, 2, 2};
  for (int i = 0; i < 6; ++i) inertia.a[i] = in.inertia->a[i] + s[kRow[i]] * momentum[kColumn[i]];
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) inertia.b[i][j] = in.inertia->b[i][j] + s[i] * momentum[3 + j];
  }
  for (int i = 0; i < 6; ++i) {
    inertia.m[i] = in.inertia->m[i] + s[3 + kRow[i]] * momentum[3 + kColumn[i]];
  }
}

/// The load of a node: its effectors' and what is felt of its children.
Felt Frame::collect(std::size_t n) {
  const LaneNode& node = p_.nodes[n];
  const auto child = [&](std::int32_t i) -> NodeWork& { return node_[p_.children[i]]; };
  std::int32_t i = node.first_child;
  if (node.last_child - i == 1 && node.first_effector == node.last_effector) {
    return {&child(i).outside, &child(i).bias};
  }
  SpatialInertia<Lane>& inertia = node_[n].outside;
  Vector6L& bias = node_[n].bias;
  inertia.set_zero();
  bias.fill(Lane(0));
  for (; i < node.last_child; ++i) {
    inertia += child(i).outside;
    bias += child(i).bias;
  }
  for (std::int32_t i = node.first_effector; i < node.last_effector; ++i) {
    const std::int32_t e = p_.carried[i];
    inertia.add_point(lane(s_.mass[e]), effector_[e].arm);
    inertia.add_angular(lane(s_.inertia[e]));
    bias -= effector_[e].pull;
  }
  return {&inertia, &bias};
}

void Frame::eliminate(std::size_t n, const Lane& damping) {
  prepare(n, damping);
  const LaneNode& node = p_.nodes[n];
  NodeWork& work = node_[n];
  Felt in = collect(n);
  for (std::int32_t k = node.coordinate + node.coordinates - 1; k >= node.coordinate; --k) {
    CoordinateWork& c = coordinate_[k];
    const bool swings = node.ellipse && k < node.coordinate + 2;
    eliminate_coordinate(swings ? c.turned : c.axis, c, in, work.outside, work.bias);
    in = {&work.outside, &work.bias};
  }
}

/// Returns the largest step (rad, m).
Lane Frame::substitute() {
  Lane largest = 0;
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
      const Vector6L& axis = node.ellipse && k < node.coordinate + 2 ? c.turned : c.axis;
      const Lane feel = c.momentum.dot(twist);
      c.multiplier = feel + c.diagonal * c.held - c.drive;
      c.step = select(is_set(c.locked), c.held, (c.drive - feel) * c.inverse);
      twist += c.step * axis;
      largest = max(largest, abs(c.step));
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
  return largest;
}

/// Locks what left its range, releases what the objective pulls inwards. Returns where it did.
Mask Frame::update_box(std::size_t n, Mask lanes, bool may_release) {
  const LaneNode& node = p_.nodes[n];
  Mask changed = none();
  for (std::int32_t k = node.coordinate; k < node.coordinate + node.coordinates; ++k) {
    if (!(p_.limited[k] > 0.0f) || (node.ellipse && k < node.coordinate + 2)) continue;
    CoordinateWork& c = coordinate_[k];
    const Lane end = x(k) + c.step;
    const Mask locked = is_set(c.locked), free = lanes & !locked;
    const Mask above = free & (end > Lane(p_.max[k] + kTouch));
    const Mask below = free & (end < Lane(p_.min[k] - kTouch));
    Mask release = none();
    if (may_release && p_.max[k] > p_.min[k]) {
      release = lanes & locked & (c.multiplier * c.lock > Lane(0));
    }
    const Mask here = above | below | release;
    if (!any(here)) continue;
    c.lock = select(above, Lane(1), select(below, Lane(-1), select(release, Lane(0), c.lock)));
    changed = changed | here;
  }
  return changed;
}

/// The same for a swing; one that slid along its tangent takes up the border again where it ended.
Mask Frame::update_swing(std::size_t n, Mask lanes, bool may_release, const Lane& slide_tolerance,
                         float bend) {
  const LaneNode& node = p_.nodes[n];
  Swing& swing = node_[n].swing;
  const std::int32_t k = node.coordinate;
  const Lane end0 = x(k) + coordinate_[k].step, end1 = x(k + 1) + coordinate_[k + 1].step;
  const Mask active = is_set(swing.active), on = lanes & active;
  const Mask outside = lanes & (!active) & (level(node, end0, end1) > Lane(1.0f + kTouch));
  if (!any(on | outside)) return none();
  const Lane press = -coordinate_[k + 1].multiplier;
  const Mask release = may_release ? on & (press < Lane(0)) : none();
  swing.next_press = select(on, max(press, Lane(0)), select(outside, Lane(0), swing.next_press));
  const Lane slide = swing.normal0 * (end1 - swing.point1) - swing.normal1 * (end0 - swing.point0);
  const Mask slid = on & (!release) & (abs(slide) > slide_tolerance) &
                    (abs(slide) * swing.curvature >= Lane(bend));
  const Lane wish0 = select(on, swing.point0 - swing.normal1 * slide, end0);
  const Lane wish1 = select(on, swing.point1 + swing.normal0 * slide, end1);
  const Mask again = outside | slid;
  if (any(again)) {
    hold(node, swing, again, wish0, wish1);
    swing.press = select(again, swing.next_press, swing.press);
  }
  swing.active = select(release, Lane(0), swing.active);
  return again | release;
}

/// A lane takes part until its limits stay as they are, so that what it gets is not for its
/// neighbours to say: eliminating it again without a change changes nothing.
void Frame::solve(const Lane& damping, Mask lanes, bool early) {
  const auto nodes = p_.nodes.size();
  for (std::size_t n = 0; n < nodes; ++n) node_[n].dirty = true;
  for (int pass = 0; pass < kMostPasses; ++pass) {
    lane(s_.tree_passes) += flag(lanes);
    for (std::size_t n = nodes; n-- > 0;) {
      if (!node_[n].dirty) continue;
      eliminate(n, damping);
      node_[n].dirty = false;
      if (p_.nodes[n].parent >= 0) node_[p_.nodes[n].parent].dirty = true;
    }
    const Lane largest = substitute();
    const Lane slide_tolerance = max(Lane(kSlidePart) * largest, Lane(kTouch));
    const bool may_release = pass < kReleasePasses;
    Mask changed = none();
    for (std::size_t n = 0; n < nodes; ++n) {
      Mask here = update_box(n, lanes, may_release);
      if (p_.nodes[n].ellipse && pass < kTangentPasses) {
        here =
            here | update_swing(n, lanes, may_release, slide_tolerance, early ? kEarlyBend : 0.0f);
      }
      node_[n].dirty = any(here);
      changed = changed | here;
    }
    lanes = changed;
    if (!any(lanes)) return;
  }
}

}  // namespace
}  // namespace limber::LIMBER_LANES
