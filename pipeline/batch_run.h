#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "pipeline/batch_job.h"
#include "pipeline/batch_plan.h"
#include "pipeline/batch_record.h"
#include "pipeline/output_tree.h"
#include "pipeline/process_pool.h"

namespace limber {

/// What a batch does with its items.
struct BatchWork {
  /// Everything that decides an item's outputs besides its inputs' contents and its name.
  std::function<std::string(std::size_t item)> recipe;
  /// Files that every run of the item reads, its source first.
  std::function<std::vector<std::string>(std::size_t item)> inputs;
  /// In a process of its own: writes the item's outputs into `folder`, under names that start with
  /// its source's stem, and tells in `read` what else it read, or looked for. At least one summary.
  std::function<std::vector<ClipSummary>(std::size_t item, const std::filesystem::path& folder,
                                         std::vector<std::string>& read)>
      run;
  /// In the parent: the outputs of an item whose process died.
  std::function<ClipSummary(std::size_t item, const std::filesystem::path& folder, const Error&)>
      bury;
};

struct BatchOptions {
  Shard shard;
  bool resume = false;        ///< leave out what is finished and would come out the same
  bool verify = false;        ///< then trust no size and time, but read everything again
  bool retry_failed = false;  ///< then run failed items again
  ProcessPool::Options pool;
};

/// How a batch went, counted in clips; finished ones of earlier runs included.
struct BatchOutcome {
  std::int64_t passed = 0, warned = 0, failed = 0;
  std::int64_t gates_missed = 0;  ///< of the failed, those that nothing but a gate fails
  std::int64_t items = 0, resumed = 0, left = 0;  ///< of this shard; found finished; not run
  std::vector<ClipSummary> worst;                 ///< a few, worst first; stems with their folders
  bool interrupted = false;
  std::optional<Error> stopped;  ///< the output folder failed; a resume goes on from here
};

/// Told of events as they come; each may be empty.
struct BatchObserver {
  std::function<void(std::size_t items, std::size_t resumed)> started;
  std::function<void(const BatchRecord&)> finished;
  /// Every clip that the outcome counts, its stem with its folder; in no certain order.
  std::function<void(const ClipSummary&)> counted;
  std::function<void(const std::string& item, const Error&)> retried;
  std::function<void(std::size_t running)> draining;
};

/// Runs every item of the shard that is not finished. A failed item costs itself alone: a crash is
/// tried once more, then the item is recorded as failed with the reason. One interrupt (SIGINT,
/// SIGTERM, SIGHUP) lets running items finish, a second one ends them; either way nothing is lost
/// that was finished. Call from a single-threaded process.
BatchOutcome run_batch(const BatchPlan&, const BatchWork&, OutputTree&, const BatchOptions&,
                       const BatchObserver& = {});

}  // namespace limber
