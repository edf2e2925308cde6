#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "assets/model/result.h"

namespace limber {

/// Position along, or rotation about, x, y or z.
enum class BvhChannel : std::uint8_t {
  x_position,
  y_position,
  z_position,
  x_rotation,
  y_rotation,
  z_rotation
};

inline bool is_rotation(BvhChannel channel) { return channel >= BvhChannel::x_rotation; }
inline int axis_of(BvhChannel channel) { return static_cast<int>(channel) % 3; }

struct BvhJoint {
  std::string name;  ///< bytes as in the file; empty for End Sites
  std::int32_t parent = -1;
  bool end_site = false;
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();  ///< file units
  std::size_t channel_begin = 0;                     ///< column of the motion table
  std::vector<BvhChannel> channels;                  ///< in file order
};

/// A BVH file as written: file units, degrees.
struct BvhDocument {
  std::vector<BvhJoint> joints;  ///< document order: parents first
  std::size_t columns = 0;       ///< channels of all joints
  std::int64_t declared_frames = 0;
  double frame_time_s = 0.0;
  std::string frame_time_text;
  std::int64_t expected_frames = 0;  ///< at most, by the bytes that remain
  std::int64_t frames = 0;           ///< whole rows found
  Warnings warnings;
};

/// Takes each whole row of the motion, [columns], in order; the document's hierarchy is complete.
/// Values are finite. Rows are not kept: a million frames would double what a clip needs.
using BvhRowSink = std::function<void(const BvhDocument&, std::span<const double> row)>;

/// Takes, now and then, how many bytes of the text have been passed and will not be read again.
using BvhPassed = std::function<void(std::size_t)>;

/// One pass over the text; no declared count is believed beyond the bytes that remain.
/// Fails (see failure.h) with `bvh-syntax`, `bvh-channels`, `bvh-depth`, `bvh-size`,
/// `bvh-no-motion`, `bvh-frame-time`, `bvh-number`, `bvh-nan` or `bvh-row-length`.
BvhDocument parse_bvh(std::string_view text, const BvhRowSink&, const BvhPassed& = {});

}  // namespace limber
