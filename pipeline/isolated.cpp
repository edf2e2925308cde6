#include "pipeline/isolated.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <new>
#include <optional>

namespace limber {
namespace {

/// Lowers a limit for good; to `value` at once, `beyond` it at the utmost.
void set_limit(__rlimit_resource resource, std::uint64_t value, std::uint64_t beyond = 0) {
  struct rlimit limit {};
  if (::getrlimit(resource, &limit) != 0) return;
  limit.rlim_max = std::min<rlim_t>(limit.rlim_max, value + beyond);
  limit.rlim_cur = std::min<rlim_t>(limit.rlim_cur, value);
  ::setrlimit(resource, &limit);
}

void write_all(int fd, const std::string& text) {
  std::size_t put = 0;
  while (put < text.size()) {
    const ssize_t n = ::write(fd, text.data() + put, text.size() - put);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return;
    put += static_cast<std::size_t>(n);
  }
}

/// Of this process, where it is isolated.
int g_answer_fd = -1;

/// An answer is JSON or a number, before which blank lines mean nothing: each begins a part.
constexpr const char* kNewPart = "\n";

/// A part that is ended for its time has its own end told by the process that waits for it.
constexpr std::chrono::seconds kToTellOfAPart{5};

constexpr int kExitNoJail = 3;
constexpr int kExitNoMemory = 4;
constexpr int kExitThrown = 5;

/// The child's only open file beyond the standard ones is its answer.
int keep_only(int answer_fd) {
  constexpr int kKept = STDERR_FILENO + 1;
  if (answer_fd != kKept) answer_fd = ::dup2(answer_fd, kKept);
  ::syscall(SYS_close_range, kKept + 1, ~0U, 0);
  return answer_fd;
}

bool confine(const Isolation& isolation) {
  set_limit(RLIMIT_CORE, 0);
  if (kMemoryCanBeLimited) set_limit(RLIMIT_AS, isolation.limits.memory_bytes);
  set_limit(RLIMIT_CPU, isolation.limits.cpu_seconds, 1);  // SIGXCPU first, not SIGKILL
  set_limit(RLIMIT_FSIZE, isolation.limits.file_bytes);
  if (isolation.sandbox == SandboxMode::off) return true;
  const JailSupport holds = enter_jail(isolation.may);
  return holds.complete() || isolation.sandbox == SandboxMode::automatic;
}

[[noreturn]] void child_main(pid_t parent, int answer_fd, const std::function<std::string()>& work,
                             const Isolation& isolation) {
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (::getppid() != parent) ::_exit(1);  // it died before the child asked to die with it
  g_answer_fd = answer_fd = keep_only(answer_fd);
  if (!confine(isolation)) ::_exit(kExitNoJail);
  int code = 0;
  try {
    write_all(answer_fd, work());
  } catch (const std::bad_alloc&) {
    code = kExitNoMemory;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "limber: %s\n", e.what());
    code = kExitThrown;
  } catch (...) {
    code = kExitThrown;
  }
  ::close(answer_fd);
  std::fflush(nullptr);
  ::_exit(code);
}

Error over_limit(std::string message) {
  return {.code = "process-limit",
          .message = std::move(message),
          .hint = "the file asks for more memory or time than a clip may have"};
}

Error died(int status) {
  if (WIFSIGNALED(status)) {
    const int signal = WTERMSIG(status);
    const std::string message =
        fmt::format("the clip's process was ended by {}", ::strsignal(signal));
    if (signal == SIGXCPU || signal == SIGXFSZ) return over_limit(message);
    if (signal == SIGKILL) {  // which no limit sends first: most likely the system's memory ran out
      return Error{.code = "process-crashed",
                   .message = "the clip's process was killed from outside",
                   .hint = "where memory ran out, use fewer processes (-j)"};
    }
    return Error{.code = "process-crashed",
                 .message = message,
                 .hint = "the file breaks its reader; re-export it"};
  }
  const int code = WEXITSTATUS(status);
  if (code == kExitNoJail) {
    return Error{.code = "sandbox-unavailable",
                 .message = "this system cannot confine the clip's process",
                 .hint = "run with --sandbox auto, or see `limber doctor`"};
  }
  if (code == kExitNoMemory) return over_limit("the clip's process ran out of its memory limit");
  return Error{.code = "process-failed",
               .message = fmt::format("the clip's process ended with {}", code),
               .hint = "please report this file"};
}

Error over_time(const IsolationLimits& limits) {
  return {.code = "process-timeout",
          .message = fmt::format("the clip took longer than {} s", limits.wall_seconds),
          .hint = "cut the clip with --range, or allow it more time"};
}

/// Hears until the end, the deadline or too much; the latter two are told.
std::optional<Error> collect(IsolatedChild& child) {
  for (bool ended = false; !ended;) {
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(
        child.deadline - std::chrono::steady_clock::now());
    if (left.count() <= 0) return over_time(child.limits);
    struct pollfd wait {
      child.answer_fd, POLLIN, 0
    };
    const int wait_ms = static_cast<int>(std::min<std::int64_t>(left.count(), 60'000));
    ended = ::poll(&wait, 1, wait_ms) > 0 && hear(child);
  }
  if (child.answer.size() <= child.limits.answer_bytes) return std::nullopt;
  return over_limit("the clip's process said more than it may");
}

}  // namespace

Result<IsolatedChild> start_isolated(const std::function<std::string()>& work,
                                     const Isolation& isolation) {
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) {
    return Error{.code = "process-failed", .message = std::strerror(errno)};
  }
  std::fflush(nullptr);
  const pid_t parent = ::getpid();
  const pid_t pid = ::fork();
  if (pid < 0) {
    const int error = errno;
    ::close(ends[0]);
    ::close(ends[1]);
    return Error{.code = "process-failed", .message = std::strerror(error)};
  }
  if (pid == 0) child_main(parent, ends[1], work, isolation);
  ::close(ends[1]);
  ::fcntl(ends[0], F_SETFL, O_NONBLOCK);
  const auto deadline =
      std::chrono::steady_clock::now() + std::chrono::seconds(isolation.limits.wall_seconds);
  return IsolatedChild{pid, ends[0], isolation.limits, deadline};
}

Result<std::string> finish_isolated(IsolatedChild child) {
  const std::optional<Error> stopped = collect(child);
  if (stopped) ::kill(child.pid, SIGKILL);
  ::close(child.answer_fd);
  int status = 0;
  while (::waitpid(child.pid, &status, 0) < 0 && errno == EINTR) {
  }
  if (stopped) return *stopped;
  if (WIFEXITED(status) && WEXITSTATUS(status) == 0) return std::move(child.answer);
  return died(status);
}

Result<std::string> run_isolated(const std::function<std::string()>& work,
                                 const Isolation& isolation) {
  auto child = start_isolated(work, isolation);
  if (!child) return child.error();
  return finish_isolated(std::move(*child));
}

bool hear(IsolatedChild& child) {
  std::array<char, 65536> buffer;
  while (child.answer.size() <= child.limits.answer_bytes) {
    const ssize_t n = ::read(child.answer_fd, buffer.data(), buffer.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return errno != EAGAIN;
    if (n == 0) return true;
    child.answer.append(buffer.data(), static_cast<std::size_t>(n));
    if (child.answer.find_first_not_of(kNewPart) == std::string::npos) {
      child.deadline = std::chrono::steady_clock::now() + kToTellOfAPart +
                       std::chrono::seconds(child.limits.wall_seconds);
    }
  }
  return true;
}

void begin_part() {
  if (g_answer_fd >= 0) write_all(g_answer_fd, kNewPart);
}

Result<std::string> run_part(const std::function<std::string()>& work,
                             const IsolationLimits& limits) {
  constexpr int kAttempts = 2;
  for (int attempt = 1;; ++attempt) {
    begin_part();
    // What confines this process confines its children too.
    auto answer = run_isolated(work, {.sandbox = SandboxMode::off, .limits = limits});
    if (answer || attempt == kAttempts || !worth_another_try(answer.error())) return answer;
  }
}

bool worth_another_try(const Error& error) {
  return error.code == "process-crashed" || error.code == "process-failed";
}

bool sandbox_available() {
  static const bool available = jail_support().complete();
  return available;
}

std::string sandbox_level() {
  const JailSupport support = jail_support();
  std::string level = "own process";
  if (support.landlock_abi > 0) level += fmt::format(", Landlock {}", support.landlock_abi);
  if (support.seccomp) level += ", seccomp";
  return level + ", resource limits";
}

}  // namespace limber
