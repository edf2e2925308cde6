#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

namespace limber {

/// When a foot point counts as standing. Lengths and speeds are those of a person of 1.75 m and are
/// multiplied by `scale`. The defaults are the measure by which motion is judged; a retargeter that
/// wants to be less nervous raises the release factors (hysteresis).
struct ContactOptions {
  double height_m = 0.035;    ///< a contact begins below this height above the floor level
  double speed_m_s = 0.15;    ///< and below this speed
  double release_height = 1;  ///< >= 1: a contact that has begun lasts up to height_m times this
  double release_speed = 1;   ///< and up to speed_m_s times this
  double min_s = 0.10;        ///< shorter contacts are none
  double gap_s = 0.05;        ///< gaps up to this are closed
  double trim_s = 0.034;      ///< cut off both ends: touch-down and lift-off are not standing
  double scale = 1.0;         ///< stature / 1.75 m
};

/// Frames [begin, end).
struct FrameInterval {
  std::int64_t begin = 0, end = 0;
  bool operator==(const FrameInterval&) const = default;
};

/// The value below which `percent` of the values lie (linear between ranks); 0 for no values.
double percentile(std::vector<double> values, double percent);

/// Speed in m/s per frame: central differences, then the mean of three frames.
std::vector<double> speed_of(std::span<const Eigen::Vector3d> world_positions, double rate_hz);

/// Floor level of a kind of foot point: the 3rd percentile of its heights, both feet together.
double floor_level(std::span<const std::vector<Eigen::Vector3d>> tracks);

/// Contacts of one foot point, in order and disjoint. `floor_y` is the height of the point when it
/// stands, m.
std::vector<FrameInterval> detect_contacts(std::span<const Eigen::Vector3d> world_positions,
                                           double rate_hz, double floor_y,
                                           const ContactOptions& = {});

/// 1 for every frame inside an interval.
std::vector<std::uint8_t> contact_mask(std::span<const FrameInterval>, std::int64_t frames);

}  // namespace limber
