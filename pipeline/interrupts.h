#pragma once

#include <array>
#include <csignal>

namespace limber {

/// While it lives, interrupts (SIGINT, SIGTERM, SIGHUP) are counted instead of ending the process,
/// and come only where the process waits with `while_waiting()`: none is lost between looking at
/// the count and waiting. SIGPIPE is ignored, for whoever reads the progress may go; SIGXFSZ too,
/// for write() then says EFBIG. One at a time.
class Interrupts {
 public:
  Interrupts();
  ~Interrupts();
  Interrupts(const Interrupts&) = delete;
  Interrupts& operator=(const Interrupts&) = delete;

  /// The signal mask to wait with (ppoll).
  const sigset_t* while_waiting() const { return &mask_before_; }
  int count() const;

 private:
  static constexpr std::array kCounted = {SIGINT, SIGTERM, SIGHUP};
  static constexpr std::array kIgnored = {SIGPIPE, SIGXFSZ};
  std::array<struct sigaction, kCounted.size()> counted_before_{};
  std::array<struct sigaction, kIgnored.size()> ignored_before_{};
  sigset_t mask_before_{};
};

}  // namespace limber
