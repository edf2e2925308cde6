#include "pipeline/isolated.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <seccomp.h>
#include <sys/prctl.h>
#include <sys/resource.h>
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

namespace limber {
namespace {

/// System calls that reading, solving and drawing never need.
constexpr std::array kDenied = {SCMP_SYS(socket),
                                SCMP_SYS(connect),
                                SCMP_SYS(bind),
                                SCMP_SYS(listen),
                                SCMP_SYS(execve),
                                SCMP_SYS(execveat),
                                SCMP_SYS(ptrace),
                                SCMP_SYS(mount),
                                SCMP_SYS(umount2),
                                SCMP_SYS(chroot),
                                SCMP_SYS(pivot_root),
                                SCMP_SYS(setns),
                                SCMP_SYS(unshare),
                                SCMP_SYS(keyctl),
                                SCMP_SYS(add_key),
                                SCMP_SYS(bpf),
                                SCMP_SYS(init_module),
                                SCMP_SYS(kexec_load),
                                SCMP_SYS(process_vm_writev)};

bool deny_system_calls() {
  if (::prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0) return false;
  scmp_filter_ctx filter = ::seccomp_init(SCMP_ACT_ALLOW);
  if (filter == nullptr) return false;
  bool ok = true;
  for (const int call : kDenied) {
    ok = ::seccomp_rule_add(filter, SCMP_ACT_ERRNO(EPERM), call, 0) == 0 && ok;
  }
  ok = ::seccomp_load(filter) == 0 && ok;
  ::seccomp_release(filter);
  return ok;
}

void set_limit(int resource, std::uint64_t value) {
  struct rlimit limit {};
  if (::getrlimit(static_cast<__rlimit_resource>(resource), &limit) != 0) return;
  limit.rlim_cur = std::min<rlim_t>(limit.rlim_max, value);
  ::setrlimit(static_cast<__rlimit_resource>(resource), &limit);
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

[[noreturn]] void child_main(int answer_fd, const std::function<std::string()>& work,
                             SandboxMode sandbox, const IsolationLimits& limits) {
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  set_limit(RLIMIT_CORE, 0);
#if !defined(__SANITIZE_ADDRESS__)
  set_limit(RLIMIT_AS, limits.memory_bytes);
#endif
  set_limit(RLIMIT_CPU, limits.cpu_seconds);
  set_limit(RLIMIT_FSIZE, limits.file_bytes);
  if (sandbox != SandboxMode::off) {
    const bool jailed = deny_system_calls();
    if (!jailed && sandbox == SandboxMode::require) ::_exit(3);
  }
  int code = 0;
  try {
    write_all(answer_fd, work());
  } catch (const std::bad_alloc&) {
    code = 4;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "limber: %s\n", e.what());
    code = 5;
  } catch (...) {
    code = 5;
  }
  ::close(answer_fd);
  std::fflush(nullptr);
  ::_exit(code);
}

Error died(int status) {
  if (WIFSIGNALED(status)) {
    const int signal = WTERMSIG(status);
    const bool limit = signal == SIGXCPU || signal == SIGXFSZ || signal == SIGKILL;
    return Error{.code = limit ? "process-limit" : "process-crashed",
                 .message = fmt::format("the clip's process was ended by {}", ::strsignal(signal)),
                 .hint = limit ? "the file asks for more memory or time than a clip may have"
                               : "the file breaks its reader; re-export it"};
  }
  const int code = WEXITSTATUS(status);
  if (code == 3) {
    return Error{.code = "sandbox-unavailable",
                 .message = "this system cannot confine the clip's process",
                 .hint = "run with --sandbox auto, or see `limber doctor`"};
  }
  if (code == 4) {
    return Error{.code = "process-limit",
                 .message = "the clip's process ran out of its memory limit",
                 .hint = "the file asks for more memory than a clip may have"};
  }
  return Error{.code = "process-failed",
               .message = fmt::format("the clip's process ended with {}", code),
               .hint = "please report this file"};
}

}  // namespace

Result<IsolatedChild> start_isolated(const std::function<std::string()>& work, SandboxMode sandbox,
                                     const IsolationLimits& limits) {
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) {
    return Error{.code = "process-failed", .message = std::strerror(errno)};
  }
  std::fflush(nullptr);
  const pid_t pid = ::fork();
  if (pid < 0) {
    const int error = errno;
    ::close(ends[0]);
    ::close(ends[1]);
    return Error{.code = "process-failed", .message = std::strerror(error)};
  }
  if (pid == 0) {
    ::close(ends[0]);
    child_main(ends[1], work, sandbox, limits);
  }
  ::close(ends[1]);
  return IsolatedChild{pid, ends[0]};
}

Result<std::string> finish_isolated(IsolatedChild child) {
  std::string answer;
  std::array<char, 65536> buffer;
  for (;;) {
    const ssize_t n = ::read(child.answer_fd, buffer.data(), buffer.size());
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) break;
    answer.append(buffer.data(), static_cast<std::size_t>(n));
  }
  ::close(child.answer_fd);
  int status = 0;
  while (::waitpid(child.pid, &status, 0) < 0 && errno == EINTR) {
  }
  if (WIFEXITED(status) && WEXITSTATUS(status) == 0) return answer;
  return died(status);
}

Result<std::string> run_isolated(const std::function<std::string()>& work, SandboxMode sandbox,
                                 const IsolationLimits& limits) {
  auto child = start_isolated(work, sandbox, limits);
  if (!child) return child.error();
  return finish_isolated(*child);
}

bool sandbox_available() {
  static const bool available =
      ::seccomp_api_get() > 0 && ::prctl(PR_GET_NO_NEW_PRIVS, 0, 0, 0, 0) >= 0;
  return available;
}

std::string sandbox_level() {
  return sandbox_available() ? "own process, seccomp, no new privileges, resource limits"
                             : "own process, resource limits";
}

}  // namespace limber
