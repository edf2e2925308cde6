// Swings and their ellipses in lanes: swing_twist.cpp derives the nearest point,
// tree_elimination.cpp what is held.
#pragma once

#include "solver/lane_frame.h"

namespace limber::LIMBER_LANES {
namespace {

constexpr float kMostCurvature = 1e3f;  // 1/rad
constexpr int kEllipseSteps = 3;        // of Newton; whatever is left is a slip along the border

inline Lane radius(const LaneNode& node, int axis, const Lane& s) {
  return select(s < Lane(0), Lane(node.radius[axis][0]), Lane(node.radius[axis][1]));
}

/// 1 on the border.
inline Lane level(const LaneNode& node, const Lane& s0, const Lane& s1) {
  const Lane u = s0 / radius(node, 0, s0), v = s1 / radius(node, 1, s1);
  return u * u + v * v;
}

/// The nearest point of the border, for lanes on or outside of it.
inline void nearest(const LaneNode& node, Lane& s0, Lane& s1) {
  const Lane a = radius(node, 0, s0), b = radius(node, 1, s1), a2 = a * a, b2 = b * b;
  const Lane ap = a * abs(s0), bp = b * abs(s1);
  Lane t = max(Lane(0), max(ap - a2, bp - b2));
  for (int i = 0; i < kEllipseSteps; ++i) {
    const Lane ra = Lane(1) / (t + a2), rb = Lane(1) / (t + b2);
    const Lane u = ap * ra, v = bp * rb, u2 = u * u, v2 = v * v;
    const Lane f = max(u2 + v2 - Lane(1), Lane(0));
    t += Lane(0.5f) * f / (u2 * ra + v2 * rb + Lane(1e-30f));
  }
  const Lane u = ap / (t + a2), v = bp / (t + b2);
  const Lane norm = Lane(1) / sqrt(max(u * u + v * v, Lane(1e-30f)));
  s0 = select(s0 < Lane(0), -a, a) * (u * norm);
  s1 = select(s1 < Lane(0), -b, b) * (v * norm);
}

/// Where `lanes`: held to the tangent at the border's point nearest to s (on it or outside).
inline void hold(const LaneNode& node, Swing& swing, Mask lanes, const Lane& s0, const Lane& s1) {
  Lane p0 = s0, p1 = s1;
  nearest(node, p0, p1);
  const Lane a = radius(node, 0, s0), b = radius(node, 1, s1);
  const Lane g0 = p0 / (a * a), g1 = p1 / (b * b);
  const Lane norm = Lane(1) / sqrt(max(g0 * g0 + g1 * g1, Lane(1e-30f)));
  const Lane u = a * p1 / b, v = b * p0 / a, speed2 = max(u * u + v * v, Lane(1e-12f));
  const Lane curvature = min(a * b / (speed2 * sqrt(speed2)), Lane(kMostCurvature));
  swing.point0 = select(lanes, p0, swing.point0);
  swing.point1 = select(lanes, p1, swing.point1);
  swing.normal0 = select(lanes, g0 * norm, swing.normal0);
  swing.normal1 = select(lanes, g1 * norm, swing.normal1);
  swing.curvature = select(lanes, curvature, swing.curvature);
  swing.active = select(lanes, Lane(1), swing.active);
}

}  // namespace
}  // namespace limber::LIMBER_LANES
