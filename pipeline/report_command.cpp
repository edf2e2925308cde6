#include "pipeline/report_command.h"

#include <fmt/format.h>

#include "pipeline/commands.h"
#include "pipeline/report_page.h"

namespace limber {

int report_command(const ReportArgs& args) {
  const auto report = write_report_page(args.folder, args.page);
  if (!report) {
    print_error(report.error());
    return report.error().code == "output-unwritable" ? kEnvironment : kUsage;
  }
  for (const Error& error : report->unreadable_errors) print_error(error);
  fmt::print(stderr, "{}: {} passed, {} warned, {} failed", args.page.string(), report->passed,
             report->warned, report->failed);
  if (report->unreadable > 0) fmt::print(stderr, " ({} unreadable)", report->unreadable);
  fmt::print(stderr, "\n");
  return report->unreadable > 0 ? kSomeFailed : kAllPassed;
}

}  // namespace limber
