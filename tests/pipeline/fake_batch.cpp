// fake_batch JOB.json [batch options]: Limber's batch with a make-believe clip's work, so that its
// guarantees can be tried by the thousand. The first word of a source says what becomes of it:
//
//   ok        two files and a report            bad    a report alone, status fail
//   twin      the same for each of two clips
//   crash     the process dies                  flaky  it dies the first time only
//   hang      it never ends                     hog    it asks for memory without end
//   liar      its answer names a file elsewhere mute   it answers nothing
//   "parts W" a clip for each letter of W, each in a process of its own: (o)k after 0.6 s, (x)
//             crash, (h)ang, (f)laky
//   "ref X"   like ok, and reads X beside it    "slow N"  like ok, after N milliseconds
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <sstream>
#include <thread>

#include "pipeline/batch_command.h"
#include "pipeline/batch_run.h"
#include "pipeline/file_io.h"

namespace {

namespace fs = std::filesystem;
using namespace limber;

void write_outputs(const fs::path& folder, const std::string& content, ClipSummary& clip) {
  for (const char* suffix : {".bvh", ".glb", ".report.json"}) {
    const std::string text = clip.stem + suffix + "\n" + content + std::string(600, '.') + "\n";
    if (clip.status == Status::fail && std::strcmp(suffix, ".report.json") != 0) continue;
    const auto r = write_whole(folder / (clip.stem + suffix), text);
    if (!r) clip.unwritten = r.error().message;
  }
}

/// What becomes of one clip of several.
void act(char what, const fs::path& mark) {
  if (what == 'o') std::this_thread::sleep_for(std::chrono::milliseconds(600));
  while (what == 'h') ::pause();
  const bool again = fs::exists(mark);
  if (what == 'f' && !again) (void)write_whole(mark, "");
  if (what == 'x' || (what == 'f' && !again)) std::abort();
}

std::vector<ClipSummary> play_parts(const std::string& letters, const std::string& stem,
                                    const fs::path& folder, const ClipSummary& one,
                                    const IsolationLimits& limits) {
  std::vector<ClipSummary> clips;
  for (std::size_t k = 0; k < letters.size(); ++k) {
    ClipSummary clip = one;
    clip.stem.insert(stem.size(), "#" + std::to_string(k));
    const auto answer = run_part(
        [&] {
          act(letters[k], one.source + ".tried");
          write_outputs(folder, letters, clip);
          return std::string("done");
        },
        limits);
    if (!answer || *answer != "done") {
      clip.status = Status::fail;
      clip.code = answer ? "garbled" : answer.error().code;
      write_outputs(folder, clip.code, clip);
    }
    clips.push_back(clip);
  }
  return clips;
}

std::vector<ClipSummary> play(const BatchPlan& plan, std::size_t item, const fs::path& folder,
                              std::vector<std::string>& read, const IsolationLimits& limits) {
  const std::string path = plan.source(item).path;
  std::string content = read_text(path).ok() ? *read_text(path) : "bad";
  std::istringstream words(content);
  std::string what, argument;
  words >> what >> argument;
  ClipSummary clip{.source = path,
                   .clip = "",
                   .stem = plan.stem(item),
                   .status = Status::pass,
                   .code = "",
                   .message = ""};
  if (what == "crash") std::abort();
  if (what == "mute") ::_exit(0);
  while (what == "hang") ::pause();
  while (what == "hog") std::memset(std::malloc(1 << 20), 1, 1 << 20);
  if (what == "flaky") {
    const fs::path mark = path + ".tried";
    if (!fs::exists(mark)) {
      (void)write_whole(mark, "");
      std::abort();
    }
  }
  if (what == "liar") clip.stem = "liar", fs::create_symlink("/etc/hostname", folder / "passwd");
  if (what == "slow") {
    std::this_thread::sleep_for(std::chrono::milliseconds(std::atoi(argument.c_str())));
  }
  if (what == "ref") {
    read.push_back((fs::path(path).parent_path() / argument).string());
    content += read_text(read.back()).ok() ? *read_text(read.back()) : "nothing";
  }
  if (what == "bad")
    clip.status = Status::fail, clip.code = "bad", clip.message = "as it was asked";
  if (what == "parts") {
    return play_parts(argument, plan.source(item).stem, folder, clip, limits);
  }
  if (what != "twin") {
    write_outputs(folder, content, clip);
    return {clip};
  }
  std::vector<ClipSummary> clips(2, clip);
  for (int k = 0; k < 2; ++k) {
    clips[k].stem.insert(plan.source(item).stem.size(), k == 0 ? "#a" : "#b");
    write_outputs(folder, content, clips[k]);
  }
  return clips;
}

int run(const std::vector<std::string>& arguments) {
  BatchOptions options;
  for (std::size_t i = 1; i < arguments.size(); ++i) {
    if (arguments[i] == "--resume") options.resume = true;
    if (arguments[i] == "--verify") options.resume = options.verify = true;
    if (arguments[i] == "--retry-failed") options.resume = options.retry_failed = true;
    if (arguments[i] == "-j") options.pool.processes = std::atoi(arguments.at(i + 1).c_str());
    if (arguments[i] == "--shard") options.shard = *parse_shard(arguments.at(i + 1));
  }
  const auto text = read_text(arguments.at(0));
  const auto job = text ? job_from_json(*text) : Result<BatchJob>(text.error());
  if (!job) return 2;
  fs::current_path(fs::path(arguments[0]).parent_path());
  std::vector<std::string> labels;
  for (const BatchTarget& target : job->targets) labels.push_back(target.path);
  const auto plan = plan_batch(*job, labels);
  if (!plan) return 2;
  auto tree = OutputTree::open(job->output, options.shard);
  if (!tree) return 3;
  options.pool.sandbox = SandboxMode::off;
  options.pool.limits = job->caps;
  BatchWork work;
  work.recipe = [&](std::size_t item) { return job->options_text + plan->source(item).path; };
  work.inputs = [&](std::size_t item) { return std::vector{plan->source(item).path}; };
  work.run = [&](std::size_t item, const fs::path& folder, std::vector<std::string>& read) {
    return play(*plan, item, folder, read, job->caps);
  };
  work.bury = [&](std::size_t item, const fs::path& folder, const Error& error) {
    ClipSummary clip{.source = plan->source(item).path,
                     .clip = "",
                     .stem = plan->stem(item),
                     .status = Status::fail,
                     .code = error.code,
                     .message = error.message};
    write_outputs(folder, error.code, clip);
    return clip;
  };
  BatchObserver observer;
  observer.finished = [](const BatchRecord& r) {
    std::cout << "ran " << r.item << " " << r.clips[0].code << " x" << r.attempts << std::endl;
    for (const ClipSummary& clip : r.clips) {
      std::cout << "clip " << clip.stem << " " << clip.code << std::endl;
    }
  };
  const BatchOutcome outcome = run_batch(*plan, work, *tree, options, observer);
  std::cout << "end passed " << outcome.passed << " failed " << outcome.failed << " before "
            << outcome.resumed << " left " << outcome.left << std::endl;
  if (outcome.stopped) return 3;
  if (outcome.interrupted) return 130;
  return outcome.failed > 0 ? 1 : 0;
}

}  // namespace

int main(int argc, char** argv) { return run({argv + 1, argv + argc}); }
