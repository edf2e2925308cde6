#include "validation/contact_detection.h"

#include <algorithm>
#include <cmath>

namespace limber {
namespace {

std::vector<FrameInterval> runs_of(const std::vector<std::uint8_t>& mask, std::uint8_t value) {
  std::vector<FrameInterval> runs;
  const auto frames = static_cast<std::int64_t>(mask.size());
  for (std::int64_t f = 0; f < frames;) {
    std::int64_t end = f;
    while (end < frames && mask[end] == value) ++end;
    if (end > f) runs.push_back({f, end});
    f = std::max(end, f + 1);
  }
  return runs;
}

std::int64_t frames_in(double seconds, double rate_hz) {
  return static_cast<std::int64_t>(std::nearbyint(seconds * rate_hz));
}

/// Standing per frame: below both thresholds, or within the release thresholds on either side of a
/// frame that is (so that the answer does not depend on the direction of time).
std::vector<std::uint8_t> standing(std::span<const Eigen::Vector3d> p, double rate_hz,
                                   double floor_y, const ContactOptions& o) {
  const std::vector<double> speed = speed_of(p, rate_hz);
  const auto below = [&](std::size_t f, double height_factor, double speed_factor) {
    return p[f].y() - floor_y < o.scale * o.height_m * height_factor &&
           speed[f] < o.scale * o.speed_m_s * speed_factor;
  };
  std::vector<std::uint8_t> mask(p.size());
  for (std::size_t f = 0; f < p.size(); ++f) mask[f] = below(f, 1.0, 1.0);
  if (o.release_height > 1.0 || o.release_speed > 1.0) {
    for (std::size_t f = 1; f < p.size(); ++f) {
      if (mask[f - 1] && below(f, o.release_height, o.release_speed)) mask[f] = 1;
    }
    for (std::size_t f = p.size() - 1; f-- > 0;) {
      if (mask[f + 1] && below(f, o.release_height, o.release_speed)) mask[f] = 1;
    }
  }
  return mask;
}

}  // namespace

double percentile(std::vector<double> values, double percent) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  const double rank = percent / 100.0 * static_cast<double>(values.size() - 1);
  const auto low = static_cast<std::size_t>(rank);
  const std::size_t high = std::min(low + 1, values.size() - 1);
  return values[low] + (rank - static_cast<double>(low)) * (values[high] - values[low]);
}

std::vector<double> speed_of(std::span<const Eigen::Vector3d> p, double rate_hz) {
  const std::size_t n = p.size();
  std::vector<double> central(n, 0.0), smooth(n, 0.0);
  if (n < 3) return smooth;
  for (std::size_t f = 1; f + 1 < n; ++f) central[f] = (p[f + 1] - p[f - 1]).norm() * rate_hz / 2;
  central[0] = central[1];
  central[n - 1] = central[n - 2];
  for (std::size_t f = 0; f < n; ++f) {
    const std::size_t before = f == 0 ? 0 : f - 1, after = std::min(f + 1, n - 1);
    smooth[f] = (central[before] + central[f] + central[after]) / 3.0;
  }
  return smooth;
}

double floor_level(std::span<const std::vector<Eigen::Vector3d>> tracks) {
  std::vector<double> heights;
  for (const std::vector<Eigen::Vector3d>& track : tracks) {
    for (const Eigen::Vector3d& p : track) heights.push_back(p.y());
  }
  return percentile(std::move(heights), 3.0);
}

std::vector<FrameInterval> detect_contacts(std::span<const Eigen::Vector3d> p, double rate_hz,
                                           double floor_y, const ContactOptions& options) {
  if (p.empty()) return {};
  const auto frames = static_cast<std::int64_t>(p.size());
  std::vector<std::uint8_t> mask = standing(p, rate_hz, floor_y, options);
  const std::int64_t gap = frames_in(options.gap_s, rate_hz);
  for (const FrameInterval& run : runs_of(mask, 0)) {
    const bool between = run.begin > 0 && run.end < frames;
    if (between && run.end - run.begin <= gap) {
      std::fill(mask.begin() + run.begin, mask.begin() + run.end, std::uint8_t{1});
    }
  }
  const std::int64_t shortest = std::max<std::int64_t>(2, frames_in(options.min_s, rate_hz));
  const std::int64_t trim = frames_in(options.trim_s, rate_hz);
  std::vector<FrameInterval> contacts;
  for (FrameInterval run : runs_of(mask, 1)) {
    if (run.end - run.begin < shortest) continue;
    if (run.end - run.begin > 2 * trim + 2) {  // the clip's own ends are no touch-down
      if (run.begin > 0) run.begin += trim;
      if (run.end < frames) run.end -= trim;
    }
    contacts.push_back(run);
  }
  return contacts;
}

std::vector<std::uint8_t> contact_mask(std::span<const FrameInterval> intervals,
                                       std::int64_t frames) {
  std::vector<std::uint8_t> mask(static_cast<std::size_t>(frames), 0);
  for (const FrameInterval& i : intervals) {
    for (std::int64_t f = std::max<std::int64_t>(i.begin, 0); f < std::min(i.end, frames); ++f) {
      mask[f] = 1;
    }
  }
  return mask;
}

}  // namespace limber
