#include "tests/bench/peers/report.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <numeric>

#include "validation/contact_detection.h"

namespace limber::peers {

namespace {

/// How much longer a contestant takes than ours, over the frames that both have solved.
struct Ratios {
  double mean = 0.0, median = 0.0;
};

Ratios ratios(const Score& score, const Score& ours) {
  const auto frames = static_cast<std::ptrdiff_t>(std::min(score.us.size(), ours.us.size()));
  const std::vector<double> a(score.us.begin(), score.us.begin() + frames);
  const std::vector<double> b(ours.us.begin(), ours.us.begin() + frames);
  return {std::accumulate(a.begin(), a.end(), 0.0) / std::accumulate(b.begin(), b.end(), 0.0),
          percentile(a, 50.0) / percentile(b, 50.0)};
}

/// Ours with the same start, else ours.
const Score& ours_from_same_start(const std::vector<Score>& scores, const Score& score) {
  for (const Score& other : scores) {
    if (other.ours && other.start == score.start && other.absent.empty()) return other;
  }
  return scores.front();
}

std::string row(const Score& s, const std::vector<Score>& scores) {
  const Ratios best = ratios(s, scores.front());
  const Ratios same = ratios(s, ours_from_same_start(scores, s));
  return fmt::format(
      "{:<39}{:>6}{:>3}{:>11.2f}{:>11.2f}{:>11.2f}{:>9.2f}{:>9.2f}{:>9.2f}{:>8.2f}{:>9.4f}{:>9.3f}"
      "{:>9.4f}{:>9.3f}{:>8.2f}{:>6}{:>9.1e}{:>8.2f}{:>9.1f}\n",
      s.name, s.frames, s.rounds, s.us_median, s.us_mean, s.us_p99, best.median, best.mean,
      same.mean, s.iterations_mean, s.position_mm_median, s.position_mm_p99,
      s.orientation_deg_median, s.orientation_deg_p99, 100.0 * s.success, s.violations,
      s.max_violation_deg, s.jerk_ratio, 1e-3 * static_cast<double>(s.heap_bytes));
}

std::string head(const ContestOptions& options) {
  return fmt::format(
      "Joint-limited inverse kinematics, one core, {} rounds in turns, a frame's time its median\n"
      "over the rounds. Everybody stops where every strong effector is within the workload's stop\n"
      "tolerance, and is built with the same compiler flags. A motion\n"
      "starts from its first frame's truth, then from the extrapolated last solutions (or, where\n"
      "the name says so, the last one); a lone pose starts at rest. Who would take longer than\n"
      "{:g} s for a workload solves fewer rounds, then only its first frames, and ratios are over\n"
      "the frames that both have solved.\n"
      "  us        time per frame: median, mean and 99th percentile over the frames\n"
      "  / ours    median and mean beside ours; `same` is the mean beside ours from the same "
      "start\n"
      "  iter      mean linearisations, sweeps or passes per frame, all starts together\n"
      "  mm, deg   the worst strong effector's miss: median and 99th percentile\n"
      "  solved    share of frames within the success tolerances and within limits\n"
      "  viol      joint-frames more than 1e-4 rad beyond a limit; then the largest excess in "
      "degrees\n"
      "  jerk      largest second difference of any joint's path over the true motion's\n"
      "  kB        heap held after preparing and solving one frame\n",
      options.rounds, options.budget_s);
}

nlohmann::ordered_json to_json(const Score& s, const std::vector<Score>& scores) {
  nlohmann::ordered_json out = {{"solver", s.name}, {"setting", s.setting}};
  if (!s.absent.empty()) {
    out["absent"] = s.absent;
    return out;
  }
  const Ratios best = ratios(s, scores.front());
  const Ratios same = ratios(s, ours_from_same_start(scores, s));
  out["start"] = s.start == Start::extrapolated ? "extrapolate" : "previous";
  out["frames"] = s.frames;
  out["rounds"] = s.rounds;
  out["us"] = {{"median", s.us_median}, {"mean", s.us_mean}, {"p99", s.us_p99}};
  out["over_ours"] = {{"median", best.median}, {"mean", best.mean}};
  out["over_ours_same_start"] = {{"median", same.median}, {"mean", same.mean}};
  out["iterations_mean"] = s.iterations_mean;
  out["position_error_mm"] = {{"median", s.position_mm_median}, {"p99", s.position_mm_p99}};
  out["orientation_error_deg"] = {{"median", s.orientation_deg_median},
                                  {"p99", s.orientation_deg_p99}};
  out["success_rate"] = s.success;
  out["limit_violations"] = s.violations;
  out["max_violation_deg"] = s.max_violation_deg;
  out["jerk_ratio"] = s.jerk_ratio;
  out["heap_bytes"] = s.heap_bytes;
  return out;
}

}  // namespace

std::string text_report(const std::vector<Chapter>& chapters, const ContestOptions& options) {
  std::string text = head(options);
  if (!chapters.empty()) {
    text += "Settings:\n";
    for (const Score& s : chapters.front().scores) {
      text += fmt::format("  {:<41}{}\n", s.name, s.setting);
    }
  }
  for (const Chapter& chapter : chapters) {
    text += fmt::format(
        "\n{}\n{:<39}{:>6}{:>3}{:>11}{:>11}{:>11}{:>9}{:>9}{:>9}{:>8}{:>9}{:>9}"
        "{:>9}{:>9}{:>8}{:>6}{:>9}{:>8}{:>9}\n",
        chapter.workload, "solver", "frames", "x", "us median", "us mean", "us p99", "/ours",
        "mean", "same", "iter", "mm", "p99", "deg", "p99", "solved", "viol", "deg", "jerk", "kB");
    for (const Score& s : chapter.scores) {
      text +=
          s.absent.empty() ? row(s, chapter.scores) : fmt::format("{:<39}{}\n", s.name, s.absent);
    }
  }
  return text;
}

std::string json_report(const std::vector<Chapter>& chapters, const ContestOptions& options) {
  nlohmann::ordered_json document = {{"format", "peers/1"},
                                     {"rounds", options.rounds},
                                     {"budget_s", options.budget_s},
                                     {"workloads", nlohmann::ordered_json::array()}};
  for (const Chapter& chapter : chapters) {
    nlohmann::ordered_json scores = nlohmann::ordered_json::array();
    for (const Score& s : chapter.scores) scores.push_back(to_json(s, chapter.scores));
    document["workloads"].push_back({{"workload", chapter.workload}, {"solvers", scores}});
  }
  return document.dump(2) + "\n";
}

}  // namespace limber::peers
