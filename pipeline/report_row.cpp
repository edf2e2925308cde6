#include "pipeline/report_row.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>

#include "pipeline/codes.h"
#include "pipeline/file_io.h"
#include "pipeline/version.h"
#include "validation/limit_check.h"

namespace limber {
namespace {

namespace fs = std::filesystem;
using json = nlohmann::ordered_json;

constexpr std::string_view kSuffix = ".report.json";
constexpr std::uintmax_t kLargestReport = 32u << 20;  // bytes
constexpr std::size_t kLongestName = 200, kLongestMessage = 600;
constexpr std::size_t kMostEntries = 200;  // of any list
constexpr std::size_t kMostSamples = 200;
constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

// ---- reading what may be anything

const json& nothing() {
  static const json null;
  return null;
}

template <class... Keys>
const json& at(const json& node, const char* key, Keys... more) {
  const auto found = node.is_object() ? node.find(key) : node.end();
  if (!node.is_object() || found == node.end()) return nothing();
  if constexpr (sizeof...(more) == 0) {
    return *found;
  } else {
    return at(*found, more...);
  }
}

double number(const json& node) { return node.is_number() ? node.get<double>() : kNone; }

std::int64_t whole(const json& node, std::int64_t otherwise = 0) {
  const double x = number(node);
  return std::abs(x) < 1e15 ? static_cast<std::int64_t>(x) : otherwise;
}

/// At most `longest` bytes of whole characters.
std::string cut(std::string text, std::size_t longest) {
  if (text.size() <= longest) return text;
  while (longest > 0 && (static_cast<unsigned char>(text[longest]) & 0xC0) == 0x80) --longest;
  text.resize(longest);
  return text + "\u2026";
}

std::string text(const json& node, std::size_t longest = kLongestName) {
  return node.is_string() ? cut(node.get<std::string>(), longest) : std::string();
}

template <class Visit>
void for_each(const json& list, Visit visit) {
  if (!list.is_array()) return;
  for (std::size_t i = 0; i < std::min(list.size(), kMostEntries); ++i) visit(list[i]);
}

// ---- writing little

/// Four digits are what a page can show; null where there is none.
json brief(double x) {
  if (!std::isfinite(x)) return nullptr;
  if (x == std::rint(x) && std::abs(x) < 1e15) return static_cast<std::int64_t>(x);
  return json::parse(fmt::format("{:.4g}", x), nullptr, false);
}

/// [peak, letters]: a line in 63rds of its peak; null where there is no line, or nothing on it.
json line(const json& values) {
  static constexpr std::string_view kLetters =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_";
  if (!values.is_array() || values.empty()) return nullptr;
  const std::size_t samples = std::min(values.size(), kMostSamples);
  double peak = 0.0;
  for (std::size_t i = 0; i < samples; ++i) peak = std::fmax(peak, number(values[i]));
  if (!(peak > 0.0) || !std::isfinite(peak)) return nullptr;
  std::string letters;
  for (std::size_t i = 0; i < samples; ++i) {
    const double share = std::fmax(0.0, number(values[i])) / peak;
    letters += kLetters[static_cast<std::size_t>(std::lround(63.0 * share))];
  }
  return {brief(peak), letters};
}

/// A letter per sample: A none, B left, C right, D both; empty where no foot ever stands.
std::string contacts(const json& left, const json& right) {
  const auto stands = [](const json& side, std::size_t i) {
    return side.is_array() && i < side.size() && number(side[i]) > 0.0;
  };
  const std::size_t samples = std::min(kMostSamples, std::max(left.is_array() ? left.size() : 0,
                                                              right.is_array() ? right.size() : 0));
  std::string letters;
  for (std::size_t i = 0; i < samples; ++i) {
    letters += static_cast<char>('A' + stands(left, i) + 2 * stands(right, i));
  }
  return letters.find_first_not_of('A') == std::string::npos ? std::string() : letters;
}

// ---- figures

double largest_error(const json& report, const char* figure) {
  double largest = kNone;
  for_each(at(report, "effectors"), [&](const json& effector) {
    largest = std::fmax(largest, number(at(effector, "position_error_mm", figure)));
  });
  return largest;
}

double beyond_source(const json& report, const char* figure) {
  return std::max(0.0, number(at(report, "contacts", "output", figure)) -
                           number(at(report, "contacts", "source", figure)));
}

double longest_at_limit(const json& report) {
  double most = at(report, "limits", "at_limit").is_array() ? 0.0 : kNone;
  for_each(at(report, "limits", "at_limit"),
           [&](const json& joint) { most = std::fmax(most, number(at(joint, "frames"))); });
  return 100.0 * most / number(at(report, "output", "frames"));
}

/// A figure of a clip. `level`: from here on it counts as bad (0: it is no blame of the result);
/// `brief` names it on a card, where it has a place there.
struct Metric {
  const char *label, *brief, *unit;
  double level;
  const char* about;
  double (*value)(const json& report);
};

// clang-format off
constexpr Metric kMetrics[] = {
    {"Limit violations", "", "", 1.0, "joint-frames of the written file beyond their limits",
     [](const json& r) { return number(at(r, "limits", "violations")); }},
    {"Effector error, p95", "error", "mm", 100.0, "of the worst effector, 95th percentile over frames",
     [](const json& r) { return largest_error(r, "p95"); }},
    {"Effector error, largest", "", "mm", 0.0, "of the worst effector in its worst frame",
     [](const json& r) { return largest_error(r, "max"); }},
    {"Gap to Ceres, p95", "gap", "%", 5.0, "how much better Ceres solves the checked frames",
     [](const json& r) { return number(at(r, "refine", "gap_percent", "p95")); }},
    {"Slide", "slide", "cm/s", 0.0, "speed of standing feet",
     [](const json& r) { return number(at(r, "contacts", "output", "slide_cm_s")); }},
    {"Slide beyond the source's", "", "cm/s", 2.0, "speed of standing feet, less the source's",
     [](const json& r) { return beyond_source(r, "slide_cm_s"); }},
    {"Penetration beyond the source's", "", "cm", 1.0, "depth of soles below the floor, less the source's",
     [](const json& r) { return beyond_source(r, "penetration_cm"); }},
    {"Pops", "pops", "", 1.0, "joint-frames that jump where the source does not",
     [](const json& r) { return number(at(r, "smoothness", "pops")); }},
    {"Jerk ratio", "", "", 2.0, "jerk over the source's",
     [](const json& r) { return number(at(r, "smoothness", "jerk_ratio")); }},
    {"Angular velocity ratio", "", "", 0.0, "largest rotation speed over the source's",
     [](const json& r) { return number(at(r, "smoothness", "max_angular_velocity_ratio")); }},
    {"Source beyond limits", "", "\u00b0", 0.0, "how far the source goes beyond the target's limits",
     [](const json& r) { return number(at(r, "limits", "source_excess_deg")); }},
    {"Longest on a limit", "", "%", 0.0, "share of time that some joint stands on its limit",
     [](const json& r) { return longest_at_limit(r); }},
    {"Read-back error", "", "mm", 0.1, "largest joint position error of the written file, read back",
     [](const json& r) { return 1e3 * number(at(r, "certificate", "joints_max_error_m")); }},
    {"Map confidence", "", "", 0.0, "how sure the skeletons' joints were identified, 0 to 1",
     [](const json& r) { return number(at(r, "map", "confidence")); }},
    {"Length", "", "s", 0.0, "duration of the result",
     [](const json& r) { return number(at(r, "output", "duration_s")); }},
};
// clang-format on

/// "bvh, cmu_bvh, 120 Hz, 38 joints, unit 0.0564 m"
std::string facts(const json& source) {
  std::string out = text(at(source, "format"));
  const auto add = [&](const std::string& fact) {
    if (!fact.empty()) out += (out.empty() ? "" : ", ") + fact;
  };
  add(text(at(source, "convention")));
  const double rate = number(at(source, "rate_hz")), joints = number(at(source, "joints")),
               unit = number(at(source, "unit_m"));
  if (std::isfinite(rate)) add(fmt::format("{:.4g} Hz", rate));
  if (std::isfinite(joints)) add(fmt::format("{:.0f} joints", joints));
  if (std::isfinite(unit)) add(fmt::format("unit {:.4g} m", unit));
  const std::string reader = text(at(source, "reader"));
  if (!reader.empty()) add("read by " + reader);
  return out;
}

std::string dump(const json& document) {
  return document.dump(-1, ' ', true, json::error_handler_t::replace);
}

Result<json> read_report(const fs::path& path) {
  const auto unreadable = [&](std::string message) {
    return Error{.code = "report-unreadable",
                 .message = std::move(message),
                 .file = path.string(),
                 .hint = "retarget the clip again"};
  };
  std::error_code ignored;
  if (fs::file_size(path, ignored) > kLargestReport) return unreadable("larger than 32 MB");
  auto bytes = read_text(path);
  if (!bytes) return unreadable(bytes.error().message);
  json report = json::parse(*bytes, nullptr, false);
  if (report.is_discarded()) return unreadable("no JSON document");
  if (text(at(report, "schema")) != "limber-report/1") return unreadable("no limber-report/1");
  return report;
}

}  // namespace

/// Makes one row.
class RowMaker {
 public:
  RowMaker(ReportRows& rows, const json& report) : rows_(rows), report_(report) {}

  json make(const fs::path& path, const fs::path& page_folder) {
    const std::string file = path.filename().string();
    const std::string stem = file.substr(0, file.size() - kSuffix.size());
    std::error_code ignored;
    row_["base"] = url_of((path.parent_path() / stem).lexically_relative(page_folder));
    row_["name"] = stem;
    row_["source"] = text(at(report_, "source", "path"));
    if (const std::string clip = text(at(report_, "source", "clip")); !clip.empty()) {
      row_["clip"] = clip;
    }
    const std::size_t sign = stem.rfind('@');
    row_["target"] = name(sign != std::string::npos ? stem.substr(sign + 1)
                                                    : text(at(report_, "target", "rig")));
    row_["status"] = status();
    if (fs::exists(path.parent_path() / (stem + ".png"), ignored)) row_["sheet"] = 1;
    row_["files"] = files(stem);
    row_["facts"] = facts(at(report_, "source"));
    add_findings("errors", 1);
    add_findings("warnings", 0);
    add_figures();
    add_limits();
    add_timeline();
    return std::move(row_);
  }

  int status() const {
    const std::string word = text(at(report_, "status"));
    return word == "pass" ? 0 : word == "warn" ? 1 : 2;
  }

 private:
  int name(const std::string& text) { return text.empty() ? -1 : rows_.index_of(text); }

  /// Formats of the outputs that lie beside the report under its own stem.
  json files(const std::string& stem) const {
    json out = json::array();
    for_each(at(report_, "output", "files"), [&](const json& file) {
      const std::string path = text(at(file, "path"), 300);
      if (!path.starts_with(stem + ".")) return;
      const std::string suffix = path.substr(stem.size() + 1);
      const bool plain = std::ranges::all_of(
          suffix, [](char c) { return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9'); });
      if (plain && suffix.size() <= 8 && suffix != "png") out.push_back(suffix);
    });
    return out;
  }

  void add_findings(const char* key, int error) {
    if (!row_.contains("findings")) row_["findings"] = json::array();
    for_each(at(report_, key), [&](const json& finding) {
      row_["findings"].push_back(
          {name(text(at(finding, "code"))), error, text(at(finding, "message"), kLongestMessage),
           name(text(at(finding, "joint"))), whole(at(finding, "frame"), -1)});
    });
  }

  void add_figures() {
    json values = json::array();
    for (const Metric& metric : kMetrics) values.push_back(brief(metric.value(report_)));
    row_["metrics"] = std::move(values);
    const std::int64_t frames = whole(at(report_, "output", "frames"));
    if (frames <= 0) return;
    row_["frames"] = frames;
    row_["seconds"] = brief(number(at(report_, "output", "duration_s")));
    json effectors = json::array();
    for_each(at(report_, "effectors"), [&](const json& effector) {
      effectors.push_back({name(text(at(effector, "name"))),
                           whole(at(effector, "reachable_frames")),
                           brief(number(at(effector, "position_error_mm", "p95"))),
                           brief(number(at(effector, "position_error_mm", "max"))),
                           brief(number(at(effector, "orientation_error_deg", "p95")))});
    });
    row_["effectors"] = std::move(effectors);
  }

  void add_limits() {
    const json& limits = at(report_, "limits");
    if (!at(limits, "at_limit").is_array()) return;
    row_["limits"] = json::array();
    for_each(at(limits, "at_limit"), [&](const json& joint) {
      row_["limits"].push_back({name(text(at(joint, "joint"))), whole(at(joint, "frames"))});
    });
    json bent = json::array();
    for_each(at(limits, "bent"), [&](const json& joint) {
      json classes = json::array();
      for_each(at(joint, "frames_by_excess"), [&](const json& n) { classes.push_back(whole(n)); });
      bent.push_back({name(text(at(joint, "joint"))), whole(at(joint, "frames")),
                      brief(number(at(joint, "max_deg"))), classes});
    });
    row_["bent"] = std::move(bent);
  }

  void add_timeline() {
    const json& timeline = at(report_, "timeline");
    if (!timeline.is_object()) return;
    json lines = json::object();
    const auto add = [&](const char* key, json value) {
      if (!value.is_null() && value != "") lines[key] = std::move(value);
    };
    add("error", line(at(timeline, "error_mm")));
    add("excess", line(at(timeline, "source_excess_deg")));
    add("limits", line(at(timeline, "joints_at_limit")));
    add("contacts", contacts(at(timeline, "left_contact"), at(timeline, "right_contact")));
    row_["timeline"] = std::move(lines);
  }

  ReportRows& rows_;
  const json& report_;
  json row_ = json::object();
};

int ReportRows::index_of(const std::string& name) {
  const auto [entry, is_new] = index_.emplace(name, static_cast<int>(names_.size()));
  if (is_new) names_.push_back(name);
  return entry->second;
}

std::string ReportRows::add(const fs::path& folder, const fs::path& relative,
                            const fs::path& page_folder) {
  auto report = read_report(folder / relative);
  if (!report) {
    ++unreadable_count_;
    if (unreadable_.size() < 20) unreadable_.push_back(report.error());
    const Error& e = report.error();
    report = json{{"status", "fail"},
                  {"errors", {{{"code", e.code}, {"message", "the report: " + e.message}}}}};
  }
  RowMaker maker(*this, *report);
  ++count_[maker.status()];
  return json_in_html(dump(maker.make(folder / relative, page_folder)));
}

std::string ReportRows::tables(std::string_view folder_name) const {
  json codes = json::object();
  for (const std::string& name : names_) {
    if (const CodeInfo* info = find_code(name)) codes[name] = {info->meaning, info->way_out};
  }
  json metrics = json::array();
  for (const Metric& metric : kMetrics) {
    metrics.push_back({{"label", metric.label},
                       {"short", metric.brief},
                       {"unit", metric.unit},
                       {"level", brief(metric.level)},
                       {"about", metric.about}});
  }
  return json_in_html(dump({{"folder", cut(std::string(folder_name), kLongestName)},
                            {"version", kVersion},
                            {"names", names_},
                            {"codes", codes},
                            {"metrics", metrics},
                            {"excess_edges_deg", kExcessEdgesDeg}}));
}

std::string json_in_html(std::string json) {
  std::string out;
  out.reserve(json.size());
  for (const char c : json) {
    if (c == '<' || c == '>' || c == '&') {
      out += fmt::format("\\u{:04x}", static_cast<int>(c));
    } else {
      out += c;
    }
  }
  return out;
}

std::string url_of(const fs::path& path) {
  static constexpr std::string_view kHex = "0123456789ABCDEF";
  std::string out;
  for (const char c : path.generic_string()) {
    const auto u = static_cast<unsigned char>(c);
    const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                       std::string_view("-._~/").find(c) != std::string_view::npos;
    if (plain) {
      out += c;
    } else {
      out += {'%', kHex[u >> 4], kHex[u & 15]};
    }
  }
  return out;
}

}  // namespace limber
