#include "pipeline/interrupts.h"

#include <cstddef>

namespace limber {
namespace {

volatile std::sig_atomic_t g_interrupts = 0;
void on_interrupt(int) { g_interrupts = g_interrupts + 1; }

}  // namespace

Interrupts::Interrupts() {
  g_interrupts = 0;
  sigset_t blocked;
  sigemptyset(&blocked);
  struct sigaction count {
  }, ignore{};
  count.sa_handler = on_interrupt;
  ignore.sa_handler = SIG_IGN;
  for (std::size_t i = 0; i < kCounted.size(); ++i) {
    sigaddset(&blocked, kCounted[i]);
    ::sigaction(kCounted[i], &count, &counted_before_[i]);
  }
  for (std::size_t i = 0; i < kIgnored.size(); ++i) {
    ::sigaction(kIgnored[i], &ignore, &ignored_before_[i]);
  }
  ::sigprocmask(SIG_BLOCK, &blocked, &mask_before_);
}

Interrupts::~Interrupts() {
  ::sigprocmask(SIG_SETMASK, &mask_before_, nullptr);
  for (std::size_t i = 0; i < kCounted.size(); ++i) {
    ::sigaction(kCounted[i], &counted_before_[i], nullptr);
  }
  for (std::size_t i = 0; i < kIgnored.size(); ++i) {
    ::sigaction(kIgnored[i], &ignored_before_[i], nullptr);
  }
}

int Interrupts::count() const { return g_interrupts; }

}  // namespace limber
