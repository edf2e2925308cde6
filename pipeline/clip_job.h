#pragma once

#include <string>

#include "importers/importer.h"
#include "pipeline/figure.h"
#include "pipeline/job.h"

namespace limber {

/// What of a source all its clips share.
struct Source {
  std::string path, sha256;
  Imported imported;
  Figure figure;
};

/// The error with the file it is about, where it names none.
Error in_file(Error, const std::string& path);

/// Takes one clip of a source to its files, sheet and report; what fails stands in the report.
ClipSummary run_clip(const Source&, const Clip&, const std::string& stem, const Target&,
                     const JobOptions&);

}  // namespace limber
