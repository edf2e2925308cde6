#pragma once

#include <filesystem>
#include <functional>
#include <set>
#include <string>

#include "pipeline/batch_job.h"
#include "pipeline/batch_record.h"

namespace limber {

/// A batch's output folder. Finished outputs stand at their places; what belongs to the run lives
/// in `.limber/` inside: a lock, a journal of records per shard, and a folder per running item.
///
/// An item's process writes into its own folder. Once it is done, its record is appended to the
/// journal and synced: that is the commit. Then its files are renamed to their places, the reports
/// last. Killed before the commit, the item counts as never run and its folder is removed; killed
/// after it, the renames are finished by the next run. So nothing half-written is ever seen at an
/// output's place, and an output that is seen there is not made again.
class OutputTree {
 public:
  /// Creates the folder and takes its lock: one run at a time, or any number of different shards.
  /// Waits a little for processes of a killed run to end. Errors: `output-unwritable`,
  /// `output-busy`.
  static Result<OutputTree> open(const std::filesystem::path&, const Shard&);
  ~OutputTree();
  OutputTree(OutputTree&&) noexcept;
  OutputTree& operator=(OutputTree&&) = delete;

  /// Finishes what a killed run of this shard left, then calls for every record of every run.
  /// To be called once, before anything is staged.
  Result<void> look_back(const std::function<void(BatchRecord)>&);

  /// Whether the outputs of a record are in place: their sizes, and with `rehash` their contents.
  bool holds(const BatchRecord&, bool rehash) const;

  /// An empty folder for the outputs of one item.
  Result<std::filesystem::path> stage();
  void discard(const std::filesystem::path& staged);

  /// Takes the files of a staged folder for good. The record's files name them: places below the
  /// output folder, whose last parts are the names in the staged folder.
  Result<void> commit(BatchRecord, const std::filesystem::path& staged);

  /// Makes the renames last, also through a loss of power.
  Result<void> sync();

 private:
  OutputTree() = default;
  Result<void> move_into_place(const BatchRecord&);

  std::filesystem::path output_, own_;  // own_: output_/.limber
  std::string run_;                     // prefix of staged folders: shard and run
  Shard shard_;
  int lock_ = -1, shard_lock_ = -1;
  std::uint64_t staged_ = 0;
  Journal journal_;
  std::set<std::filesystem::path> touched_;
};

}  // namespace limber
