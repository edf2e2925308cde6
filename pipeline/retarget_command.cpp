#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <set>
#include <system_error>

#include "pipeline/commands.h"
#include "pipeline/file_io.h"
#include "pipeline/interrupts.h"
#include "pipeline/junit.h"
#include "pipeline/process_pool.h"
#include "pipeline/progress.h"
#include "pipeline/target_check.h"

namespace limber {
namespace {

namespace fs = std::filesystem;
using json = nlohmann::ordered_json;

/// One stem per source; sources of one stem are told apart by a number.
std::vector<std::string> unique_stems(const std::vector<std::string>& sources) {
  std::vector<std::string> stems;
  std::set<std::string> used;
  for (const std::string& source : sources) {
    const std::string base = safe_name(fs::path(source).stem().string());
    std::string stem = base;
    for (int k = 2; !used.insert(case_folded(stem)).second; ++k) {
      stem = fmt::format("{}-{}", base, k);
    }
    stems.push_back(stem);
  }
  return stems;
}

/// Answer of a clip's process, which reads the target anew: no parsed file is shared.
std::string work_on(const RetargetArgs& args, const std::string& source, const std::string& stem) {
  const auto options = target_options(args.job);
  if (!options) return "{}";
  const auto target = load_target(args.target, *options);
  if (!target) return "{}";  // load_target has succeeded once; it does so again unless files change
  return to_json(run_source(source, stem, *target, args.job));
}

/// A source's process reads it, the target and the map, and writes the outputs' folder.
JailRules rules_of(const RetargetArgs& args, std::size_t i) {
  JailRules may{
      .reads = {args.target, args.sources[i]}, .writes = {args.job.output}, .may_fork = true};
  if (args.job.map) may.reads.push_back(*args.job.map);
  return may;
}

/// Runs every source in a process of its own, at most `processes` at a time.
std::vector<ClipSummary> run_all(const RetargetArgs& args, const std::string& target_label,
                                 const Interrupts& interrupts, Progress& progress) {
  const std::vector<std::string> stems = unique_stems(args.sources);
  ProcessPool pool({.processes = processes_or_cores(args.processes), .sandbox = args.job.sandbox});
  std::vector<std::vector<ClipSummary>> by_source(args.sources.size());
  const auto take = [&](std::size_t i, const Result<std::string>& answer) {
    std::vector<ClipSummary> clips;
    if (answer) clips = summaries_from_json(*answer);
    if (clips.empty()) {
      const Error error =
          answer ? Error{.code = "process-failed", .message = "the clip's process gave no answer"}
                 : answer.error();
      clips = {record_death(args.sources[i], stems[i], target_label, error, args.job)};
    }
    progress.add(clips);
    by_source[i] = std::move(clips);
  };
  for (std::size_t i = 0; interrupts.count() == 0;) {
    if (i < args.sources.size() && !pool.full()) {
      const auto started = pool.start(
          i, [&] { return work_on(args, args.sources[i], stems[i]); }, rules_of(args, i));
      if (!started) take(i, started.error());
      ++i;
    } else if (pool.idle()) {
      break;
    } else if (auto ended = pool.wait(interrupts.while_waiting())) {
      take(ended->task, ended->answer);
    }
  }
  if (!pool.idle()) {
    pool.kill_all();
    remove_temporaries(args.job.output);
  }
  std::vector<ClipSummary> out;
  for (const auto& clips : by_source) out.insert(out.end(), clips.begin(), clips.end());
  return out;
}

std::int64_t count(const std::vector<ClipSummary>& clips, Status status) {
  return std::count_if(clips.begin(), clips.end(),
                       [&](const ClipSummary& c) { return c.status == status; });
}

void print_summary(const std::vector<ClipSummary>& clips, const fs::path& output) {
  std::vector<ClipSummary> worst = clips;
  std::stable_sort(worst.begin(), worst.end(), is_worse);
  fmt::print(stderr, "{} clips: {} passed, {} warned, {} failed; outputs in {}\n", clips.size(),
             count(clips, Status::pass), count(clips, Status::warn), count(clips, Status::fail),
             output.string());
  constexpr std::size_t kShown = 8;
  if (worst.size() > 1) fmt::print(stderr, "worst first:\n");
  for (std::size_t i = 0; i < std::min(kShown, worst.size()); ++i) {
    fmt::print(stderr, "{}\n", summary_line(worst[i]));
  }
}

json summary_json(const std::vector<ClipSummary>& clips, const fs::path& output) {
  json out{{"output", output.string()},
           {"passed", count(clips, Status::pass)},
           {"warned", count(clips, Status::warn)},
           {"failed", count(clips, Status::fail)},
           {"clips", json::array()}};
  for (const ClipSummary& c : clips) {
    json entry{{"source", c.source}, {"stem", c.stem}, {"status", to_string(c.status)}};
    if (!c.clip.empty()) entry["clip"] = c.clip;
    if (!c.code.empty()) entry["code"] = c.code, entry["message"] = c.message;
    entry["frames"] = c.frames;
    entry["violations"] = c.violations;
    entry["error_p95_mm"] = c.error_p95_mm;
    out["clips"].push_back(std::move(entry));
  }
  return out;
}

/// Failed clips that nothing but a gate fails count as gates missed.
int verdict(const std::vector<ClipSummary>& clips) {
  const auto failed = [](const ClipSummary& c) { return c.status == Status::fail; };
  const auto broken = [&](const ClipSummary& c) { return failed(c) && c.code != "gate-missed"; };
  if (std::any_of(clips.begin(), clips.end(), broken)) return kSomeFailed;
  return std::any_of(clips.begin(), clips.end(), failed) ? kGateMissed : kAllPassed;
}

}  // namespace

int retarget_command(const RetargetArgs& given) {
  RetargetArgs args = given;
  if (!args.gates.empty()) {
    auto gates = load_gates(args.gates);
    if (!gates) {
      print_error(gates.error(), args.json);
      return kUsage;
    }
    args.job.gates = std::move(*gates);
  }
  // The target is checked once, in a child: the parent never parses an animation file.
  const auto label = check_target(args.target, args.job);
  if (!label) {
    print_error(label.error(), args.json);
    return label.error().code == "sandbox-unavailable" ? kEnvironment : kUsage;
  }
  std::error_code error;
  fs::create_directories(args.job.output, error);
  if (!error && ::access(args.job.output.c_str(), W_OK) != 0) {
    error = std::error_code(errno, std::generic_category());
  }
  if (error) {
    print_error({.code = "output-unwritable",
                 .message = error.message(),
                 .file = args.job.output.string(),
                 .hint = "choose another folder with -o"},
                args.json);
    return kEnvironment;
  }
  const Interrupts interrupts;
  Progress progress(args.sources.size());
  const std::vector<ClipSummary> clips = run_all(args, *label, interrupts, progress);
  progress.close();
  print_summary(clips, args.job.output);
  if (args.json) {
    fmt::print(
        "{}\n",
        summary_json(clips, args.job.output).dump(2, ' ', false, json::error_handler_t::replace));
  }
  if (!args.junit.empty()) {
    if (auto r = write_whole(args.junit, junit_xml(clips, *label)); !r) {
      print_error(r.error(), args.json);
      return kEnvironment;
    }
  }
  if (interrupts.count() > 0) return kInterrupted;
  return verdict(clips);
}

}  // namespace limber
