#include "pipeline/report_page.h"

#include <fmt/format.h>

#include <algorithm>
#include <string>
#include <system_error>

#include "pipeline/embedded.h"
#include "pipeline/file_io.h"
#include "pipeline/report_row.h"

namespace limber {
namespace {

namespace fs = std::filesystem;

/// RFC 4648, section 4, of the bytes that a hexadecimal text spells.
std::string base64_of_hex(std::string_view hex) {
  static constexpr std::string_view kDigits =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::vector<unsigned> bytes;
  for (std::size_t i = 0; i + 1 < hex.size(); i += 2) {
    bytes.push_back(static_cast<unsigned>(std::stoul(std::string(hex.substr(i, 2)), nullptr, 16)));
  }
  std::string out;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const auto byte = [&](std::size_t k) { return k < bytes.size() ? bytes[k] : 0u; };
    const unsigned group = byte(i) << 16 | byte(i + 1) << 8 | byte(i + 2);
    for (int k = 0; k < 4; ++k) {
      const bool padding = i + std::size_t(k) > bytes.size();
      out += padding ? '=' : kDigits[group >> (18 - 6 * k) & 63];
    }
  }
  return out;
}

/// 'sha256-...' of what stands between the tags (Content Security Policy Level 3, section 6.7).
std::string source_hash(std::string_view text) {
  const auto bytes = std::as_bytes(std::span(text.data(), text.size()));
  return fmt::format("'sha256-{}'", base64_of_hex(sha256_hex(bytes)));
}

/// Nothing may be loaded but pictures from where the page lies, nothing may run or style but what
/// it was written with, and no text may become markup.
std::string policy(std::string_view style, std::string_view script) {
  return fmt::format(
      "default-src 'none'; img-src 'self' file: data:; style-src {}; script-src {}; "
      "base-uri 'none'; form-action 'none'; require-trusted-types-for 'script'; trusted-types "
      "'none'",
      source_hash(style), source_hash(script));
}

std::string page_script() {
  std::string script;
  for (const char* part : {"clips", "charts", "detail", "page"}) {
    script += embedded_file(fmt::format("report/{}.js", part));
  }
  return script;
}

/// Hands out the template, each {{name}} filled by `fill(name)`, piece by piece.
template <class Fill>
void fill_template(std::string_view text, const Sink& put, Fill fill) {
  while (true) {
    const std::size_t open = text.find("{{");
    put(text.substr(0, open));
    if (open == std::string_view::npos) return;
    const std::size_t close = text.find("}}", open);
    fill(text.substr(open + 2, close - open - 2));
    text.remove_prefix(close + 2);
  }
}

fs::path true_path(const fs::path& path) {
  std::error_code error;
  fs::path out = fs::weakly_canonical(fs::absolute(path, error), error);
  return error ? path.lexically_normal() : out;
}

/// The name of the folder itself, also where it was given as "." or with a slash at its end.
std::string name_of(const fs::path& folder) {
  const fs::path name = folder.filename();
  return name.empty() ? folder.parent_path().filename().string() : name.string();
}

}  // namespace

Result<std::vector<fs::path>> find_reports(const fs::path& folder) {
  std::error_code error;
  std::vector<fs::path> reports;
  fs::recursive_directory_iterator entries(folder, fs::directory_options::skip_permission_denied,
                                           error);
  for (; !error && entries != fs::recursive_directory_iterator(); entries.increment(error)) {
    std::error_code ignored;
    if (!entries->is_regular_file(ignored)) continue;
    if (!entries->path().filename().string().ends_with(".report.json")) continue;
    reports.push_back(entries->path().lexically_relative(folder));
  }
  if (error) {
    return Error{.code = "report-folder",
                 .message = error.message(),
                 .file = folder.string(),
                 .hint = "give the folder that limber retarget wrote to"};
  }
  if (reports.empty()) {
    return Error{.code = "report-none",
                 .message = "the folder has no *.report.json",
                 .file = folder.string(),
                 .hint = "give the folder that limber retarget wrote to"};
  }
  std::ranges::sort(reports, {},
                    [](const fs::path& path) -> const std::string& { return path.native(); });
  return reports;
}

Result<PageReport> write_report_page(const fs::path& folder, const fs::path& page) {
  auto reports = find_reports(folder);
  if (!reports) return reports.error();
  const fs::path root = true_path(folder), page_folder = true_path(page).parent_path();
  const std::string_view style = embedded_file("report/page.css");
  const std::string script = page_script();
  ReportRows rows;
  const auto produce = [&](const Sink& put) {
    const auto put_rows = [&] {
      std::string_view separator = "[\n";
      for (const fs::path& report : *reports) {
        put(separator);
        put(rows.add(root, report, page_folder));
        separator = ",\n";
      }
      put("\n]");
    };
    fill_template(embedded_file("report/page.html"), put, [&](std::string_view name) {
      if (name == "policy") put(policy(style, script));
      if (name == "style") put(style);
      if (name == "script") put(script);
      if (name == "clips") put_rows();
      if (name == "batch") put(rows.tables(name_of(root)));
    });
  };
  if (auto r = write_whole(page, produce); !r) return r.error();
  return PageReport{rows.passed(), rows.warned(), rows.failed(), rows.unreadable_count(),
                    rows.unreadable()};
}

}  // namespace limber
