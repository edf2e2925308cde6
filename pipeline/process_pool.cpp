#include "pipeline/process_pool.h"

#include <fmt/format.h>
#include <poll.h>

#include <algorithm>
#include <cerrno>
#include <thread>
#include <utility>

namespace limber {
namespace {

/// What every child does before its task.
void settle_child() {
  std::signal(SIGINT, SIG_IGN);
  std::signal(SIGTERM, SIG_IGN);
  std::signal(SIGHUP, SIG_IGN);
  std::signal(SIGXFSZ, SIG_DFL);
  sigset_t none;
  sigemptyset(&none);
  ::sigprocmask(SIG_SETMASK, &none, nullptr);
}

}  // namespace

int processes_or_cores(int processes) {
  if (processes > 0) return processes;
  return std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
}

Result<void> ProcessPool::start(std::size_t task, const std::function<std::string()>& work,
                                const JailRules& may) {
  auto child = start_isolated(
      [&] {
        settle_child();
        return work();
      },
      {.may = may, .sandbox = options_.sandbox, .limits = options_.limits});
  if (!child) return child.error();
  running_.push_back({task, std::move(*child), Clock::now()});
  return {};
}

ProcessPool::Ended ProcessPool::finish(std::size_t k) {
  Running running = std::move(running_[k]);
  running_.erase(running_.begin() + static_cast<std::ptrdiff_t>(k));
  auto answer = finish_isolated(std::move(running.child));
  const double seconds = std::chrono::duration<double>(Clock::now() - running.start).count();
  return {running.task, std::move(answer), seconds};
}

std::optional<ProcessPool::Ended> ProcessPool::wait(const sigset_t* unblocked) {
  std::vector<pollfd> waits;
  while (!running_.empty()) {
    waits.clear();
    auto deadline = Clock::time_point::max();
    for (const Running& r : running_) {
      waits.push_back({r.child.answer_fd, POLLIN, 0});
      deadline = std::min(deadline, r.child.deadline);
    }
    const auto left = std::max(Clock::duration::zero(), deadline - Clock::now());
    const auto s = std::chrono::duration_cast<std::chrono::seconds>(left);
    const timespec timeout{s.count(), std::chrono::nanoseconds(left - s).count()};
    const int ready = ::ppoll(waits.data(), waits.size(), &timeout, unblocked);
    if (ready < 0 && errno == EINTR) return std::nullopt;
    const auto now = Clock::now();
    for (std::size_t k = 0; k < waits.size(); ++k) {
      const bool ended = waits[k].revents != 0 && hear(running_[k].child);
      if (ended || now >= running_[k].child.deadline) return finish(k);
    }
  }
  return std::nullopt;
}

void ProcessPool::kill_all() {
  for (const Running& r : running_) ::kill(r.child.pid, SIGKILL);
  while (!running_.empty()) finish(running_.size() - 1);
}

}  // namespace limber
