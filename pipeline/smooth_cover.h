#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

namespace limber {

/// [k] Weights of a smooth average over the frames -reach .. reach: a raised cosine, sum 1.
std::vector<double> smooth_window(std::int64_t reach);

/// [frame] The average by smooth_window; beyond the ends the first and last value go on.
template <class Value>
std::vector<Value> smooth_mean(std::span<const Value> x, std::span<const double> window) {
  const auto reach = static_cast<std::int64_t>(window.size()) / 2;
  const auto last = static_cast<std::int64_t>(x.size()) - 1;
  std::vector<Value> out;
  out.reserve(x.size());
  for (std::int64_t f = 0; f <= last; ++f) {
    Value sum = x[std::clamp<std::int64_t>(f - reach, 0, last)] * window[0];
    for (std::int64_t k = 1 - reach; k <= reach; ++k) {
      sum += x[std::clamp<std::int64_t>(f + k, 0, last)] * window[std::size_t(k + reach)];
    }
    out.push_back(sum);
  }
  return out;
}

/// [frame] The largest value of the frames -reach .. reach.
std::vector<double> running_max(std::span<const double> x, std::int64_t reach);

/// [frame] A smooth function that is nowhere below v (not empty). Where v bends down by no more
/// than `bend` (per frame^2) it stays close to v; around what is sharper it is an arch that bends
/// down by that much, and what bends up is rounded over `reach` (at least 1) frames.
std::vector<double> smooth_cover(const std::vector<double>& v, std::int64_t reach, double bend);

}  // namespace limber
