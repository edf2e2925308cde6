#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "assets/model/result.h"
#include "pipeline/isolated.h"

namespace limber {

struct BatchTarget {
  std::string path;  ///< a shipped rig's name or a file
  std::string map;   ///< a map file for this target; empty: the job's
};

/// A batch as its job file describes it: format `limber-job/1`,
/// assets/data/schemas/job.schema.json. Paths are relative to the job file's folder.
struct BatchJob {
  std::vector<std::string> sources;  ///< files, folders, patterns (* ? [a-z] **), @lists
  std::vector<BatchTarget> targets;
  std::filesystem::path output;
  std::string map;
  std::string gates;  ///< a gates file, or shipped ones by name; empty: none
  /// The flags of `limber retarget` that apply to every clip, each with its JSON pointer.
  std::vector<std::pair<std::string, std::vector<std::string>>> flags;
  std::string options_text;  ///< the same options in one spelling: part of what results depend on
  IsolationLimits caps;
};

/// Errors: `job-json`, `job-field`; they name the JSON pointer and the way out.
Result<BatchJob> job_from_json(std::string_view text);

/// Which part of a batch a process runs: items number, number + count, ... counted from 1.
struct Shard {
  int number = 1, count = 1;
  bool whole() const { return count == 1; }
};
/// "2/7". Error: `job-shard`.
Result<Shard> parse_shard(const std::string& text);

}  // namespace limber
