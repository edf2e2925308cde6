#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "assets/model/result.h"

namespace limber {

/// JSON that may stand inside an HTML script element: ASCII alone, with <, > and & escaped, so that
/// nothing in it can end the element, open a comment or turn the writing direction.
std::string json_in_html(std::string json);

/// A relative address for a path: every byte but letters, digits and -._~/ percent-encoded, so that
/// no name can be a scheme, a query or a fragment.
std::string url_of(const std::filesystem::path&);

/// The rows of a batch's page: what the page shows of each report, the names that many rows share
/// told once. Nothing of a report is trusted: fields of a wrong kind are left out, texts and lists
/// are cut to what a page can show, and links are made from the report's own file name alone.
class ReportRows {
 public:
  /// The row of the report at `folder / relative` as one line of JSON; links lead from the page in
  /// `page_folder`. A report that cannot be read gets a row that fails with its reason.
  std::string add(const std::filesystem::path& folder, const std::filesystem::path& relative,
                  const std::filesystem::path& page_folder);

  /// What the rows refer to: {folder, version, names[], codes {code: [meaning, way out]},
  /// metrics[] {label, short, unit, level, about}, excess_edges_deg[]}.
  std::string tables(std::string_view folder_name) const;

  std::int64_t passed() const { return count_[0]; }
  std::int64_t warned() const { return count_[1]; }
  std::int64_t failed() const { return count_[2]; }  ///< unreadable reports included
  const std::vector<Error>& unreadable() const { return unreadable_; }  ///< the first 20
  std::int64_t unreadable_count() const { return unreadable_count_; }

 private:
  friend class RowMaker;
  int index_of(const std::string& name);

  std::map<std::string, int, std::less<>> index_;
  std::vector<std::string> names_;
  std::int64_t count_[3] = {0, 0, 0};
  std::int64_t unreadable_count_ = 0;
  std::vector<Error> unreadable_;
};

}  // namespace limber
