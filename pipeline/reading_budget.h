#pragma once

#include <cstdint>
#include <filesystem>

#include "importers/importer.h"

namespace limber {

/// While it lives the process has a budget of CPU time and memory for reading one file, which grows
/// with the file's size in bytes: hostile files of few bytes ask for hours and gigabytes. Beyond it
/// an allocation fails, or SIGXCPU ends the process. The process's own limits come back at the end.
class ReadingBudget {
 public:
  explicit ReadingBudget(std::uint64_t file_bytes);
  ~ReadingBudget();
  ReadingBudget(const ReadingBudget&) = delete;
  ReadingBudget& operator=(const ReadingBudget&) = delete;

 private:
  std::uint64_t cpu_seconds_, memory_bytes_;  ///< the limits to come back
};

/// `import_file` within its budget. Call from a process that may die (see isolated.h).
Result<Imported> import_within_budget(const std::filesystem::path&, const ImportOptions& = {});

}  // namespace limber
