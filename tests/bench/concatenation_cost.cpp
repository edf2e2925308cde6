#include <benchmark/benchmark.h>
#include <fmt/core.h>

#include <array>

#include "tests/bench/concatenation_tables.h"
#include "tests/bench/rounds.h"
#include "tests/model/counted.h"
#include "tests/model/rigid_forms.h"
#include "tests/solver/test_rigs.h"

namespace limber::test {
namespace {

ExactMotion exact(const DualQuaternion& q) {
  ExactMotion motion;
  motion.real.coeffs() = q.real.coeffs().cast<long double>();
  motion.dual.coeffs() = q.dual.coeffs().cast<long double>();
  return motion;
}

template <class Form>
void count_row(int numbers, const char* paper) {
  Random random(1);
  const Form a = Form::from(exact(random.motion())), b = Form::from(exact(random.motion()));
  const Operations product = operations_of([&] { return a * b; });
  const Operations mending = operations_of([&] { return a.mended(); });
  fmt::print("  {:<20} {:>7}   {:>7}   {:>3} + {:<3}   {:>3} + {:<3} {} div {} sqrt\n", Form::name,
             numbers, paper, product.multiplications, product.additions, mending.multiplications,
             mending.additions, mending.divisions, mending.square_roots);
}

/// The chain and the batch: 64 products one upon the other (latency), 64 apart (throughput).
template <class Form>
void add_products(std::vector<Contender>& chain, std::vector<Contender>& batch) {
  constexpr int kCount = 64;
  Random random(1);
  std::vector<Form> all;
  for (int i = 0; i < kCount; ++i) all.push_back(Form::from(exact(random.motion())));
  chain.push_back({Form::name, kCount, [all] {
                     Form world;
                     for (const Form& local : all) world = world * local;
                     benchmark::DoNotOptimize(world);
                   }});
  batch.push_back({Form::name, kCount, [all, out = all]() mutable {
                     for (int i = 0; i < kCount; ++i) out[i] = all[i] * all[kCount - 1 - i];
                     benchmark::DoNotOptimize(out.data());
                     benchmark::ClobberMemory();
                   }});
}

template <class Form>
Contender kinematics(const Rig& rig) {
  Random random(2);
  std::vector<Form> local;
  std::vector<std::int32_t> parents;
  for (const RigJoint& joint : rig.joints) parents.push_back(joint.parent);
  for (const DualQuaternion& q : allowed_pose(random, rig)) local.push_back(Form::from(exact(q)));
  return {Form::name, double(rig.size()), [local, parents, world = local]() mutable {
            for (std::size_t i = 0; i < local.size(); ++i) {
              world[i] = parents[i] < 0 ? local[i] : world[parents[i]] * local[i];
            }
            benchmark::DoNotOptimize(world.data());
            benchmark::ClobberMemory();
          }};
}

template <class S>
std::vector<Contender> all_kinematics(const Rig& rig) {
  return {kinematics<DualQuaternionForm<S>>(rig), kinematics<QuaternionVectorForm<S>>(rig),
          kinematics<Matrix3x4Form<S>>(rig), kinematics<Matrix4x4Form<S>>(rig)};
}

/// The least and the largest ratio of each form to the dual quaternion, over rows.
struct Span {
  double least = 1e9, most = 0.0;
};
using Spans = std::array<Span, 4>;

void time_row(const std::string& what, std::vector<Contender> contenders, bool quick,
              Spans& spans) {
  run_rounds(contenders, quick ? 3 : 101, quick ? 2 : 200);
  fmt::print("  {:<22}", what);
  for (std::size_t c = 0; c < contenders.size(); ++c) {
    fmt::print("  {:>7.2f} ({:4.2f})", contenders[c].ns, contenders[c].ratio);
    spans[c].least = std::min(spans[c].least, contenders[c].ratio);
    spans[c].most = std::max(spans[c].most, contenders[c].ratio);
  }
  fmt::print("\n");
}

template <class S>
void time_rows(const char* scalar, bool quick) {
  std::vector<Contender> chain, batch;
  add_products<DualQuaternionForm<S>>(chain, batch);
  add_products<QuaternionVectorForm<S>>(chain, batch);
  add_products<Matrix3x4Form<S>>(chain, batch);
  add_products<Matrix4x4Form<S>>(chain, batch);
  Spans spans;
  time_row(fmt::format("{}: chain of 64", scalar), std::move(chain), quick, spans);
  time_row(fmt::format("{}: 64 apart", scalar), std::move(batch), quick, spans);
  for (const char* name : {"hand", "biped", "biped-full", "biped-hands", "arm3"}) {
    time_row(fmt::format("{}: {}", scalar, name), all_kinematics<S>(shipped_rig(name)), quick,
             spans);
  }
  fmt::print(
      "  True here, {}: beside a dual quaternion's product a 4x4 matrix's takes {:.2f} to {:.2f} "
      "of\n"
      "  the time, a 3x4 matrix's {:.2f} to {:.2f}, quaternion + vector {:.2f} to {:.2f}.\n",
      scalar, spans[3].least, spans[3].most, spans[2].least, spans[2].most, spans[1].least,
      spans[1].most);
}

}  // namespace

void print_operation_counts() {
  fmt::print(
      "Operations, counted (multiplications + additions); the paper's section 11 beside them\n"
      "  form                 numbers     paper   product     mending\n");
  count_row<DualQuaternionForm<Counted>>(8, "42 + 38");
  count_row<QuaternionVectorForm<Counted>>(7, "-");
  count_row<Matrix3x4Form<Counted>>(12, "48 + 32");
  count_row<Matrix4x4Form<Counted>>(16, "64 + 48");
  fmt::print(
      "  True here: the dual quaternion's direct product takes 48 + 40, not 42 + 38; it beats the\n"
      "  4x4 matrix, not the 3x4 one (36 + 27), and quaternion + vector is cheaper than all.\n"
      "  True here: Gram-Schmidt costs about what normalising a dual quaternion does (and one "
      "more\n"
      "  division and root); quaternion + vector needs less than half.\n\n");
}

void print_times(bool quick) {
  fmt::print(
      "Time per product, ns, and against the dual quaternion in the same round; medians.\n"
      "Paper, section 11: dual quaternions are ten percent faster than matrices (ratio 1.1).\n"
      "  {:<22}{:>16}{:>16}{:>16}{:>16}\n",
      "", "dual quaternion", "quat + vector", "3x4 matrix", "4x4 matrix");
  time_rows<double>("double", quick);
  time_rows<float>("float", quick);
  fmt::print("\n");
}

}  // namespace limber::test
