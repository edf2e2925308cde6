#pragma once

#include <chrono>
#include <csignal>
#include <cstddef>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "pipeline/isolated.h"

namespace limber {

/// What was asked for, or one process per core that this process may use.
int processes_or_cores(int processes);

/// Runs tasks in processes of their own, several at a time, from a single-threaded process.
/// Children ignore SIGINT and SIGTERM, so that a parent which is asked to stop can let them finish;
/// they die with the parent.
class ProcessPool {
 public:
  struct Options {
    int processes = 1;
    SandboxMode sandbox = SandboxMode::automatic;
    IsolationLimits limits = {};
  };
  struct Ended {
    std::size_t task = 0;
    /// What the task returned. Errors: those of finish_isolated.
    Result<std::string> answer;
    double seconds = 0.0;
  };

  explicit ProcessPool(const Options& options) : options_(options) {}
  ~ProcessPool() { kill_all(); }
  ProcessPool(const ProcessPool&) = delete;
  ProcessPool& operator=(const ProcessPool&) = delete;

  bool full() const { return running_.size() >= static_cast<std::size_t>(options_.processes); }
  bool idle() const { return running_.empty(); }

  /// Error: `process-failed`, where the system gives no process.
  Result<void> start(std::size_t task, const std::function<std::string()>& work,
                     const JailRules& may);

  /// Waits for a task to end. Nothing where a signal that `unblocked` lets through came first.
  std::optional<Ended> wait(const sigset_t* unblocked = nullptr);

  void kill_all();

 private:
  using Clock = std::chrono::steady_clock;
  struct Running {
    std::size_t task = 0;
    IsolatedChild child;
    Clock::time_point start;
  };
  Ended finish(std::size_t k);

  Options options_;
  std::vector<Running> running_;
};

}  // namespace limber
