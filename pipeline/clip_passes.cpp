#include "pipeline/clip_passes.h"

#include <algorithm>
#include <limits>

namespace limber {
namespace {

constexpr double kJumpCost = 0.01;  // m^2 per rad^2
constexpr double kSameRad = 1e-3;   // poses closer than this are one solution

double turn2(std::span<const DualQuaternion> a, std::span<const DualQuaternion> b) {
  double sum = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    const double angle = rotation_angle(a[i].rotation(), b[i].rotation());
    sum += angle * angle;
  }
  return sum;
}

}  // namespace

Pass::Pass(std::int64_t frames, std::size_t joint_rows)
    : rows(joint_rows),
      poses(static_cast<std::size_t>(frames) * joint_rows),
      cost(static_cast<std::size_t>(frames)) {}

bool same_solution(const Pass& a, const Pass& b, std::int64_t frame) {
  return turn2(a.pose(frame), b.pose(frame)) < kSameRad * kSameRad;
}

std::vector<DualQuaternion> join_passes(std::span<const Pass* const> passes) {
  const std::size_t n = passes.size(), rows = passes.front()->rows;
  const std::int64_t frames = passes.front()->frames();
  std::vector<double> best(n), before(n);
  std::vector<std::size_t> came_from(static_cast<std::size_t>(frames) * n);
  for (std::size_t k = 0; k < n; ++k) best[k] = passes[k]->cost[0];
  for (std::int64_t f = 1; f < frames; ++f) {
    std::swap(best, before);
    for (std::size_t k = 0; k < n; ++k) {
      best[k] = std::numeric_limits<double>::infinity();
      for (std::size_t j = 0; j < n; ++j) {
        const double jump = kJumpCost * turn2(passes[j]->pose(f - 1), passes[k]->pose(f));
        const double cost = before[j] + jump + passes[k]->cost[f];
        if (cost < best[k]) best[k] = cost, came_from[std::size_t(f) * n + k] = j;
      }
    }
  }
  std::vector<DualQuaternion> out(static_cast<std::size_t>(frames) * rows);
  auto k = static_cast<std::size_t>(std::ranges::min_element(best) - best.begin());
  for (std::int64_t f = frames - 1; f >= 0; --f) {
    std::ranges::copy(passes[k]->pose(f), out.begin() + f * std::int64_t(rows));
    k = came_from[std::size_t(f) * n + k];
  }
  return out;
}

}  // namespace limber
