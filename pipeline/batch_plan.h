#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "assets/model/result.h"
#include "pipeline/batch_job.h"

namespace limber {

/// One file of a batch, and where its outputs go.
struct BatchSource {
  std::string path;    ///< as reports name it
  std::string folder;  ///< of its outputs, below the output folder; "" or "a/b/"
  std::string stem;    ///< its part of the output names
};

/// Every source onto every target. Item k is source k / T onto target k % T.
struct BatchPlan {
  std::vector<BatchSource> sources;
  std::vector<std::string> labels;  ///< of the targets, as output names carry them

  std::size_t size() const { return sources.size() * labels.size(); }
  const BatchSource& source(std::size_t item) const { return sources[item / labels.size()]; }
  std::size_t target(std::size_t item) const { return item % labels.size(); }
  /// "walk@hero": outputs of the item start with it, or with "walk#CLIP@hero".
  std::string stem(std::size_t item) const {
    return source(item).stem + "@" + labels[target(item)];
  }
  /// The same with the folder; no two items share it, whatever the file system thinks of case and
  /// of Unicode's normal forms.
  std::string name(std::size_t item) const { return source(item).folder + stem(item); }
};

/// Expands what a job asks for, below the current folder. A pattern keeps the folders below its
/// fixed part; a folder stands for every readable file in it; "@list.txt" for the paths in it, a
/// line each. The output folder and hidden files are passed over. Order: that of the job, then by
/// name. Errors: `job-no-sources`, `output-collision`, and those of reading a list.
Result<BatchPlan> plan_batch(const BatchJob&, std::vector<std::string> labels);

}  // namespace limber
