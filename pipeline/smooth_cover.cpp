// The arch over v is its dilation by a parabola (P. Maragos, Slope transforms: theory and
// application to nonlinear signal processing, 1995),
//   a(t) = max over u of v(u) - bend / 2 (t - u)^2,
// the least function over v whose bends down are no sharper than the parabola's. Its kinks all bend
// up. The mean of its running maximum over one and the same window rounds them and is not below v:
// each value that is averaged has v's own place in its window.
#include "pipeline/smooth_cover.h"

#include <algorithm>
#include <cmath>

namespace limber {

std::vector<double> smooth_window(std::int64_t reach) {
  std::vector<double> out;
  for (std::int64_t k = -reach; k <= reach; ++k) {
    out.push_back((1.0 + std::cos(M_PI * double(k) / double(reach + 1))) / double(2 * reach + 2));
  }
  return out;
}

std::vector<double> running_max(std::span<const double> x, std::int64_t reach) {
  const auto last = static_cast<std::int64_t>(x.size()) - 1;
  std::vector<double> out;
  out.reserve(x.size());
  for (std::int64_t f = 0; f <= last; ++f) {
    const auto from = x.begin() + std::max<std::int64_t>(f - reach, 0);
    out.push_back(*std::max_element(from, x.begin() + std::min(f + reach, last) + 1));
  }
  return out;
}

std::vector<double> smooth_cover(const std::vector<double>& v, std::int64_t reach, double bend) {
  const auto last = static_cast<std::int64_t>(v.size()) - 1;
  const double most = *std::ranges::max_element(v);
  std::vector<double> arch = v;
  for (std::int64_t f = 0; f <= last; ++f) {
    for (std::int64_t k = 1; k <= last; ++k) {
      const double lower = 0.5 * bend * double(k) * double(k);
      if (most - lower <= arch[f]) break;
      if (f + k <= last) arch[f] = std::max(arch[f], v[f + k] - lower);
      if (f >= k) arch[f] = std::max(arch[f], v[f - k] - lower);
    }
  }
  return smooth_mean<double>(running_max(arch, reach), smooth_window(reach));
}

}  // namespace limber
