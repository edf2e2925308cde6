#pragma once

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <map>
#include <sstream>
#include <string>
#include <vector>

#include "tests/pipeline/program.h"

namespace limber_test {

/// A folder with a job and its sources, to run batches in and to look at what they leave.
class BatchGround {
 public:
  explicit BatchGround(std::string program = LIMBER_FAKE_BATCH) : program_(std::move(program)) {}

  /// Sources by path below in/, each with its content, and a job that takes them all.
  void put(const std::map<std::string, std::string>& sources,
           const std::string& more_of_job = R"("targets": ["hero"])") {
    for (const auto& [name, content] : sources) {
      const fs::path path = folder_ / ("in/" + name);
      fs::create_directories(path.parent_path());
      write_text(path, content);
    }
    write_text(job(), R"({"sources": ["in/**/*.txt"], "output": "out", )" + more_of_job + "}");
  }

  fs::path job() const { return folder_ / "job.json"; }
  fs::path in() const { return folder_ / "in"; }
  fs::path out() const { return folder_ / "out"; }

  /// Starts the program on the job; its standard output goes to `log()`.
  pid_t start(std::vector<std::string> options = {},
              const std::vector<std::string>& environment = {}) const {
    options.insert(options.begin(), job().string());
    options.insert(options.begin(), leading_.begin(), leading_.end());
    options.insert(options.begin(), program_);
    const pid_t pid = ::fork();
    if (pid != 0) return pid;
    for (const std::string& pair : environment) ::putenv(const_cast<char*>(pair.c_str()));
    const int log = ::open((folder_ / "log").c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0666);
    ::dup2(log, STDOUT_FILENO);
    ::dup2(log, STDERR_FILENO);
    std::vector<char*> arguments;
    for (std::string& option : options) arguments.push_back(option.data());
    arguments.push_back(nullptr);
    ::execv(program_.c_str(), arguments.data());
    ::_exit(127);
  }
  static int finish(pid_t pid) {
    int status = 0;
    ::waitpid(pid, &status, 0);
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  }
  int run(const std::vector<std::string>& options = {},
          const std::vector<std::string>& environment = {}) const {
    return finish(start(options, environment));
  }
  std::string log() const { return text_of(folder_ / "log"); }
  /// Words of the log's lines that start with `first`, by their second word.
  std::map<std::string, std::string> lines(const std::string& first) const {
    std::map<std::string, std::string> found;
    std::istringstream in(log());
    for (std::string line; std::getline(in, line);) {
      std::istringstream words(line);
      std::string word, key, rest;
      words >> word >> key;
      std::getline(words, rest);
      if (word == first) found[key] = rest;
    }
    return found;
  }

  /// What goes before the job in the program's arguments.
  void set_leading(std::vector<std::string> words) { leading_ = std::move(words); }

  /// Every file of the output folder besides the run's own, by path, with its content.
  std::map<std::string, std::string> tree() const { return tree_of(out()); }
  static std::map<std::string, std::string> tree_of(const fs::path& root) {
    std::map<std::string, std::string> files;
    if (!fs::exists(root)) return files;
    for (auto it = fs::recursive_directory_iterator(root); it != fs::end(it); ++it) {
      if (it->path().filename() == ".limber") {
        it.disable_recursion_pending();
      } else if (it->is_regular_file()) {
        files[it->path().lexically_relative(root).string()] = text_of(it->path());
      }
    }
    return files;
  }

  /// Identity of every report that is there: a file that is written again gets another.
  std::map<std::string, std::pair<ino_t, std::int64_t>> reports() const {
    std::map<std::string, std::pair<ino_t, std::int64_t>> found;
    for (const auto& [name, content] : tree()) {
      if (!name.ends_with(".report.json")) continue;
      struct stat info {};
      ::stat((out() / name).c_str(), &info);
      found[name] = {info.st_ino, info.st_mtim.tv_sec * 1'000'000'000LL + info.st_mtim.tv_nsec};
    }
    return found;
  }

  /// Folders of items that were not brought to an end.
  std::size_t leftovers() const {
    std::size_t n = 0;
    for (const auto& entry : fs::directory_iterator(out() / ".limber/work")) n += entry.exists();
    return n;
  }

  void clear() const { fs::remove_all(out()); }

  /// What preloads the faults; see fault_shim.cpp.
  std::vector<std::string> with_fault(const std::string& fault) const {
    return {"LD_PRELOAD=" LIMBER_FAULT_SHIM, "LIMBER_FAULT=" + fault,
            "LIMBER_FAULT_ROOT=" + out().string(),
            "LIMBER_FAULT_COUNT=" + (folder_ / "count").string()};
  }
  long counted() const { return std::atol(text_of(folder_ / "count").c_str()); }

 private:
  Folder folder_;
  std::string program_;
  std::vector<std::string> leading_;
};

}  // namespace limber_test
