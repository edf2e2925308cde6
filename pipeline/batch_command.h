#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "pipeline/job.h"

namespace limber {

struct BatchArgs {
  std::filesystem::path job;
  int processes = 0;  ///< 0: one per core
  std::string shard = "1/1";
  bool resume = false, verify = false, retry_failed = false, dry_run = false;
  std::filesystem::path junit;  ///< write the verdicts here; empty: nowhere
  bool json = false;            ///< events on standard output, one JSON document a line
  /// What flags of `limber retarget` mean.
  std::function<Result<JobOptions>(const std::vector<std::string>& flags)> parse_flags;
};

/// `limber batch`. Returns the program's exit code; the current folder becomes the job's.
int batch_command(const BatchArgs&);

}  // namespace limber
