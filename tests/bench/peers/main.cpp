#include <fmt/format.h>

#include <cstdio>

#include "tests/bench/peers/contest.h"
#include "tests/bench/peers/entries.h"

int main(int argc, char** argv) {
  using namespace limber;
  for (int i = 1; i < argc; ++i) {
    Result<Workload> work = read_workload(argv[i]);
    if (!work) {
      fmt::print(stderr, "{}: {}\n", argv[i], work.error().message);
      return 2;
    }
    auto all = peers::all_contestants(*work);
    const auto scores = peers::hold_contest(*work, all, {});
    const peers::Score& ours = scores.front();
    fmt::print("{}\n", work->name);
    for (const peers::Score& s : scores) {
      if (!s.absent.empty()) {
        fmt::print("{:<30} {}\n", s.name, s.absent);
        continue;
      }
      fmt::print(
          "{:<30} {:5} {} | {:9.2f} {:9.2f} {:9.2f} | x{:7.2f} x{:7.2f} | it {:6.2f} | {:.4f} "
          "{:.4f} "
          "mm {:.4f} {:.4f} deg| {:6.2f} % | viol {} {:.1e} | jerk {:.2f} | {} B\n",
          s.name, s.frames, s.rounds, s.us_median, s.us_mean, s.us_p99,
          s.us_median / ours.us_median, s.us_mean / ours.us_mean, s.iterations_mean,
          s.position_mm_median, s.position_mm_p99, s.orientation_deg_median, s.orientation_deg_p99,
          100 * s.success, s.violations, s.max_violation_deg, s.jerk_ratio, s.heap_bytes);
    }
  }
}
