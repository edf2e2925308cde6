// Doubles in and out, four lanes at a time: targets become goals in floats, the last evaluation
// becomes poses.
//
// A pose's limits hold to 1e-5 degrees, so its rotation is not the kinematics' product of float
// quaternions. It is built again in doubles from the cosines and sines of each coordinate, which
// only make an angle wrong by what the ranges are narrower for (lane_problem.cpp); axes stay as
// exact as the rig's. What is not quite unit is scaled by 1 / |q| ~ (3 - |q|^2) / 2, whose error is
// of second order, 1e-13.
#pragma once

#include "solver/lane_frame.h"

namespace limber::LIMBER_LANES {
namespace {

typedef double Loose __attribute__((vector_size(32), may_alias, aligned(8)));

inline Doubles all_four(double d) { return Doubles{d, d, d, d}; }

/// Entries `first` to `first` + 3 of four records that lie `stride` doubles apart: one entry per
/// row, one record per lane.
inline void read_rows(const double* records, std::size_t stride, Doubles (&rows)[4]) {
  for (int i = 0; i < kHalf; ++i) rows[i] = *reinterpret_cast<const Loose*>(records + i * stride);
  transpose(rows);
}
inline void write_rows(Doubles (&rows)[4], double* records, std::size_t stride) {
  transpose(rows);
  for (int i = 0; i < kHalf; ++i) *reinterpret_cast<Loose*>(records + i * stride) = rows[i];
}

void Frame::read_goals(const double* targets) {
  const std::size_t effectors = p_.effectors.size(), stride = p_.target_stride * effectors;
  for (std::size_t e = 0; e < effectors; ++e) {
    const LaneEffector& effector = p_.effectors[e];
    for (int half = 0; half < 2; ++half) {
      const double* first = targets + half * kHalf * stride + e * p_.target_stride;
      Doubles r[4], d[4];  // real, dual: x, y, z, w
      read_rows(first, stride, r);
      read_rows(first + 4, stride, d);
      for (int i = 0; i < 3; ++i) {  // t = 2 dual real*
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        const Doubles t = d[i] * r[3] - d[3] * r[i] - d[j] * r[k] + d[k] * r[j];
        set_half(lane(s_.goal_position[3 * e + i]), half, t + t);
        set_half(lane(s_.goal_rotation[4 * e + 1 + i]), half, r[i]);
      }
      set_half(lane(s_.goal_rotation[4 * e]), half, r[3]);
      const double* weight = first + 8;
      const Doubles w{weight[0], weight[stride], weight[2 * stride], weight[3 * stride]};
      const Doubles wp = w * effector.weight_pos, wr = w * effector.weight_rot;
      set_half(lane(s_.mass[e]), half, wp * wp);
      set_half(lane(s_.inertia[e]), half, wr * wr);
    }
  }
}

/// The four numbers of a LinearRotation, in doubles.
inline void motion_of(const LaneNode& node, const Lane (&factor)[4], const Lane* x, int half,
                      Doubles (&m)[4]) {
  Doubles f[4];
  for (int i = 0; i < 4; ++i) f[i] = doubles(factor[i], half);
  switch (node.motion) {
    case LaneNode::Motion::universal:
      m[0] = f[0] * f[2];
      m[1] = f[1] * f[2];
      m[2] = f[0] * f[3];
      m[3] = f[1] * f[3];
      return;
    case LaneNode::Motion::swing_twist: {
      const Doubles s0 = f[1] * doubles(x[0], half), s1 = f[1] * doubles(x[1], half);
      m[0] = f[0] * f[2];
      m[1] = s0 * f[2] + s1 * f[3];
      m[2] = s1 * f[2] - s0 * f[3];
      m[3] = f[0] * f[3];
      return;
    }
    default:
      for (int i = 0; i < 4; ++i) m[i] = f[i];
  }
}

void Frame::write_pose(const LaneNode& node, const NodeWork& work, int half) {
  const LinearRotation<double>& map = node.parent_from_joint;
  Doubles m[4], norm2{}, q[4];  // q: x, y, z, w
  motion_of(node, work.factor, &x(node.coordinate), half, m);
  for (int i = 0; i < map.columns; ++i) norm2 += m[i] * m[i];
  const Doubles unit = 1.5 - 0.5 * norm2;
  for (int row = 0; row < 4; ++row) {
    Doubles sum = m[0] * map.column[0][row];
    for (int i = 1; i < map.columns; ++i) sum += m[i] * map.column[i][row];
    q[(row + 3) % 4] = unit * sum;
  }
  Doubles h[3];  // half the translation
  for (int i = 0; i < 3; ++i) {
    h[i] = all_four(node.half_offset[i]);
    if (node.free) h[i] += 0.5 * doubles(x(node.coordinate + i), half);
  }
  Doubles dual[4];  // (0, h) q
  dual[3] = -(h[0] * q[0] + h[1] * q[1] + h[2] * q[2]);
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    dual[i] = h[i] * q[3] + h[j] * q[k] - h[k] * q[j];
  }
  double* first = s_.poses + 8 * (half * kHalf * p_.joints + node.joint);
  write_rows(q, first, 8 * p_.joints);
  write_rows(dual, first + 4, 8 * p_.joints);
}

void Frame::write_poses() {
  for (std::size_t n = 0; n < p_.nodes.size(); ++n) {
    for (int half = 0; half < 2; ++half) write_pose(p_.nodes[n], node_[n], half);
  }
}

}  // namespace
}  // namespace limber::LIMBER_LANES
