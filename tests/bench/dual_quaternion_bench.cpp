// The screw logarithm and exponential. What concatenation costs: concatenation_bench.cpp.
#include <benchmark/benchmark.h>

#include <vector>

#include "assets/model/dual_quaternion.h"
#include "tests/model/random_motion.h"

namespace limber {
namespace {

constexpr int kChain = 64;

std::vector<DualQuaternion> chain() {
  test::Random random(1);
  std::vector<DualQuaternion> all;
  for (int i = 0; i < kChain; ++i) all.push_back(random.motion());
  return all;
}

void log_exp(benchmark::State& state) {
  const auto local = chain();
  for (auto _ : state) {
    for (const auto& q : local) benchmark::DoNotOptimize(DualQuaternion::exp(q.log()));
  }
  state.SetItemsProcessed(state.iterations() * kChain);
}
BENCHMARK(log_exp);

}  // namespace
}  // namespace limber
