#include "pipeline/batch_command.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <system_error>

#include "pipeline/batch_run.h"
#include "pipeline/commands.h"
#include "pipeline/file_io.h"
#include "pipeline/junit.h"
#include "pipeline/progress.h"
#include "pipeline/target_check.h"
#include "pipeline/version.h"

namespace limber {
namespace {

namespace fs = std::filesystem;
using json = nlohmann::ordered_json;

void print_event(const json& event) {
  fmt::print("{}\n", event.dump(-1, ' ', false, json::error_handler_t::replace));
  std::fflush(stdout);
}

/// The options of a job, read as the flags they are; an error names the option.
Result<JobOptions> options_of(const BatchJob& job, const BatchArgs& args) {
  std::vector<std::string> all;
  for (const auto& [pointer, flags] : job.flags) {
    if (auto alone = args.parse_flags(flags); !alone) {
      Error error = alone.error();
      error.message = fmt::format("at {}: {}", pointer, error.message);
      return error;
    }
    all.insert(all.end(), flags.begin(), flags.end());
  }
  return args.parse_flags(all);
}

/// A batch that has been read and expanded; nothing has been run or written.
struct Prepared {
  BatchJob job;
  JobOptions options;
  BatchPlan plan;
  Shard shard;
};

Result<Prepared> prepare(const BatchArgs& args) {
  Prepared out;
  const auto shard = parse_shard(args.shard);
  if (!shard) return shard.error();
  out.shard = *shard;
  const auto in_job = [&](Error error) {
    if (error.file.empty()) error.file = args.job.string();
    return error;
  };
  const auto text = read_text(args.job);
  if (!text) return in_job(text.error());
  auto job = job_from_json(*text);
  if (!job) return in_job(job.error());
  out.job = std::move(*job);
  auto options = options_of(out.job, args);
  if (!options) return in_job(options.error());
  out.options = std::move(*options);
  // From here on, paths are those of the job: a moved folder gives the same reports.
  std::error_code error;
  if (args.job.has_parent_path()) fs::current_path(args.job.parent_path(), error);
  if (error) return in_job({.code = "file-unreadable", .message = error.message()});
  if (!out.job.gates.empty()) {
    auto gates = load_gates(out.job.gates);
    if (!gates) return in_job(gates.error());
    out.options.gates = std::move(*gates);
  }
  std::vector<std::string> labels;
  for (const BatchTarget& target : out.job.targets) {
    labels.push_back(safe_name(label_of(target.path)));
  }
  auto plan = plan_batch(out.job, std::move(labels));
  if (!plan) return in_job(plan.error());
  out.plan = std::move(*plan);
  return out;
}

/// What a target's clips are made with.
JobOptions options_for(const Prepared& batch, const BatchTarget& target) {
  JobOptions options = batch.options;
  const std::string& map = target.map.empty() ? batch.job.map : target.map;
  if (!map.empty()) options.map = map;
  return options;
}

Result<void> check_targets(const Prepared& batch) {
  for (const BatchTarget& target : batch.job.targets) {
    const auto label = check_target(target.path, options_for(batch, target));
    if (!label) return label.error();
  }
  return {};
}

/// A clip from its source to its report, in a process of its own. The target is read anew by each,
/// so that no parsed file is shared.
std::vector<ClipSummary> run_one(const Prepared& batch, std::size_t item, const fs::path& folder,
                                 std::vector<std::string>& read) {
  const BatchSource& source = batch.plan.source(item);
  const BatchTarget& aim = batch.job.targets[batch.plan.target(item)];
  JobOptions options = options_for(batch, aim);
  options.output = folder;
  options.limits = batch.job.caps;
  options.import.on_reference = [&](const fs::path& path) { read.push_back(path.string()); };
  auto target_import = target_options(options);
  if (target_import) target_import->import.on_reference = options.import.on_reference;
  const auto target =
      target_import ? load_target(aim.path, *target_import) : Result<Target>(target_import.error());
  if (target) {
    auto clips = run_source(source.path, source.stem, *target, options);
    remove_temporaries(folder);  // of clips whose processes died
    return clips;
  }
  // It has been read once, so it changed while the batch ran.
  return {record_death(source.path, source.stem, label_of(aim.path), target.error(), options)};
}

BatchWork work_of(const Prepared& batch, const std::string& program) {
  const auto target_of = [&batch](std::size_t item) -> const BatchTarget& {
    return batch.job.targets[batch.plan.target(item)];
  };
  BatchWork work;
  work.recipe = [&batch, target_of, program](std::size_t item) {
    const JobOptions options = options_for(batch, target_of(item));
    return fmt::format("{}\n{}\n{}\n{}\n{}\n{}", program, batch.job.options_text,
                       batch.plan.source(item).path, target_of(item).path,
                       options.map ? options.map->string() : "", batch.job.gates);
  };
  work.inputs = [&batch, target_of](std::size_t item) {
    std::vector<std::string> files = {batch.plan.source(item).path};
    const BatchTarget& target = target_of(item);
    if (!shipped_rig(target.path)) files.push_back(target.path);
    if (const auto map = options_for(batch, target).map) files.push_back(map->string());
    if (std::filesystem::exists(batch.job.gates)) files.push_back(batch.job.gates);
    return files;
  };
  work.run = [&batch](std::size_t item, const fs::path& folder, std::vector<std::string>& read) {
    return run_one(batch, item, folder, read);
  };
  work.bury = [&batch](std::size_t item, const fs::path& folder, const Error& error) {
    JobOptions options = batch.options;
    options.output = folder;
    const BatchSource& source = batch.plan.source(item);
    return record_death(source.path, source.stem, batch.plan.labels[batch.plan.target(item)], error,
                        options);
  };
  return work;
}

json item_event(const BatchRecord& record) {
  json clips = json::array(), files = json::array();
  for (const ClipSummary& c : record.clips) {
    json clip{{"stem", c.stem}, {"status", to_string(c.status)}};
    if (!c.code.empty()) clip["code"] = c.code, clip["message"] = c.message;
    clip["frames"] = c.frames;
    clip["error_p95_mm"] = c.error_p95_mm;
    clips.push_back(std::move(clip));
  }
  for (const FileStamp& file : record.files) files.push_back(file.path);
  return {{"event", "item"}, {"item", record.item},         {"clips", clips},
          {"files", files},  {"attempts", record.attempts}, {"seconds", record.seconds}};
}

BatchObserver observer_of(std::optional<Progress>& progress, bool as_json) {
  BatchObserver observer;
  observer.started = [&progress, as_json](std::size_t items, std::size_t resumed) {
    fmt::print(stderr, "{} items, {} of them finished before\n", items, resumed);
    progress.emplace(items, resumed);
    if (as_json) print_event({{"event", "start"}, {"items", items}, {"finished_before", resumed}});
  };
  observer.finished = [&progress, as_json](const BatchRecord& record) {
    progress->add(record.clips, record.item.substr(0, record.item.rfind('/') + 1));
    if (as_json) print_event(item_event(record));
  };
  observer.retried = [&progress, as_json](const std::string& item, const Error& error) {
    progress->say(fmt::format("{}: {}; once more", item, error.message));
    if (as_json) {
      print_event(
          {{"event", "retry"}, {"item", item}, {"code", error.code}, {"message", error.message}});
    }
  };
  observer.draining = [&progress](std::size_t running) {
    progress->say(fmt::format(
        "interrupted: {} running items will finish; interrupt again to stop now", running));
  };
  return observer;
}

int exit_code_of(const BatchOutcome& outcome) {
  if (outcome.stopped) return kEnvironment;
  if (outcome.interrupted) return kInterrupted;
  if (outcome.failed > outcome.gates_missed) return kSomeFailed;
  return outcome.failed > 0 ? kGateMissed : kAllPassed;
}

void print_outcome(const BatchOutcome& outcome, const Prepared& batch, const BatchArgs& args) {
  const std::int64_t clips = outcome.passed + outcome.warned + outcome.failed;
  fmt::print(stderr, "{} clips: {} passed, {} warned, {} failed; outputs in {}\n", clips,
             outcome.passed, outcome.warned, outcome.failed, batch.job.output.string());
  if (!outcome.worst.empty() && clips > 1) fmt::print(stderr, "worst first:\n");
  for (const ClipSummary& clip : outcome.worst) fmt::print(stderr, "{}\n", summary_line(clip));
  const std::string again = fmt::format("limber batch {}{}", args.job.string(),
                                        batch.shard.whole() ? "" : " --shard " + args.shard);
  if (outcome.left > 0) {
    fmt::print(stderr, "{} items are left; to go on: {} --resume\n", outcome.left, again);
  } else if (outcome.failed > 0) {
    fmt::print(stderr, "to run the failed ones again: {} --retry-failed\n", again);
  }
  if (!args.json) return;
  json event{{"event", "end"},           {"passed", outcome.passed},
             {"warned", outcome.warned}, {"failed", outcome.failed},
             {"items", outcome.items},   {"finished_before", outcome.resumed},
             {"left", outcome.left},     {"exit_code", exit_code_of(outcome)}};
  if (outcome.stopped) {
    event["error"] = {{"code", outcome.stopped->code}, {"message", outcome.stopped->message}};
  }
  print_event(event);
}

/// The verdicts of all clips, those of earlier runs included, by name.
Result<void> write_junit(const fs::path& path, std::vector<ClipSummary> clips,
                         const std::string& suite) {
  std::sort(clips.begin(), clips.end(),
            [](const ClipSummary& a, const ClipSummary& b) { return a.stem < b.stem; });
  return write_whole(path, junit_xml(clips, suite));
}

/// Every path that would be written, where no clip fails; a source of several clips gets its files
/// once per clip.
int list_outputs(const Prepared& batch, bool as_json) {
  std::vector<std::string> suffixes;
  for (const std::string& format : batch.options.formats) suffixes.push_back("." + format);
  suffixes.insert(suffixes.end(), {".png", ".report.json"});
  const auto first = static_cast<std::size_t>(batch.shard.number - 1);
  const auto step = static_cast<std::size_t>(batch.shard.count);
  for (std::size_t i = first; i < batch.plan.size(); i += step) {
    const std::string stem = (batch.job.output / batch.plan.name(i)).string();
    json outputs = json::array();
    for (const std::string& suffix : suffixes) {
      if (!as_json) fmt::print("{}{}\n", stem, suffix);
      outputs.push_back(stem + suffix);
    }
    if (as_json) {
      print_event({{"event", "plan"},
                   {"item", batch.plan.name(i)},
                   {"source", batch.plan.source(i).path},
                   {"target", batch.job.targets[batch.plan.target(i)].path},
                   {"outputs", outputs}});
    }
  }
  return kAllPassed;
}

int told(const Error& error, const BatchArgs& args) {
  print_error(error, args.json);
  static const std::set<std::string, std::less<>> kOurs = {"output-unwritable", "output-busy",
                                                           "sandbox-unavailable"};
  return kOurs.contains(error.code) ? kEnvironment : kUsage;
}

}  // namespace

int batch_command(const BatchArgs& args) {
  const fs::path junit = args.junit.empty() ? fs::path() : fs::absolute(args.junit);
  const auto batch = prepare(args);
  if (!batch) return told(batch.error(), args);
  fmt::print(stderr, "{} sources x {} targets\n", batch->plan.sources.size(),
             batch->plan.labels.size());
  if (args.dry_run) return list_outputs(*batch, args.json);
  auto tree = OutputTree::open(batch->job.output, batch->shard);
  if (!tree) return told(tree.error(), args);
  if (auto r = check_targets(*batch); !r) return told(r.error(), args);
  const auto program = hash_file("/proc/self/exe");
  if (!program) return told(program.error(), args);
  const BatchWork work = work_of(*batch, std::string(kVersion) + " " + *program);
  BatchOptions options{.shard = batch->shard,
                       .resume = args.resume || args.verify || args.retry_failed,
                       .verify = args.verify,
                       .retry_failed = args.retry_failed,
                       .pool = {.processes = processes_or_cores(args.processes),
                                .sandbox = batch->options.sandbox,
                                .limits = batch->job.caps}};
  std::optional<Progress> progress;
  BatchObserver observer = observer_of(progress, args.json);
  std::vector<ClipSummary> clips;
  if (!junit.empty()) observer.counted = [&](const ClipSummary& clip) { clips.push_back(clip); };
  const BatchOutcome outcome = run_batch(batch->plan, work, *tree, options, observer);
  if (progress) progress->close();
  print_outcome(outcome, *batch, args);
  if (outcome.stopped) print_error(*outcome.stopped);
  if (!junit.empty()) {
    if (auto r = write_junit(junit, std::move(clips), args.job.stem().string()); !r) {
      return told(r.error(), args);
    }
  }
  return exit_code_of(outcome);
}

}  // namespace limber
