#include <fmt/format.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <deque>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <system_error>
#include <thread>

#include "pipeline/commands.h"
#include "pipeline/file_io.h"
#include "pipeline/junit.h"

namespace limber {
namespace {

namespace fs = std::filesystem;
using json = nlohmann::ordered_json;

volatile std::sig_atomic_t g_interrupted = 0;
void on_interrupt(int) { g_interrupted = 1; }

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

/// One line that is rewritten on a terminal, a line per clip elsewhere.
class Progress {
 public:
  explicit Progress(std::size_t total)
      : total_(total),
        terminal_(::isatty(STDERR_FILENO) != 0),
        start_(std::chrono::steady_clock::now()) {
    show("");
  }

  void add(const std::vector<ClipSummary>& clips) {
    ++done_;
    std::string last;
    for (const ClipSummary& clip : clips) {
      failed_ += clip.status == Status::fail;
      warned_ += clip.status == Status::warn;
      last = fmt::format("{} {}", to_string(clip.status), clip.stem);
      if (!clip.code.empty()) last += fmt::format(" ({})", clip.code);
      if (!terminal_) fmt::print(stderr, "[{}/{}] {}\n", done_, total_, last);
    }
    show(last);
  }

  void close() const {
    if (terminal_) fmt::print(stderr, "\r\033[K");
  }

 private:
  void show(const std::string& last) const {
    if (!terminal_) return;
    std::string line = fmt::format("[{}/{}] {} failed, {} warned", done_, total_, failed_, warned_);
    const double elapsed =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
    if (done_ > 0 && done_ < total_) {
      const auto eta = static_cast<int>(elapsed / double(done_) * double(total_ - done_) + 0.5);
      line += fmt::format(", ETA {:02}:{:02}", eta / 60, eta % 60);
    }
    line += "  " + last;
    struct winsize size {};
    const std::size_t width =
        ::ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 10 ? size.ws_col - 1U : 79U;
    fmt::print(stderr, "\r\033[K{}", line.substr(0, width));
    std::fflush(stderr);
  }

  std::size_t total_, done_ = 0;
  std::int64_t failed_ = 0, warned_ = 0;
  bool terminal_;
  std::chrono::steady_clock::time_point start_;
};

/// Answer of a clip's process, which reads the target anew: no parsed file is shared.
std::string work_on(const RetargetArgs& args, const std::string& source, const std::string& stem) {
  const auto options = target_options(args.job);
  if (!options) return "{}";
  const auto target = load_target(args.target, *options);
  if (!target) return "{}";  // load_target has succeeded once; it does so again unless files change
  return to_json(run_source(source, stem, *target, args.job));
}

/// What the work on a source reads.
std::vector<fs::path> readable(const RetargetArgs& args, const std::string& source) {
  std::vector<fs::path> out{args.target};
  if (!source.empty()) out.emplace_back(source);
  if (args.job.map) out.push_back(*args.job.map);
  return out;
}

struct Running {
  IsolatedChild child;
  std::size_t source = 0;
};

/// Runs every source in a process of its own, at most `processes` at a time.
std::vector<ClipSummary> run_all(const RetargetArgs& args, const std::string& target_label,
                                 Progress& progress) {
  const std::vector<std::string> stems = unique_stems(args.sources);
  const int processes = args.processes > 0
                            ? args.processes
                            : std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  std::map<std::size_t, std::vector<ClipSummary>> by_source;
  std::deque<Running> running;
  const auto finish_one = [&](std::size_t k) {
    const Running done = running[k];
    running.erase(running.begin() + static_cast<std::ptrdiff_t>(k));
    auto answer = finish_isolated(done.child);
    std::vector<ClipSummary> clips;
    if (answer) clips = summaries_from_json(*answer);
    if (clips.empty()) {
      const Error error =
          answer ? Error{.code = "process-failed", .message = "the clip's process gave no answer"}
                 : answer.error();
      clips = {record_death(args.sources[done.source], stems[done.source], target_label, error,
                            args.job)};
    }
    progress.add(clips);
    by_source[done.source] = std::move(clips);
  };
  const auto finish_any = [&] {
    std::vector<pollfd> waits;
    for (const Running& r : running) waits.push_back({r.child.answer_fd, POLLIN | POLLHUP, 0});
    ::poll(waits.data(), waits.size(), 500);  // ms; an interrupt or a limit is seen that soon
    const auto now = std::chrono::steady_clock::now();
    for (std::size_t k = 0; k < waits.size(); ++k) {
      if (now > running[k].child.deadline || waits[k].revents != 0) return finish_one(k);
    }
  };
  for (std::size_t i = 0; i < args.sources.size() && g_interrupted == 0; ++i) {
    while (static_cast<int>(running.size()) >= processes && g_interrupted == 0) finish_any();
    auto child = start_isolated([&] { return work_on(args, args.sources[i], stems[i]); },
                                {.may = {.reads = readable(args, args.sources[i]),
                                         .writes = {args.job.output},
                                         .may_fork = true},
                                 .sandbox = args.job.sandbox});
    if (child) {
      running.push_back({*child, i});
    } else {
      by_source[i] = {
          record_death(args.sources[i], stems[i], target_label, child.error(), args.job)};
    }
  }
  while (!running.empty() && g_interrupted == 0) finish_any();
  for (const Running& r : running) {
    ::kill(r.child.pid, SIGKILL);
    (void)finish_isolated(r.child);
  }
  if (!running.empty()) remove_temporaries(args.job.output);
  std::vector<ClipSummary> out;
  for (auto& [index, clips] : by_source) {
    out.insert(out.end(), clips.begin(), clips.end());
  }
  return out;
}

std::int64_t count(const std::vector<ClipSummary>& clips, Status status) {
  return std::count_if(clips.begin(), clips.end(),
                       [&](const ClipSummary& c) { return c.status == status; });
}

/// The worst clips first: failed, warned, then by error.
void print_summary(const std::vector<ClipSummary>& clips, const fs::path& output) {
  std::vector<ClipSummary> worst = clips;
  std::stable_sort(worst.begin(), worst.end(), [](const ClipSummary& a, const ClipSummary& b) {
    if (a.status != b.status) return a.status > b.status;
    return a.error_p95_mm > b.error_p95_mm;
  });
  fmt::print(stderr, "{} clips: {} passed, {} warned, {} failed; outputs in {}\n", clips.size(),
             count(clips, Status::pass), count(clips, Status::warn), count(clips, Status::fail),
             output.string());
  constexpr std::size_t kShown = 8;
  if (worst.size() > 1) fmt::print(stderr, "worst first:\n");
  for (std::size_t i = 0; i < std::min(kShown, worst.size()); ++i) {
    const ClipSummary& c = worst[i];
    std::string line = fmt::format("  {} {:44} {:5} frames, error p95 {:6.1f} mm",
                                   to_string(c.status), c.stem, c.frames, c.error_p95_mm);
    if (!c.code.empty()) line += fmt::format("  {}: {}", c.code, c.message);
    fmt::print(stderr, "{}\n", line);
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
  if (args.job.sandbox == SandboxMode::require && !sandbox_available()) {
    print_error({.code = "sandbox-unavailable",
                 .message = "this system confines by " + sandbox_level() + " only",
                 .hint = "see `limber doctor`, or use --sandbox auto"});
    return kEnvironment;
  }
  // The target is checked once, in a child: the parent never parses an animation file.
  const auto checked = run_isolated(
      [&] {
        const auto told = [](const Error& e) {
          return json{{"code", e.code},
                      {"message", e.message},
                      {"file", e.file},
                      {"joint", e.joint},
                      {"hint", e.hint}}
              .dump(-1, ' ', false, json::error_handler_t::replace);
        };
        const auto options = target_options(args.job);
        if (!options) return told(options.error());
        const auto target = load_target(args.target, *options);
        if (!target) return told(target.error());
        return json{{"label", target->label}}.dump(-1, ' ', false, json::error_handler_t::replace);
      },
      {.may = {.reads = readable(args, "")}, .sandbox = args.job.sandbox});
  if (!checked) {
    Error error = checked.error();
    error.file = args.target;
    print_error(error, args.json);
    return error.code == "sandbox-unavailable" ? kEnvironment : kUsage;
  }
  const json target = json::parse(*checked, nullptr, false);
  if (target.contains("code")) {
    print_error({.code = target["code"],
                 .message = target["message"],
                 .file = target["file"],
                 .joint = target["joint"],
                 .hint = target["hint"]},
                args.json);
    return kUsage;
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
  struct sigaction action {};
  action.sa_handler = on_interrupt;
  ::sigaction(SIGINT, &action, nullptr);
  ::sigaction(SIGTERM, &action, nullptr);

  Progress progress(args.sources.size());
  const std::vector<ClipSummary> clips = run_all(args, target["label"], progress);
  progress.close();
  print_summary(clips, args.job.output);
  if (args.json) {
    fmt::print(
        "{}\n",
        summary_json(clips, args.job.output).dump(2, ' ', false, json::error_handler_t::replace));
  }
  if (!args.junit.empty()) {
    if (auto r = write_whole(args.junit, junit_xml(clips, target["label"])); !r) {
      print_error(r.error(), args.json);
      return kEnvironment;
    }
  }
  if (g_interrupted != 0) return kInterrupted;
  return verdict(clips);
}

}  // namespace limber
