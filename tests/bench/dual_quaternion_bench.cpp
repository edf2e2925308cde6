// What one concatenation costs: dual quaternion, quaternion + vector, 4x4 and 3x4 matrix, along a
// chain of 64 as forward kinematics does it.
#include <benchmark/benchmark.h>

#include <Eigen/Geometry>
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

void dual_quaternion(benchmark::State& state) {
  const auto local = chain();
  for (auto _ : state) {
    DualQuaternion world;
    for (const auto& q : local) world = world * q;
    benchmark::DoNotOptimize(world);
  }
  state.SetItemsProcessed(state.iterations() * kChain);
}
BENCHMARK(dual_quaternion);

void quaternion_and_vector(benchmark::State& state) {
  std::vector<std::pair<Eigen::Quaterniond, Eigen::Vector3d>> local;
  for (const auto& q : chain()) local.emplace_back(q.rotation(), q.translation());
  for (auto _ : state) {
    Eigen::Quaterniond rotation(1, 0, 0, 0);
    Eigen::Vector3d position(0, 0, 0);
    for (const auto& [r, t] : local) {
      position += rotation * t;
      rotation = rotation * r;
    }
    benchmark::DoNotOptimize(rotation);
    benchmark::DoNotOptimize(position);
  }
  state.SetItemsProcessed(state.iterations() * kChain);
}
BENCHMARK(quaternion_and_vector);

void matrix_4x4(benchmark::State& state) {
  std::vector<Eigen::Matrix4d> local;
  for (const auto& q : chain()) local.push_back(q.matrix());
  for (auto _ : state) {
    Eigen::Matrix4d world = Eigen::Matrix4d::Identity();
    for (const auto& m : local) world = (world * m).eval();
    benchmark::DoNotOptimize(world);
  }
  state.SetItemsProcessed(state.iterations() * kChain);
}
BENCHMARK(matrix_4x4);

void matrix_3x4(benchmark::State& state) {
  std::vector<Eigen::Affine3d> local;
  for (const auto& q : chain()) local.emplace_back(q.matrix());
  for (auto _ : state) {
    Eigen::Transform<double, 3, Eigen::AffineCompact> world;
    world.setIdentity();
    for (const auto& m : local) world = world * m;
    benchmark::DoNotOptimize(world);
  }
  state.SetItemsProcessed(state.iterations() * kChain);
}
BENCHMARK(matrix_3x4);

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
