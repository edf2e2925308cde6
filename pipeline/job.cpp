#include "pipeline/job.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <set>

#include "pipeline/clip_job.h"
#include "pipeline/file_io.h"
#include "pipeline/map_file.h"
#include "pipeline/reading_budget.h"

namespace limber {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

/// Clips that the options ask for.
Result<std::vector<const Clip*>> chosen_clips(const Imported& imported, const JobOptions& options) {
  std::vector<const Clip*> clips;
  std::string names;
  for (const Clip& clip : imported.clips) {
    names += (names.empty() ? "" : ", ") + clip.name;
    if (!options.clip || *options.clip == clip.name) clips.push_back(&clip);
  }
  if (!clips.empty()) return clips;
  if (imported.clips.empty()) {
    return Error{.code = "clip-none",
                 .message = "the file holds no motion",
                 .hint = "a source needs an animation; a character alone can be a target"};
  }
  return Error{.code = "clip-unknown",
               .message = "the file has no clip of that name",
               .hint = "it has: " + names};
}

Result<Source> load_source(const std::string& path, const JobOptions& options) {
  Source source;
  source.path = path;
  auto bytes = read_file(path);
  if (!bytes) return in_file(bytes.error(), path);
  source.sha256 = sha256_hex(*bytes);
  auto imported = import_within_budget(path, options.import);
  if (!imported) return in_file(imported.error(), path);
  source.imported = std::move(*imported);
  RoleOverrides roles;
  if (options.map) {
    auto map = read_map_file(*options.map);
    if (!map) return map.error();
    roles = map->source;
  }
  auto figure = identify_figure(source.imported.character, roles);
  if (!figure) {
    return in_file(figure.error(), path);
  }
  source.figure = std::move(*figure);
  return source;
}

/// Files of an earlier run with the same stem go first: outputs are replaced, never mixed.
void remove_outputs(const fs::path& folder, const std::string& stem) {
  for (const char* suffix : {".glb", ".bvh", ".png", ".map.json", ".report.json", ".gap.rig.json",
                             ".gap.targets.json"}) {
    std::error_code ignored;
    fs::remove(folder / (stem + suffix), ignored);
  }
}

ClipSummary refuse(const std::string& path, const std::string& stem, const Target* target,
                   const Error& error, const JobOptions& options, const std::string& clip = "") {
  remove_outputs(options.output, stem);
  ClipRecord record;
  record.status = Status::fail;
  record.source_path = path;
  record.source_clip = clip;
  record.target = target;
  record.errors.push_back(in_file(error, path));
  Result<void> written;
  if (error.code == "map-not-a-figure" && target != nullptr) {
    if (auto imported = import_within_budget(path, options.import)) {
      written = write_whole(options.output / (stem + ".map.json"),
                            map_json({path, &imported->character, nullptr},
                                     {target->path, &target->character, &target->figure}));
    }
  }
  if (written) {
    written = write_whole(options.output / (stem + ".report.json"), report_json(record));
  }
  return {.source = path,
          .clip = clip,
          .stem = stem,
          .status = Status::fail,
          .code = error.code,
          .message = error.message,
          .unwritten = written ? "" : written.error().message};
}

/// Names of the clips' outputs, "walk@hero" or "walk#CLIP@hero", whatever a file system thinks of
/// case.
std::vector<std::string> output_names(const Source& source, const std::vector<const Clip*>& clips,
                                      const std::string& stem, const Target& target) {
  std::vector<std::string> names;
  std::set<std::string> used;
  for (const Clip* clip : clips) {
    std::string name = stem;
    if (source.imported.clips.size() > 1) {
      name += "#" + safe_name(clip->name);
      const std::string base = name;
      for (int k = 2; !used.insert(case_folded(name)).second; ++k) {
        name = fmt::format("{}-{}", base, k);
      }
    }
    names.push_back(name + "@" + safe_name(target.label));
  }
  return names;
}

/// A clip of several, in a process of its own.
ClipSummary run_apart(const Source& source, const Clip& clip, const std::string& name,
                      const Target& target, const JobOptions& options) {
  const auto answer = run_part(
      [&] { return to_json({run_clip(source, clip, name, target, options)}); }, options.limits);
  std::vector<ClipSummary> summaries;
  if (answer) summaries = summaries_from_json(*answer);
  if (summaries.size() == 1) return std::move(summaries.front());
  const Error error =
      answer ? Error{.code = "process-failed", .message = "the clip's process gave no answer"}
             : answer.error();
  return refuse(source.path, name, &target, error, options, clip.name);
}

}  // namespace

Result<TargetOptions> target_options(const JobOptions& options) {
  TargetOptions out;
  out.limits = options.retarget.limits;
  out.import.reader = options.import.reader;
  if (options.map) {
    auto map = read_map_file(*options.map);
    if (!map) return map.error();
    out.roles = map->target;
  }
  return out;
}

std::vector<ClipSummary> run_source(const std::string& source_path, const std::string& stem,
                                    const Target& target, const JobOptions& options) {
  const std::string plain = stem + "@" + safe_name(target.label);
  auto source = load_source(source_path, options);
  if (!source) return {refuse(source_path, plain, &target, source.error(), options)};
  auto clips = chosen_clips(source->imported, options);
  if (!clips) return {refuse(source_path, plain, &target, clips.error(), options)};
  const std::vector<std::string> names = output_names(*source, *clips, stem, target);
  for (const std::string& name : names) remove_outputs(options.output, name);
  if (clips->size() == 1) {
    return {run_clip(*source, *clips->front(), names.front(), target, options)};
  }
  std::vector<ClipSummary> out;
  for (std::size_t i = 0; i < names.size(); ++i) {
    out.push_back(run_apart(*source, *(*clips)[i], names[i], target, options));
  }
  return out;
}

ClipSummary record_death(const std::string& source_path, const std::string& stem,
                         const std::string& target_label, const Error& error,
                         const JobOptions& options) {
  return refuse(source_path, stem + "@" + safe_name(target_label), nullptr, error, options);
}

std::string to_json(const std::vector<ClipSummary>& summaries) {
  json out = json::array();
  for (const ClipSummary& s : summaries) {
    out.push_back({{"source", s.source},
                   {"clip", s.clip},
                   {"stem", s.stem},
                   {"status", static_cast<int>(s.status)},
                   {"code", s.code},
                   {"message", s.message},
                   {"error_p95_mm", s.error_p95_mm},
                   {"violations", s.violations},
                   {"frames", s.frames},
                   {"unwritten", s.unwritten}});
  }
  return out.dump(-1, ' ', false, json::error_handler_t::replace);
}

std::vector<ClipSummary> summaries_from_json(const std::string& text) {
  std::vector<ClipSummary> out;
  const json document = json::parse(text, nullptr, false);
  if (!document.is_array()) return out;
  for (const json& s : document) {
    if (!s.is_object()) return {};
    const auto number = [&](const char* key) {
      return s.contains(key) && s[key].is_number() ? s[key].get<double>() : 0.0;
    };
    const auto text_of = [&](const char* key) {
      return s.contains(key) && s[key].is_string() ? s[key].get<std::string>() : std::string();
    };
    ClipSummary clip;
    clip.source = text_of("source");
    clip.clip = text_of("clip");
    clip.stem = text_of("stem");
    const double status = number("status");
    clip.status = status == 0.0 ? Status::pass : status == 1.0 ? Status::warn : Status::fail;
    clip.code = text_of("code");
    clip.message = text_of("message");
    clip.unwritten = text_of("unwritten");
    clip.error_p95_mm = number("error_p95_mm");
    clip.violations = static_cast<std::int64_t>(number("violations"));
    clip.frames = static_cast<std::int64_t>(number("frames"));
    out.push_back(std::move(clip));
  }
  return out;
}

}  // namespace limber
