#pragma once

#include <string>
#include <vector>

#include "assets/model/result.h"
#include "tests/bench/peers/contest.h"

namespace limber::peers {

/// One workload and everybody's scores on it; ours come first.
struct Chapter {
  std::string workload;
  std::vector<Score> scores;
};

/// An aligned table per workload under one head that says what was asked of whom.
std::string text_report(const std::vector<Chapter>&, const ContestOptions&);
/// The same figures as one JSON document, format `peers/1`.
std::string json_report(const std::vector<Chapter>&, const ContestOptions&);

/// A PNG with a panel per workload: mean time per frame (logarithmic) against the share of frames
/// that were solved, one mark per contestant.
std::vector<unsigned char> plot_report(const std::vector<Chapter>&);

}  // namespace limber::peers
