#include "pipeline/progress.h"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <cstdio>

namespace limber {
namespace {

std::string remaining(double seconds) {
  const auto s = static_cast<std::int64_t>(seconds + 0.5);
  if (s < 3600) return fmt::format("{:02}:{:02}", s / 60, s % 60);
  return fmt::format("{}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60);
}

}  // namespace

Progress::Progress(std::size_t total, std::size_t before)
    : total_(total),
      before_(before),
      done_(before),
      terminal_(::isatty(STDERR_FILENO) != 0),
      start_(std::chrono::steady_clock::now()) {
  show("");
}

void Progress::add(const std::vector<ClipSummary>& clips, const std::string& folder) {
  ++done_;
  std::string last;
  for (const ClipSummary& clip : clips) {
    failed_ += clip.status == Status::fail;
    warned_ += clip.status == Status::warn;
    last = fmt::format("{} {}{}", to_string(clip.status), folder, clip.stem);
    if (!clip.code.empty()) last += fmt::format(" ({})", clip.code);
    if (!terminal_) fmt::print(stderr, "[{}/{}] {}\n", done_, total_, last);
  }
  show(last);
}

void Progress::say(const std::string& line) {
  close();
  fmt::print(stderr, "{}\n", line);
  show("");
}

void Progress::close() const {
  if (terminal_) fmt::print(stderr, "\r\033[K");
}

void Progress::show(const std::string& last) const {
  if (!terminal_) return;
  std::string line = fmt::format("[{}/{}] {} failed, {} warned", done_, total_, failed_, warned_);
  const double elapsed =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  if (done_ > before_ && done_ < total_) {
    line += ", ETA " + remaining(elapsed / double(done_ - before_) * double(total_ - done_));
  }
  line += "  " + last;
  struct winsize size {};
  const std::size_t width =
      ::ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 10 ? size.ws_col - 1U : 79U;
  fmt::print(stderr, "\r\033[K{}", line.substr(0, width));
  std::fflush(stderr);
}

bool is_worse(const ClipSummary& a, const ClipSummary& b) {
  if (a.status != b.status) return a.status > b.status;
  return a.error_p95_mm > b.error_p95_mm;
}

std::string summary_line(const ClipSummary& c) {
  std::string line = fmt::format("  {} {:44} {:5} frames, error p95 {:6.1f} mm",
                                 to_string(c.status), c.stem, c.frames, c.error_p95_mm);
  if (!c.code.empty()) line += fmt::format("  {}: {}", c.code, c.message);
  return line;
}

}  // namespace limber
