#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "pipeline/job.h"

namespace limber {

/// How far a run is, on standard error: one line that is rewritten on a terminal, a line for each
/// step elsewhere. Without colours, so that NO_COLOR holds.
class Progress {
 public:
  /// `before` of the steps were done by earlier runs; they have no part in the remaining time.
  explicit Progress(std::size_t total, std::size_t before = 0);

  /// One step, which gave these clips; `folder` goes before their names.
  void add(const std::vector<ClipSummary>&, const std::string& folder = "");
  /// A line that stays.
  void say(const std::string& line);
  /// Leaves the terminal's line empty.
  void close() const;

 private:
  void show(const std::string& last) const;

  std::size_t total_, before_, done_;
  std::int64_t failed_ = 0, warned_ = 0;
  bool terminal_;
  std::chrono::steady_clock::time_point start_;
};

/// The order of a summary: failed, warned, then by error.
bool is_worse(const ClipSummary&, const ClipSummary&);

/// "  fail walk@hero  120 frames, error p95  12.0 mm  code: message".
std::string summary_line(const ClipSummary&);

}  // namespace limber
