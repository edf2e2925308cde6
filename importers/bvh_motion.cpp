// From channels to local transforms, sixteen frames at a time: all frames share a joint's program
// of channels, so each step of it is one plain loop over frames, which compilers turn into vector
// instructions. Only elementwise IEEE arithmetic stands in those loops: the result does not depend
// on the width of the vectors.
//
// local = T(position) R(first rotation channel) R(second) R(third), R(a) = (cos a/2, sin a/2 axis).
#include "importers/bvh_motion.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <numbers>

#include "importers/frame_rate.h"
#include "importers/memory_pages.h"

// A function and what it calls, compiled twice: the loader takes what the processor has.
#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define LIMBER_WITH_AVX2 __attribute__((target_clones("avx2", "default"), flatten))
#else
#define LIMBER_WITH_AVX2
#endif

namespace limber {

namespace {

constexpr std::size_t kLanes = 16;
using Lanes = std::array<double, kLanes>;  // one figure of each frame of a block

struct HalfTurn {
  Lanes cosine, sine;
};

/// cos and sin of x for |x| <= pi/4: Taylor series, whose first term left out is below 1e-16.
inline void series(double x, double& cosine, double& sine) {
  const double y = x * x;
  cosine =
      1.0 +
      y * (-1.0 / 2 +
           y * (1.0 / 24 + y * (-1.0 / 720 +
                                y * (1.0 / 40320 + y * (-1.0 / 3628800 +
                                                        y * (1.0 / 479001600 +
                                                             y * (-1.0 / 87178291200 +
                                                                  y * (1.0 / 20922789888000))))))));
  sine =
      x + x * y *
              (-1.0 / 6 +
               y * (1.0 / 120 + y * (-1.0 / 5040 +
                                     y * (1.0 / 362880 + y * (-1.0 / 39916800 +
                                                              y * (1.0 / 6227020800 +
                                                                   y * (-1.0 / 1307674368000)))))));
}

constexpr double kMostDegrees = 1e9;

/// Cosine and sine of half of each angle, which is below kMostDegrees. An angle less its nearest
/// multiple of 180 degrees is exact; each such multiple is a quarter turn of the half angle:
/// (c, s), (-s, c), (-c, -s), (s, -c).
void half_turns(const double* angles_deg, HalfTurn& turn) {
  // Added and taken away again, it rounds to an integer, which its last bits hold meanwhile.
  constexpr double kRounder = 3.0 * (std::int64_t{1} << 51);
  for (std::size_t f = 0; f < kLanes; ++f) {
    const double biased = angles_deg[f] * (1.0 / 180.0) + kRounder;
    const auto quarters = std::bit_cast<std::uint64_t>(biased);
    const double rest_deg = angles_deg[f] - 180.0 * (biased - kRounder);
    double c = 0.0, s = 0.0;
    series(rest_deg * (std::numbers::pi / 360.0), c, s);
    const auto c_bits = std::bit_cast<std::uint64_t>(c), s_bits = std::bit_cast<std::uint64_t>(s);
    const std::uint64_t swap = (c_bits ^ s_bits) & (0 - (quarters & 1));
    const std::uint64_t sine_sign = (quarters & 2) << 62;
    const std::uint64_t cosine_sign = sine_sign ^ (quarters << 63);
    turn.cosine[f] = std::bit_cast<double>((c_bits ^ swap) ^ cosine_sign);
    turn.sine[f] = std::bit_cast<double>((s_bits ^ swap) ^ sine_sign);
  }
}

/// Rotations w + v of a block's frames.
struct Rotations {
  Lanes w;
  std::array<Lanes, 3> v;
};

/// rotation = rotation * turn about one axis: half the products of the general case.
void turn_about(int axis, const HalfTurn& turn, Rotations& rotation) {
  Lanes &w = rotation.w, &a = rotation.v[axis];
  Lanes &b = rotation.v[(axis + 1) % 3], &d = rotation.v[(axis + 2) % 3];
  for (std::size_t f = 0; f < kLanes; ++f) {
    const double c = turn.cosine[f], s = turn.sine[f];
    const double was_w = w[f], was_b = b[f];
    w[f] = c * was_w - s * a[f];
    a[f] = c * a[f] + s * was_w;
    b[f] = c * was_b + s * d[f];
    d[f] = c * d[f] - s * was_b;
  }
}

/// dual = 1/2 t rotation, as coefficients of the same layout.
void half_product(const std::array<Lanes, 3>& t, const Rotations& q, Rotations& dual) {
  for (std::size_t f = 0; f < kLanes; ++f) {
    const double x = 0.5 * t[0][f], y = 0.5 * t[1][f], z = 0.5 * t[2][f];
    const double w = q.w[f], i = q.v[0][f], j = q.v[1][f], k = q.v[2][f];
    dual.w[f] = -(x * i + y * j + z * k);
    dual.v[0][f] = x * w + (y * k - z * j);
    dual.v[1][f] = y * w + (z * i - x * k);
    dual.v[2][f] = z * w + (x * j - y * i);
  }
}

struct JointBlock {
  Rotations real, dual;

  DualQuaternion frame(std::size_t f) const {
    return {{real.w[f], real.v[0][f], real.v[1][f], real.v[2][f]},
            {dual.w[f], dual.v[0][f], dual.v[1][f], dual.v[2][f]}};
  }
};

/// Drops whole turns of the rotation where angles are so large that half_turns could not.
void drop_turns(double* angles_deg) {
  double largest = 0.0;
  for (std::size_t f = 0; f < kLanes; ++f) largest = std::max(largest, std::abs(angles_deg[f]));
  if (largest < kMostDegrees) return;
  for (std::size_t f = 0; f < kLanes; ++f) angles_deg[f] = std::remainder(angles_deg[f], 720.0);
}

LIMBER_WITH_AVX2 void turn_joint(const BvhJoint& joint, double* block, JointBlock& out) {
  std::array<Lanes, 3> position;
  for (int k = 0; k < 3; ++k) position[k].fill(joint.offset[k]);
  out.real.w.fill(1.0);
  for (Lanes& v : out.real.v) v.fill(0.0);
  HalfTurn turn;
  for (std::size_t c = 0; c < joint.channels.size(); ++c) {
    double* const values = block + (joint.channel_begin + c) * kLanes;
    const int axis = axis_of(joint.channels[c]);
    if (is_rotation(joint.channels[c])) {
      drop_turns(values);
      half_turns(values, turn);
      turn_about(axis, turn, out.real);
    } else {
      std::copy_n(values, kLanes, position[axis].begin());
    }
  }
  half_product(position, out.real, out.dual);
}

}  // namespace

void BvhMotion::begin(const BvhDocument& document) {
  const std::size_t joints = document.joints.size();
  block_.resize(document.columns * kLanes);
  largest_.resize(joints, 0.0);
  const auto frames = static_cast<std::size_t>(document.expected_frames);
  poses_.reserve(joints * (frames + kLanes));
  prefer_large_pages(poses_.data(), poses_.capacity() * sizeof(DualQuaternion));
}

void BvhMotion::add(const BvhDocument& document, std::span<const double> row) {
  if (block_.empty()) begin(document);
  for (std::size_t c = 0; c < row.size(); ++c) block_[c * kLanes + in_block_] = row[c];
  if (++in_block_ == kLanes) turn_block_into_poses(document);
}

void BvhMotion::turn_block_into_poses(const BvhDocument& document) {
  const std::size_t joints = document.joints.size(), begin = poses_.size();
  poses_.resize(begin + joints * in_block_);
  JointBlock made;
  for (std::size_t j = 0; j < joints; ++j) {
    turn_joint(document.joints[j], block_.data(), made);
    const DualQuaternion* before = begin == 0 ? nullptr : &poses_[begin - joints + j];
    for (std::size_t f = 0; f < in_block_; ++f) {
      DualQuaternion& pose = poses_[begin + f * joints + j];
      pose = made.frame(f);
      if (before != nullptr && before->real.dot(pose.real) < 0.0) pose = -pose;
      before = &pose;
    }
  }
  note_positions(document);
  in_block_ = 0;
}

/// Lanes beyond the block's frames hold older frames, or zeros.
void BvhMotion::note_positions(const BvhDocument& document) {
  for (std::size_t j = 0; j < document.joints.size(); ++j) {
    const BvhJoint& joint = document.joints[j];
    if (joint.parent < 0) continue;
    for (std::size_t c = 0; c < joint.channels.size(); ++c) {
      if (is_rotation(joint.channels[c])) continue;
      const double* const values = block_.data() + (joint.channel_begin + c) * kLanes;
      for (std::size_t f = 0; f < kLanes; ++f) {
        largest_[j] = std::max(largest_[j], std::abs(values[f]));
      }
    }
  }
}

/// Non-root joints whose position channels hold nothing but zeros (give or take rounding)
/// although OFFSET is not zero: some exporters fill six channels everywhere. Taken literally
/// they would collapse the body.
void BvhMotion::keep_offsets(const BvhDocument& document, Warnings& warnings) {
  double longest = 0.0;
  for (const BvhJoint& joint : document.joints) {
    if (joint.parent >= 0) longest = std::max(longest, joint.offset.norm());
  }
  std::int64_t kept = 0;
  for (std::size_t i = 0; i < document.joints.size(); ++i) {
    const BvhJoint& joint = document.joints[i];
    const bool has_position = std::any_of(joint.channels.begin(), joint.channels.end(),
                                          [](BvhChannel channel) { return !is_rotation(channel); });
    if (joint.parent < 0 || !has_position || joint.offset.isZero(0.0)) continue;
    if (largest_[i] > std::max(1e-2 * joint.offset.norm(), 1e-4 * longest)) continue;
    ++kept;
    for (std::size_t at = i; at < poses_.size(); at += document.joints.size()) {
      poses_[at] = DualQuaternion::from_rotation_translation(poses_[at].rotation(), joint.offset);
    }
  }
  if (kept == 0) return;
  warnings.push_back({"bvh-zero-positions",
                      fmt::format("the position channels of {} joints hold zeros only; their "
                                  "OFFSETs were kept",
                                  kept)});
}

Clip BvhMotion::finish(const BvhDocument& document, Warnings& warnings) {
  if (in_block_ > 0) turn_block_into_poses(document);
  keep_offsets(document, warnings);
  Clip clip;
  clip.rate_hz = snap_rate_hz(document.frame_time_s, document.frame_time_text);
  clip.joints = static_cast<std::int32_t>(document.joints.size());
  clip.parent_from_joint = std::move(poses_);
  return clip;
}

}  // namespace limber
