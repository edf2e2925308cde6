#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "assets/model/result.h"

namespace limber {

/// What a batch's page shows.
struct PageReport {
  std::int64_t passed = 0, warned = 0, failed = 0;
  std::int64_t unreadable = 0;           ///< reports that could not be read; they count as failed
  std::vector<Error> unreadable_errors;  ///< of the first of them
};

/// Every *.report.json in a folder and below it, relative to it, in the order of their bytes.
/// Links are not followed. Errors: `report-folder`, and `report-none` where there is none.
Result<std::vector<std::filesystem::path>> find_reports(const std::filesystem::path& folder);

/// Writes the page of all reports in `folder`: one HTML file that shows itself from the disk, asks
/// no network and runs no script but its own.
///
/// Contact sheets stay beside their reports, and the page links to them by relative address: at a
/// megabyte each, ten thousand of them embedded would be a page that no browser opens, while
/// linked ones load as they come into sight. A page therefore moves together with its folder.
///
/// Reports pass through one at a time; what stays in memory is their paths and the names that they
/// share. Same reports, same bytes. Errors: those of find_reports, `output-unwritable`.
Result<PageReport> write_report_page(const std::filesystem::path& folder,
                                     const std::filesystem::path& page);

}  // namespace limber
