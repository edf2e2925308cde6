// Time per frame of the hard workload, with rows and by the tree alone, in interleaved rounds.
#include <fmt/format.h>

#include <algorithm>
#include <vector>

#include "tests/bench/hard_workload.h"
#include "tests/solver/test_rigs.h"

namespace limber::test {
namespace {

template <class T>
double percentile(std::vector<T> values, double p) {
  std::sort(values.begin(), values.end());
  const auto i = static_cast<std::size_t>(p * static_cast<double>(values.size()));
  return static_cast<double>(values[std::min(i, values.size() - 1)]);
}

void print(const char* name, const HardRun& run, const std::vector<double>& us) {
  std::vector<int> relinearisations, passes, sweeps, active;
  double violation = 0.0;
  for (const IkReport& report : run.reports) {
    relinearisations.push_back(report.relinearisations);
    passes.push_back(report.tree_passes);
    sweeps.push_back(report.sweeps);
    active.push_back(report.active_rows);
    violation = std::max(violation, report.row_violation);
  }
  fmt::print(
      "{:10} {:8.1f} us median {:8.1f} us p99 | relinearisations {:3} / {:3}, tree passes "
      "{:4} / {:4}, sweeps {:4} / {:4} (median / max) | pressing rows {} to {} | worst row "
      "{:.2g}\n",
      name, percentile(us, 0.5), percentile(us, 0.99), percentile(relinearisations, 0.5),
      percentile(relinearisations, 1.0), percentile(passes, 0.5), percentile(passes, 1.0),
      percentile(sweeps, 0.5), percentile(sweeps, 1.0), percentile(active, 0.0),
      percentile(active, 1.0), violation);
}

int run(std::int64_t frames, int rounds) {
  const HardWorkload work = make_hard_workload(shipped_rig("biped-hands"), frames);
  HardRun rows, tree;
  std::vector<double> rows_us, tree_us;
  for (int round = 0; round < rounds; ++round) {
    rows = run_hard_workload(work, true);
    tree = run_hard_workload(work, false);
    rows_us.insert(rows_us.end(), rows.us.begin(), rows.us.end());
    tree_us.insert(tree_us.end(), tree.us.begin(), tree.us.end());
  }
  fmt::print("hard workload: biped-hands, {} frames, {} rounds\n", frames, rounds);
  print("with rows", rows, rows_us);
  print("tree only", tree, tree_us);
  fmt::print("ratio of the medians {:.2f}\n", percentile(rows_us, 0.5) / percentile(tree_us, 0.5));
  return 0;
}

}  // namespace
}  // namespace limber::test

int main(int argc, char** argv) {
  return limber::test::run(argc > 1 ? std::stol(argv[1]) : 600, argc > 2 ? std::stoi(argv[2]) : 3);
}
