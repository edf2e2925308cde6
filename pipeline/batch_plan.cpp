#include "pipeline/batch_plan.h"

#include <fmt/format.h>
#include <fnmatch.h>
#include <utf8proc.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <sstream>
#include <system_error>
#include <unordered_map>
#include <unordered_set>

#include "importers/importer.h"
#include "pipeline/file_io.h"

namespace limber {
namespace {

namespace fs = std::filesystem;

/// What file systems may take for one name: case folded (Unicode, C+F), in normal form C.
std::string folded(const std::string& name) {
  utf8proc_uint8_t* out = nullptr;
  const auto options =
      static_cast<utf8proc_option_t>(UTF8PROC_STABLE | UTF8PROC_COMPOSE | UTF8PROC_CASEFOLD);
  const auto size = utf8proc_map(reinterpret_cast<const utf8proc_uint8_t*>(name.data()),
                                 static_cast<utf8proc_ssize_t>(name.size()), &out, options);
  const std::unique_ptr<utf8proc_uint8_t, decltype(&std::free)> keep(out, &std::free);
  if (size < 0) return case_folded(name);  // not UTF-8: bytes
  return {reinterpret_cast<const char*>(out), static_cast<std::size_t>(size)};
}

bool is_pattern(const std::string& text) { return text.find_first_of("*?[") != std::string::npos; }

bool is_readable_kind(const fs::path& path) {
  static const std::vector<std::string> kinds = readable_extensions();
  const std::string extension = case_folded(path.extension().string());
  return std::any_of(kinds.begin(), kinds.end(),
                     [&](const std::string& kind) { return extension == "." + kind; });
}

class Expansion {
 public:
  explicit Expansion(const BatchJob& job) : output_(normal(fs::absolute(job.output))) {}

  Result<void> add(const std::string& source, const std::string& pointer) {
    const std::size_t first = sources_.size(), repeated = repeated_;
    if (source.starts_with("@")) {
      if (auto r = add_list(source.substr(1)); !r) return r;
    } else if (is_pattern(source)) {
      add_pattern(source);
    } else if (std::error_code ignored; fs::is_directory(source, ignored)) {
      const fs::path base = fs::path(source) / "";
      walk(base, {"**", "*"}, base, true);
    } else {
      add_file(source, "");
    }
    std::sort(sources_.begin() + static_cast<std::ptrdiff_t>(first), sources_.end(),
              [](const BatchSource& a, const BatchSource& b) { return a.path < b.path; });
    if (sources_.size() > first || repeated_ > repeated) return {};
    return Error{.code = "job-no-sources",
                 .message = fmt::format("at {}: nothing matches '{}'", pointer, source),
                 .hint = "paths are relative to the job's folder"};
  }

  std::vector<BatchSource> take() { return std::move(sources_); }

 private:
  static std::string normal(const fs::path& path) {
    std::string text = path.lexically_normal().string();
    while (text.size() > 1 && text.ends_with('/')) text.pop_back();
    return text;
  }

  Result<void> add_list(const std::string& path) {
    auto text = read_text(path);
    if (!text) return text.error();
    std::istringstream lines(*text);
    for (std::string line; std::getline(lines, line);) {
      if (line.ends_with('\r')) line.pop_back();
      if (!line.empty()) add_file(line, "");
    }
    return {};
  }

  void add_pattern(const std::string& pattern) {
    fs::path base;
    std::vector<std::string> rest;
    for (const fs::path& part : fs::path(pattern)) {
      if (rest.empty() && !is_pattern(part.string())) {
        base /= part;
      } else {
        rest.push_back(part.string());
      }
    }
    walk(base, rest, base, false);
  }

  /// Matches the parts of a pattern from the left; "**" stands for any folders, or none.
  void walk(const fs::path& folder, std::vector<std::string> parts, const fs::path& base,
            bool readable_only) {
    const bool any_depth = parts.front() == "**";
    if (any_depth && parts.size() > 1) {
      walk(folder, {parts.begin() + 1, parts.end()}, base, readable_only);
    }
    const bool last = parts.size() == 1;
    std::error_code error;
    for (fs::directory_iterator it(folder.empty() ? "." : folder, error), end; it != end;
         it.increment(error)) {
      const std::string name = it->path().filename().string();
      if (name.starts_with(".")) continue;
      const fs::path path = folder / name;
      std::error_code ignored;
      const bool is_folder = it->is_directory(ignored);
      if (is_folder && normal(fs::absolute(path)) == output_) continue;
      if (any_depth) {  // links are not followed: they may lead in circles
        if (is_folder && !it->is_symlink(ignored)) walk(path, parts, base, readable_only);
        if (!is_folder && last) add_match(path, base, readable_only);
      } else if (::fnmatch(parts.front().c_str(), name.c_str(), 0) == 0) {
        if (is_folder && !last) walk(path, {parts.begin() + 1, parts.end()}, base, readable_only);
        if (!is_folder && last) add_match(path, base, readable_only);
      }
    }
  }

  void add_match(const fs::path& path, const fs::path& base, bool readable_only) {
    if (readable_only && !is_readable_kind(path)) return;
    const fs::path folder = path.parent_path().lexically_relative(base.empty() ? "." : base);
    std::string below = base.empty() ? path.parent_path().string() : folder.string();
    if (below == ".") below.clear();
    add_file(path.string(), below.empty() ? "" : below + "/");
  }

  void add_file(const std::string& path, const std::string& folder) {
    const std::string plain = normal(path);
    if (!seen_.insert(plain).second) {
      ++repeated_;
      return;
    }
    sources_.push_back({plain, folder, safe_name(fs::path(plain).stem().string())});
  }

  std::string output_;
  std::vector<BatchSource> sources_;
  std::unordered_set<std::string> seen_;
  std::size_t repeated_ = 0;
};

Result<void> check_collisions(const BatchPlan& plan) {
  std::unordered_map<std::string, std::size_t> taken;
  taken.reserve(plan.size());
  for (std::size_t i = 0; i < plan.size(); ++i) {
    const auto [other, fresh] = taken.emplace(folded(plan.name(i)), i);
    if (fresh) continue;
    const bool one_source = plan.source(i).path == plan.source(other->second).path;
    return Error{.code = "output-collision",
                 .message = one_source ? fmt::format("two targets are called '{}'",
                                                     plan.labels[plan.target(i)])
                                       : fmt::format("'{}' and '{}' would both become '{}'",
                                                     plan.source(other->second).path,
                                                     plan.source(i).path, plan.name(i)),
                 .hint = "rename one of them, or give them outputs of their own in two jobs"};
  }
  return {};
}

}  // namespace

Result<BatchPlan> plan_batch(const BatchJob& job, std::vector<std::string> labels) {
  Expansion expansion(job);
  for (std::size_t i = 0; i < job.sources.size(); ++i) {
    if (auto r = expansion.add(job.sources[i], fmt::format("/sources/{}", i)); !r) return r.error();
  }
  BatchPlan plan{expansion.take(), std::move(labels)};
  if (auto r = check_collisions(plan); !r) return r.error();
  return plan;
}

}  // namespace limber
