#pragma once

#include <cstdint>

namespace limber {

/// Numbers strewn over [0, 1), the same ones for the same seed on every machine (splitmix64:
/// G. Steele, D. Lea, C. Flood, OOPSLA 2014).
class StrewnNumbers {
 public:
  explicit StrewnNumbers(std::uint64_t seed) : state_(kGolden * seed) {}
  double next() {
    state_ += kGolden;
    std::uint64_t z = state_;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    return static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1p-53;
  }

 private:
  static constexpr std::uint64_t kGolden = 0x9e3779b97f4a7c15ULL;
  std::uint64_t state_;
};

}  // namespace limber
