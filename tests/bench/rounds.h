#pragma once

#include <algorithm>
#include <chrono>
#include <functional>
#include <string>
#include <vector>

namespace limber::test {

/// Something to be timed: `work` does `items` of it per call.
struct Contender {
  std::string name;
  double items = 1.0;
  std::function<void()> work;
  double ns = 0.0;     ///< out: median per item
  double ratio = 0.0;  ///< out: median over rounds of its time over the first contender's
};

inline double median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
  return values[values.size() / 2];
}

/// Runs all contenders in turn, round after round, so that whatever slows the machine slows all of
/// them; ratios are taken within a round.
inline void run_rounds(std::vector<Contender>& contenders, int rounds, int calls) {
  std::vector<std::vector<double>> ns(contenders.size()), ratio(contenders.size());
  for (int round = 0; round < rounds; ++round) {
    for (std::size_t c = 0; c < contenders.size(); ++c) {
      const auto start = std::chrono::steady_clock::now();
      for (int k = 0; k < calls; ++k) contenders[c].work();
      const std::chrono::duration<double, std::nano> spent =
          std::chrono::steady_clock::now() - start;
      ns[c].push_back(spent.count() / (calls * contenders[c].items));
      ratio[c].push_back(ns[c].back() / ns[0].back());
    }
  }
  for (std::size_t c = 0; c < contenders.size(); ++c) {
    contenders[c].ns = median(ns[c]);
    contenders[c].ratio = median(ratio[c]);
  }
}

}  // namespace limber::test
