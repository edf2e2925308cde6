// Faults at system calls that write, for any program: preload this library (ld.so(8), LD_PRELOAD).
//
//   LIMBER_FAULT=ACTION:N     the N-th such call below LIMBER_FAULT_ROOT, counted over the program
//                             and all its children, whichever makes it:
//     count                   nothing; the file LIMBER_FAULT_COUNT gets the number of calls
//     kill                    SIGKILL to the program and to the caller, before the call; a write is
//                             half done by then
//     crash                   SIGKILL to the caller alone
//     ENOSPC EIO EFBIG        the call fails so, a write half done
//   with "+" after N          and so do all later calls that need space
#include <dlfcn.h>
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

namespace {

struct Shared {
  std::atomic<long> calls{0};
  pid_t program = 0;
};

enum class Action { count, kill, crash, fail };

// No constructors: a program may call in before they run.
Shared* g_shared = nullptr;
const char* g_root = "";
Action g_action = Action::count;
int g_error = 0;
long g_at = 0;
bool g_onwards = false;

template <class F>
F real(const char* name) {
  return reinterpret_cast<F>(::dlsym(RTLD_NEXT, name));
}

void write_count() {
  const char* path = std::getenv("LIMBER_FAULT_COUNT");
  if (path == nullptr || ::getpid() != g_shared->program) return;
  const std::string text = std::to_string(g_shared->calls.load());
  static const auto real_open = real<int (*)(const char*, int, ...)>("open");
  static const auto real_write = real<ssize_t (*)(int, const void*, std::size_t)>("write");
  const int fd = real_open(path, O_WRONLY | O_CREAT | O_TRUNC, 0666);
  if (fd >= 0 && real_write(fd, text.data(), text.size()) < 0) std::perror("fault_shim");
}

__attribute__((constructor)) void prepare() {
  const char* fault = std::getenv("LIMBER_FAULT");
  const char* root = std::getenv("LIMBER_FAULT_ROOT");
  if (fault == nullptr || root == nullptr) return;
  const std::string text = fault, action = text.substr(0, text.find(':'));
  g_action = action == "count"   ? Action::count
             : action == "kill"  ? Action::kill
             : action == "crash" ? Action::crash
                                 : Action::fail;
  g_error = action == "ENOSPC" ? ENOSPC : action == "EFBIG" ? EFBIG : EIO;
  g_root = root;
  g_at = action == text ? 0 : std::atol(text.c_str() + action.size() + 1);
  g_onwards = text.ends_with('+');
  void* page =
      ::mmap(nullptr, sizeof(Shared), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  if (page == MAP_FAILED) return;
  g_shared = new (page) Shared;
  g_shared->program = ::getpid();
  std::atexit(write_count);
}

/// Whether a call on this path is one of those that count.
bool is_below_root(const char* path) {
  char resolved[PATH_MAX];
  std::string full = path;
  if (path[0] != '/' && ::getcwd(resolved, sizeof(resolved)) != nullptr) {
    full = std::string(resolved) + "/" + path;
  }
  return full.starts_with(std::string(g_root) + "/");
}

bool is_below_root(int fd) {
  char link[64], target[PATH_MAX];
  std::snprintf(link, sizeof(link), "/proc/self/fd/%d", fd);
  const ssize_t n = ::readlink(link, target, sizeof(target) - 1);
  if (n <= 0) return false;
  target[n] = '\0';
  return is_below_root(static_cast<const char*>(target)) || std::strcmp(g_root, target) == 0;
}

void kill_now() {
  if (g_action == Action::kill) ::kill(g_shared->program, SIGKILL);
  ::kill(::getpid(), SIGKILL);
  ::pause();
}

/// 0: go on; otherwise the errno to fail with. `first_half` is done before a fault strikes.
template <class FirstHalf>
int fault(bool needs_space, const FirstHalf& first_half) {
  const long call = ++g_shared->calls;
  const bool now = call == g_at || (g_onwards && needs_space && call > g_at);
  if (g_action == Action::count || !now) return 0;
  first_half();
  if (g_action != Action::fail) kill_now();
  return g_error;
}

int fault(bool needs_space) {
  return fault(needs_space, [] {});
}

bool fails(bool counts, bool needs_space) {
  if (g_shared == nullptr || !counts) return false;
  const int error = fault(needs_space);
  if (error != 0) errno = error;
  return error != 0;
}

}  // namespace

extern "C" {

ssize_t write(int fd, const void* data, size_t size) {
  static const auto next = real<ssize_t (*)(int, const void*, size_t)>("write");
  if (g_shared != nullptr && is_below_root(fd)) {
    const int error = fault(true, [&] { (void)!next(fd, data, size / 2); });
    if (error != 0) {
      errno = error;
      return -1;
    }
  }
  return next(fd, data, size);
}

int open(const char* path, int flags, ...) {
  static const auto next = real<int (*)(const char*, int, ...)>("open");
  va_list list;
  va_start(list, flags);
  const mode_t mode = (flags & O_CREAT) != 0 ? va_arg(list, mode_t) : 0;
  va_end(list);
  if ((flags & O_CREAT) != 0 && fails(is_below_root(path), true)) return -1;
  return next(path, flags, mode);
}

int fsync(int fd) {
  static const auto next = real<int (*)(int)>("fsync");
  if (fails(is_below_root(fd), true)) return -1;
  return next(fd);
}

int close(int fd) {
  static const auto next = real<int (*)(int)>("close");
  const bool written = (::fcntl(fd, F_GETFL) & O_ACCMODE) == O_WRONLY;
  const bool failed = written && fails(is_below_root(fd), false);
  const int error = errno;
  const int result = next(fd);  // a descriptor is gone even where close() fails
  if (failed) errno = error;
  return failed ? -1 : result;
}

int rename(const char* from, const char* to) {
  static const auto next = real<int (*)(const char*, const char*)>("rename");
  if (fails(is_below_root(to), true)) return -1;
  return next(from, to);
}

int mkdir(const char* path, mode_t mode) {
  static const auto next = real<int (*)(const char*, mode_t)>("mkdir");
  if (fails(is_below_root(path), true)) return -1;
  return next(path, mode);
}
}
