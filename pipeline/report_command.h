#pragma once

#include <filesystem>

namespace limber {

/// `limber report DIR -o index.html`: the page of a batch.
struct ReportArgs {
  std::filesystem::path folder;
  std::filesystem::path page;
};

/// Exit code 0 also where clips failed: the page is what was asked for, and it shows them. 1: some
/// reports could not be read (the page says which); 2: no folder, or no report in it; 3: the page
/// cannot be written.
int report_command(const ReportArgs&);

}  // namespace limber
