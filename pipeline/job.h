#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "pipeline/clip_record.h"
#include "pipeline/isolated.h"

namespace limber {

/// How sources are retargeted; what the flags of `limber retarget` say.
struct JobOptions {
  RetargetOptions retarget;
  ImportOptions import;
  ReferenceChoice reference;
  std::optional<std::string> clip;
  std::optional<std::pair<std::int64_t, std::int64_t>>
      range;  ///< frames [first, last], whole clip's
  std::optional<double> rate_hz;
  std::vector<std::string> formats = {"glb", "bvh"};
  std::filesystem::path output;
  std::optional<std::filesystem::path> map;
  SandboxMode sandbox = SandboxMode::automatic;
  IsolationLimits limits = {};  ///< of each clip, where a source holds several
  std::optional<Gates> gates;
};

/// How the target of a job is read: the map's roles, and the reader of the whole program.
Result<TargetOptions> target_options(const JobOptions&);

/// One line of the summary.
struct ClipSummary {
  std::string source, clip, stem;
  Status status = Status::fail;
  std::string code, message;  ///< of the first error, or else of the last warning
  double error_p95_mm = 0.0;
  std::int64_t violations = 0, frames = 0;
  std::string unwritten = {};  ///< why an output could not be written; empty where all were
};

/// Retargets every clip of one source (or the one that is named) and writes files, sheet and report
/// for each. `stem` is the source's part of the output names. A refused source gets a report alone.
/// To be called in a process of the source's own. Of several clips each gets a process too, so that
/// limits hold for a clip, however many there are, and one that dies leaves the others standing.
std::vector<ClipSummary> run_source(const std::string& source_path, const std::string& stem,
                                    const Target&, const JobOptions&);

/// The same for a source whose process died: a report that says so.
ClipSummary record_death(const std::string& source_path, const std::string& stem,
                         const std::string& target_label, const Error&, const JobOptions&);

std::string to_json(const std::vector<ClipSummary>&);
std::vector<ClipSummary> summaries_from_json(const std::string&);

}  // namespace limber
