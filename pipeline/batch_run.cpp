#include "pipeline/batch_run.h"

#include <fmt/format.h>
#include <sys/stat.h>

#include <algorithm>
#include <deque>
#include <map>
#include <system_error>
#include <unordered_map>

#include "pipeline/interrupts.h"
#include "pipeline/progress.h"

namespace limber {
namespace {

namespace fs = std::filesystem;

constexpr int kAttempts = 2;
constexpr std::size_t kWorstShown = 8;

/// What stands in an item's folder, reports last.
std::vector<FileStamp> files_in(const fs::path& folder) {
  std::vector<FileStamp> files;
  std::error_code ignored;
  for (const auto& entry : fs::directory_iterator(folder, ignored)) {
    FileStamp stamp = stamp_file(entry.path().string());
    stamp.path = entry.path().filename().string();
    files.push_back(std::move(stamp));
  }
  const auto is_report = [](const FileStamp& f) { return f.path.ends_with(".report.json"); };
  std::sort(files.begin(), files.end(), [&](const FileStamp& a, const FileStamp& b) {
    return is_report(a) != is_report(b) ? is_report(b) : a.path < b.path;
  });
  return files;
}

/// In the item's process.
std::string run_item(const BatchWork& work, std::size_t item, const fs::path& folder) {
  BatchRecord record;
  for (const std::string& path : work.inputs(item)) record.inputs.push_back(stamp_file(path));
  std::vector<std::string> read;
  record.clips = work.run(item, folder, read);
  for (const std::string& path : read) {
    const bool known = std::any_of(record.inputs.begin(), record.inputs.end(),
                                   [&](const FileStamp& s) { return s.path == path; });
    if (!known) record.inputs.push_back(stamp_file(path));
  }
  record.files = files_in(folder);
  return to_json_line(record);
}

class BatchRun {
 public:
  BatchRun(const BatchPlan& plan, const BatchWork& work, OutputTree& tree,
           const BatchOptions& options, const BatchObserver& observer)
      : plan_(plan),
        work_(work),
        tree_(tree),
        options_(options),
        observer_(observer),
        pool_(options.pool) {}

  BatchOutcome run() {
    list_items();
    if (auto r = look_back(); !r) return stopped_by(r.error());
    if (observer_.started) {
      observer_.started(static_cast<std::size_t>(out_.items),
                        static_cast<std::size_t>(out_.resumed));
    }
    for (;;) {
      start_some();
      if (pool_.idle()) break;
      if (auto ended = pool_.wait(interrupts_.while_waiting())) {
        settle(*ended);
      } else {
        heed_interrupt();
      }
    }
    if (auto r = tree_.sync(); !r && !out_.stopped) out_.stopped = r.error();
    out_.left = out_.items - out_.resumed - settled_;
    out_.interrupted = interrupts_.count() > 0 && out_.left > 0;
    return std::move(out_);
  }

 private:
  enum class State : std::uint8_t { elsewhere, open, finished };

  void list_items() {
    states_.assign(plan_.size(), State::elsewhere);
    const Shard& shard = options_.shard;
    for (std::size_t i = static_cast<std::size_t>(shard.number - 1); i < plan_.size();
         i += static_cast<std::size_t>(shard.count)) {
      states_[i] = State::open;
      index_.emplace(plan_.name(i), i);
      ++out_.items;
    }
  }

  Result<void> look_back() {
    auto r = tree_.look_back([&](BatchRecord record) {
      const auto found = index_.find(record.item);
      if (found == index_.end()) return;
      const std::size_t item = found->second;
      if (states_[item] == State::finished) forget(item);
      if (options_.resume && is_finished(record, item)) {
        states_[item] = State::finished;
        finished_clips_[item] = std::move(record.clips);
        earlier_files_.erase(item);
        return;
      }
      auto& files = earlier_files_[item];
      files.clear();
      for (FileStamp& file : record.files) files.push_back(std::move(file.path));
    });
    index_.clear();
    for (const auto& [item, clips] : finished_clips_) {
      ++out_.resumed;
      for (const ClipSummary& clip : clips) count(clip, item);
    }
    finished_clips_.clear();
    return r;
  }

  /// A later record of the item is the one that counts.
  void forget(std::size_t item) {
    states_[item] = State::open;
    finished_clips_.erase(item);
  }

  bool is_finished(const BatchRecord& record, std::size_t item) {
    if (record.recipe != recipe_of(item)) return false;
    if (options_.retry_failed &&
        std::any_of(record.clips.begin(), record.clips.end(),
                    [](const ClipSummary& c) { return c.status == Status::fail; })) {
      return false;
    }
    return are_unchanged(record.inputs) && tree_.holds(record, options_.verify);
  }

  /// Targets and maps are inputs of thousands of items: what comes after the source is looked at
  /// once.
  bool are_unchanged(const std::vector<FileStamp>& inputs) {
    for (const FileStamp& stamp : inputs) {
      if (&stamp == &inputs.front()) {
        if (!unchanged(stamp, options_.verify)) return false;
        continue;
      }
      const std::string key =
          fmt::format("{}\n{}\n{}\n{}", stamp.path, stamp.bytes, stamp.mtime_ns, stamp.hash);
      const auto [known, fresh] = looked_at_.try_emplace(key, false);
      if (fresh) known->second = unchanged(stamp, options_.verify);
      if (!known->second) return false;
    }
    return true;
  }

  std::string recipe_of(std::size_t item) const {
    return content_hash(work_.recipe(item) + "\n" + plan_.name(item));
  }

  void start_some() {
    while (!pool_.full() && !out_.stopped && interrupts_.count() == 0) {
      const auto item = next_item();
      if (!item) return;
      if (start(*item)) continue;
      again_.push_front(*item);
      return;
    }
  }

  std::optional<std::size_t> next_item() {
    if (!again_.empty()) {
      const std::size_t item = again_.front();
      again_.pop_front();
      return item;
    }
    while (next_ < states_.size() && states_[next_] != State::open) ++next_;
    if (next_ == states_.size()) return std::nullopt;
    return next_++;
  }

  /// False where the system has no process to give just now.
  bool start(std::size_t item) {
    auto folder = tree_.stage();
    if (!folder) {
      out_.stopped = folder.error();
      return false;
    }
    JailRules may{.reads = {}, .writes = {*folder}, .may_fork = true};
    for (const std::string& path : work_.inputs(item)) may.reads.emplace_back(path);
    auto r = pool_.start(
        item, [&] { return run_item(work_, item, *folder); }, may);
    if (r) {
      folders_[item] = std::move(*folder);
      return true;
    }
    tree_.discard(*folder);
    if (pool_.idle()) out_.stopped = r.error();
    return false;
  }

  void heed_interrupt() {
    if (interrupts_.count() > 1) {
      pool_.kill_all();
      for (const auto& [item, folder] : folders_) tree_.discard(folder);
      folders_.clear();
    } else if (observer_.draining) {
      observer_.draining(folders_.size());
    }
  }

  void settle(ProcessPool::Ended& ended) {
    const std::size_t item = ended.task;
    const fs::path folder = std::move(folders_[item]);
    folders_.erase(item);
    const int attempts = ++attempts_[item];
    auto record = read_answer(ended, item, folder);
    if (!record && attempts < kAttempts && worth_another_try(record.error())) {
      if (observer_.retried) observer_.retried(plan_.name(item), record.error());
      tree_.discard(folder);
      again_.push_back(item);
      return;
    }
    if (!record) record = bury(item, folder, record.error());
    if (!record) return give_up(folder, record.error());
    attempts_.erase(item);
    record->attempts = attempts;
    record->seconds = ended.seconds;
    finish(item, std::move(*record), folder);
  }

  /// The record as the child tells it. It is believed about its own folder only where that is true.
  Result<BatchRecord> read_answer(const ProcessPool::Ended& ended, std::size_t item,
                                  const fs::path& folder) const {
    if (!ended.answer) return ended.answer.error();
    const Error confused{.code = "process-failed",
                         .message = "the clip's process gave no usable answer",
                         .hint = "please report this file"};
    auto record = record_from_json(*ended.answer);
    if (!record) return confused;
    for (const FileStamp& file : record->files) {
      struct stat info {};
      const bool plain = file.path.find('/') == std::string::npos &&
                         file.path.starts_with(plan_.source(item).stem);
      if (!plain || ::lstat((folder / file.path).c_str(), &info) != 0 || !S_ISREG(info.st_mode) ||
          info.st_size != file.bytes) {
        return confused;
      }
    }
    return std::move(*record);
  }

  Result<BatchRecord> bury(std::size_t item, fs::path folder, const Error& error) {
    if (error.code == "sandbox-unavailable") return error;
    std::error_code failed;
    for (const auto& entry : fs::directory_iterator(folder, failed)) {
      fs::remove_all(entry.path(), failed);  // what the dead process had made so far
    }
    BatchRecord record;
    for (const std::string& path : work_.inputs(item)) record.inputs.push_back(stamp_file(path));
    record.clips = {work_.bury(item, folder, error)};
    record.files = files_in(folder);
    return record;
  }

  void finish(std::size_t item, BatchRecord record, const fs::path& folder) {
    for (const ClipSummary& clip : record.clips) {
      if (clip.unwritten.empty()) continue;
      return give_up(folder, {.code = "output-unwritable",
                              .message = clip.unwritten,
                              .file = plan_.name(item),
                              .hint = "make space or mend the folder, then go on with --resume"});
    }
    record.item = plan_.name(item);
    record.recipe = recipe_of(item);
    for (FileStamp& file : record.files) file.path = plan_.source(item).folder + file.path;
    record.removes = no_longer_made(item, record);
    if (auto r = tree_.commit(record, folder); !r) {
      if (!out_.stopped) out_.stopped = r.error();
      return;  // the next run settles whether it was committed
    }
    ++settled_;
    for (const ClipSummary& clip : record.clips) count(clip, item);
    if (observer_.finished) observer_.finished(record);
  }

  std::vector<std::string> no_longer_made(std::size_t item, const BatchRecord& record) {
    std::vector<std::string> out;
    const auto earlier = earlier_files_.find(item);
    if (earlier == earlier_files_.end()) return out;
    for (std::string& path : earlier->second) {
      const bool made = std::any_of(record.files.begin(), record.files.end(),
                                    [&](const FileStamp& f) { return f.path == path; });
      if (!made) out.push_back(std::move(path));
    }
    earlier_files_.erase(earlier);
    return out;
  }

  void give_up(const fs::path& folder, const Error& error) {
    tree_.discard(folder);
    if (!out_.stopped) out_.stopped = error;
  }

  BatchOutcome stopped_by(const Error& error) {
    out_.stopped = error;
    out_.left = out_.items - out_.resumed;
    return std::move(out_);
  }

  void count(const ClipSummary& clip, std::size_t item) {
    (clip.status == Status::pass   ? out_.passed
     : clip.status == Status::warn ? out_.warned
                                   : out_.failed) += 1;
    out_.gates_missed += clip.status == Status::fail && clip.code == "gate-missed";
    ClipSummary shown = clip;
    shown.stem = plan_.source(item).folder + clip.stem;
    if (observer_.counted) observer_.counted(shown);
    auto& worst = out_.worst;
    worst.insert(std::upper_bound(worst.begin(), worst.end(), shown, is_worse), shown);
    if (worst.size() > kWorstShown) worst.pop_back();
  }

  const BatchPlan& plan_;
  const BatchWork& work_;
  OutputTree& tree_;
  const BatchOptions& options_;
  const BatchObserver& observer_;
  Interrupts interrupts_;
  ProcessPool pool_;
  BatchOutcome out_;
  std::vector<State> states_;
  std::unordered_map<std::string, std::size_t> index_;  // of the shard's items, by name
  std::map<std::size_t, std::vector<ClipSummary>> finished_clips_;
  std::unordered_map<std::string, bool> looked_at_;
  std::unordered_map<std::size_t, std::vector<std::string>> earlier_files_;
  std::unordered_map<std::size_t, fs::path> folders_;  // of running items
  std::unordered_map<std::size_t, int> attempts_;      // of items that crashed
  std::deque<std::size_t> again_;
  std::size_t next_ = 0;
  std::int64_t settled_ = 0;
};

}  // namespace

BatchOutcome run_batch(const BatchPlan& plan, const BatchWork& work, OutputTree& tree,
                       const BatchOptions& options, const BatchObserver& observer) {
  return BatchRun(plan, work, tree, options, observer).run();
}

}  // namespace limber
