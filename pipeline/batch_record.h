#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "pipeline/content_hash.h"
#include "pipeline/job.h"

namespace limber {

/// A finished item of a batch: what it was made from, what was made, what came of it. One line of
/// a journal; the line is the commit (see OutputTree).
struct BatchRecord {
  std::string item;    ///< BatchPlan::name
  std::string recipe;  ///< hash of everything that decides the outputs besides the inputs' contents
  std::string staged;  ///< the folder in which its outputs waited
  std::vector<FileStamp> inputs;
  std::vector<FileStamp> files;      ///< paths below the output folder, reports last; without times
  std::vector<std::string> removes;  ///< outputs of an earlier run that this one no longer makes
  std::vector<ClipSummary> clips;
  int attempts = 1;
  double seconds = 0.0;  ///< wall time of the last attempt
};

std::string to_json_line(const BatchRecord&);
std::optional<BatchRecord> record_from_json(std::string_view line);

/// An append-only file of records. A line that a killed writer left half-written is passed over.
class Journal {
 public:
  Journal() = default;
  ~Journal();
  Journal(Journal&&) noexcept;
  Journal& operator=(Journal&&) noexcept;

  /// Creates the file where there is none. Error: `output-unwritable`.
  static Result<Journal> open(const std::filesystem::path&);

  /// The line is on disk when this returns. Where it fails, the file is as before, or, on a broken
  /// disk, ends in a line that may or may not count; `output-unwritable`.
  Result<void> append(const BatchRecord&);

 private:
  std::filesystem::path path_;
  int fd_ = -1;
};

/// Calls for every record of a file, in order. A file that is not there holds none.
void read_journal(const std::filesystem::path&, const std::function<void(BatchRecord)>&);

}  // namespace limber
