#include "pipeline/commands.h"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <set>

#include "exporters/exporter.h"
#include "importers/rig_json.h"
#include "pipeline/codes.h"
#include "pipeline/dressed_rig.h"
#include "pipeline/embedded.h"
#include "pipeline/file_io.h"
#include "pipeline/reading_budget.h"
#include "pipeline/sheets.h"
#include "pipeline/version.h"

namespace limber {
namespace {

namespace fs = std::filesystem;
using json = nlohmann::ordered_json;

std::string dump(const json& document) {
  return document.dump(2, ' ', false, json::error_handler_t::replace);
}

/// Finger joints that turn by more than two degrees over the first clip.
std::int64_t moving_fingers(const Imported& imported, const Figure& figure) {
  if (imported.clips.empty()) return 0;
  const Clip& clip = imported.clips.front();
  std::int64_t moving = 0;
  for (int r = 0; r < kRoleCount; ++r) {
    const std::int32_t j = figure.joint[r];
    if (j == kNoJoint || !is_finger(role_at(r))) continue;
    double most = 0.0;
    for (std::int64_t f = 1; f < clip.frames(); ++f) {
      most =
          std::max(most, rotation_angle(clip.frame(0)[j].rotation(), clip.frame(f)[j].rotation()));
    }
    moving += most > 2.0 * M_PI / 180.0;
  }
  return moving;
}

bool has_any_fingers(const Figure& figure) {
  return figure.has_fingers(Side::left) || figure.has_fingers(Side::right);
}

json inspect(const std::string& file, const ImportOptions& options) {
  json out{{"file", file}};
  auto imported = import_within_budget(file, options);
  if (!imported) {
    const Error& e = imported.error();
    out["error"] = {{"code", e.code}, {"message", e.message}, {"hint", e.hint}};
    if (!e.joint.empty()) out["error"]["joint"] = e.joint;
    if (e.frame >= 0) out["error"]["frame"] = e.frame;
    return out;
  }
  const SourceFacts& facts = imported->facts;
  out["format"] = facts.format;
  out["reader"] = facts.reader;
  out["reader_reason"] = facts.reader_reason;
  out["joints"] = facts.joints;
  out["frames"] = facts.frames;
  out["rate_hz"] = facts.rate_hz;
  out["unit_m"] = facts.unit_m;
  out["unit_evidence"] = facts.unit_evidence;
  out["up"] = facts.up;
  out["reference_frame_dropped"] = facts.reference_frame_dropped;
  const auto figure = identify_figure(imported->character);
  out["convention"] = figure ? json(figure->convention) : json(nullptr);
  out["figure"] = !figure ? "none" : figure->is_body() ? "body" : "hand";
  out["confidence"] = figure ? figure->confidence : 0.0;
  out["fingers"] = figure.ok() && has_any_fingers(*figure);
  out["fingers_moving"] = figure ? moving_fingers(*imported, *figure) : 0;
  out["meshes"] = imported->character.meshes.size();
  out["morph_targets"] = imported->character.morph_targets.size();
  out["clips"] = json::array();
  for (const Clip& clip : imported->clips) {
    out["clips"].push_back({{"name", clip.name},
                            {"frames", clip.frames()},
                            {"rate_hz", clip.rate_hz},
                            {"duration_s", clip.duration_s()},
                            {"interpolation", clip.interpolation}});
  }
  out["joint_names"] = imported->character.skeleton.names;
  out["warnings"] = json::array();
  for (const Warning& w : imported->warnings) {
    json entry{{"code", w.code}, {"message", w.message}};
    if (!w.joint.empty()) entry["joint"] = w.joint;
    if (w.frame >= 0) entry["frame"] = w.frame;
    out["warnings"].push_back(std::move(entry));
  }
  return out;
}

void print_inspection(const json& facts) {
  fmt::print("{}\n", facts["file"].get<std::string>());
  fmt::print("  {} read by {}; {} joints, {} frames at {:g} Hz, {} clips\n",
             facts["format"].get<std::string>(), facts["reader"].get<std::string>(),
             facts["joints"].get<std::int64_t>(), facts["frames"].get<std::int64_t>(),
             facts["rate_hz"].get<double>(), facts["clips"].size());
  fmt::print("  unit {:g} m ({}), up {}\n", facts["unit_m"].get<double>(),
             facts["unit_evidence"].get<std::string>(), facts["up"].get<std::string>());
  fmt::print("  figure: {}, convention {}, fingers {}\n", facts["figure"].get<std::string>(),
             facts["convention"].is_null() ? "none" : facts["convention"].get<std::string>(),
             !facts["fingers"].get<bool>()
                 ? "none"
                 : fmt::format("yes, {} move", facts["fingers_moving"].get<std::int64_t>()));
  for (const auto& w : facts["warnings"]) {
    fmt::print("  warning {}: {}\n", w["code"].get<std::string>(), w["message"].get<std::string>());
  }
}

/// Runs work in a jailed process and parses the JSON it returns; a crash becomes an `error` entry.
json isolated_json(const std::function<json()>& work, const JailRules& rules) {
  auto answer = run_isolated([&] { return dump(work()); }, {.may = rules});
  if (answer) return json::parse(*answer, nullptr, false);
  const Error& e = answer.error();
  return {{"error", {{"code", e.code}, {"message", e.message}, {"hint", e.hint}}}};
}

Error error_of(const json& entry, const std::string& file) {
  const json& e = entry["error"];
  return {.code = e["code"],
          .message = e["message"],
          .file = file,
          .joint = e.value("joint", ""),
          .frame = e.value("frame", std::int64_t(-1)),
          .hint = e.value("hint", "")};
}

}  // namespace

void print_error(const Error& error) {
  std::string line = "limber: ";
  if (!error.file.empty()) line += error.file + ": ";
  line += error.message;
  if (!error.joint.empty()) line += fmt::format(" (joint {})", error.joint);
  if (error.frame >= 0) line += fmt::format(" (frame {})", error.frame);
  line += fmt::format(" [{}]", error.code);
  fmt::print(stderr, "{}\n", line);
  if (!error.hint.empty()) fmt::print(stderr, "  {}\n", error.hint);
}

void print_error(const Error& error, bool as_json) {
  print_error(error);
  if (!as_json) return;
  fmt::print("{}\n", dump({{"error",
                            {{"code", error.code},
                             {"message", error.message},
                             {"file", error.file},
                             {"joint", error.joint},
                             {"hint", error.hint}}}}));
}

int inspect_command(const InspectArgs& args) {
  json all = json::array();
  bool failed = false;
  for (const std::string& file : args.files) {
    json facts = isolated_json([&] { return inspect(file, args.import); }, {.reads = {file}});
    if (!facts.contains("file")) facts["file"] = file;
    if (facts.contains("error")) {
      failed = true;
      print_error(error_of(facts, file));
    } else if (!args.json) {
      print_inspection(facts);
    }
    all.push_back(std::move(facts));
  }
  if (args.json) fmt::print("{}\n", dump(all.size() == 1 ? all[0] : all));
  return failed ? kSomeFailed : kAllPassed;
}

int map_command(const MapArgs& args) {
  const json answer = isolated_json(
      [&]() -> json {
        const auto failed = [](const Error& e, const std::string& file) {
          return json{
              {"error",
               {{"code", e.code}, {"message", e.message}, {"hint", e.hint}, {"joint", e.joint}}},
              {"file", e.file.empty() ? file : e.file}};
        };
        TargetOptions options;
        options.import.reader = args.import.reader;
        const auto target = load_target(args.target, options);
        if (!target) {
          json out = failed(target.error(), args.target);
          out["usage"] = true;
          return out;
        }
        const auto source = import_within_budget(args.source, args.import);
        if (!source) return failed(source.error(), args.source);
        const auto figure = identify_figure(source->character);
        const MapSide from{args.source, &source->character, figure ? &*figure : nullptr};
        json map = json::parse(map_json(from, {args.target, &target->character, &target->figure}));
        if (figure) return {{"map", map}};
        json out = failed(figure.error(), args.source);
        out["map"] = map;
        return out;
      },
      {.reads = {args.source, args.target}});
  if (answer.contains("map")) {
    const std::string text = dump(answer["map"]) + "\n";
    if (!args.output.empty()) {
      if (auto r = write_whole(args.output, text); !r) {
        print_error(r.error());
        return kEnvironment;
      }
    }
    if (args.json) fmt::print("{}", text);
    if (!args.json && !answer.contains("error")) {
      for (const auto& chain : answer["map"]["chains"]) {
        fmt::print("{:14} {:4.2f}  {} -> {}\n", chain["name"].get<std::string>(),
                   chain["confidence"].get<double>(), chain["source"].dump(),
                   chain["target"].dump());
      }
    }
  }
  if (!answer.contains("error")) return kAllPassed;
  print_error(error_of(answer, answer.value("file", args.source)),
              args.json && !answer.contains("map"));
  return answer.value("usage", false) ? kUsage : kSomeFailed;
}

int rig_list_command(bool as_json) {
  json all = json::array();
  for (const std::string& name : shipped_rig_names()) {
    const auto rig = shipped_rig(name);
    if (!rig) continue;
    all.push_back({{"name", name},
                   {"joints", rig->size()},
                   {"dof", dof_count(*rig)},
                   {"description", rig->description}});
    if (!as_json) {
      fmt::print("{:16} {:3} joints, {:3} DOF  {}\n", name, rig->size(), dof_count(*rig),
                 rig->description);
    }
  }
  if (as_json) fmt::print("{}\n", dump(all));
  return kAllPassed;
}

int isolated_command(const std::function<int()>& work, const JailRules& rules) {
  const auto answer = run_isolated([&] { return std::to_string(work()); }, {.may = rules});
  if (answer) return std::atoi(answer->c_str());
  print_error(answer.error());
  return kUsage;
}

namespace {

int rig_new(const RigNewArgs& args) {
  TargetOptions options;
  options.import = args.import;
  auto target = load_target(args.character, options);
  if (!target) {
    print_error(target.error());
    return kUsage;
  }
  target->rig.description =
      "limits of " + fs::path(args.character).filename().string() + " from its calibrated T-pose";
  if (auto r = write_whole(args.output, write_rig_json(target->rig)); !r) {
    print_error(r.error());
    return kEnvironment;
  }
  fmt::print(stderr, "{}: {} joints, {} DOF, T-pose from {} ({:.1f} degrees mean turn)\n",
             args.output.string(), target->rig.size(), dof_count(target->rig),
             target->calibration.reference, target->calibration.residual_deg);
  return kAllPassed;
}

int rig_show(const RigShowArgs& args) {
  const auto dressed = dressed_rig(args.rig);
  if (!dressed) {
    print_error(dressed.error());
    return kUsage;
  }
  if (args.json) fmt::print("{}\n", write_rig_json(dressed->rig));
  for (const RigJoint& joint : dressed->rig.joints) {
    if (args.json) break;
    std::string limits;
    for (std::int32_t k = 0; k < dof_count(joint.type) && joint.limited(); ++k) {
      limits += fmt::format(" [{:.0f}, {:.0f}]", joint.limits[k].min * 180.0 / M_PI,
                            joint.limits[k].max * 180.0 / M_PI);
    }
    fmt::print("{:28} {:10}{}\n", joint.name, to_string(joint.type), limits);
  }
  if (args.sheet.empty()) return kAllPassed;
  const auto png = draw_rig_sheet(*dressed);
  const auto written = png ? write_whole(args.sheet, *png) : Result<void>(png.error());
  if (written) return kAllPassed;
  print_error(written.error());
  return kEnvironment;
}

}  // namespace

int rig_new_command(const RigNewArgs& args) {
  return isolated_command([&] { return rig_new(args); },
                          {.reads = {args.character}, .writes = folder_of(args.output)});
}

int rig_show_command(const RigShowArgs& args) {
  return isolated_command([&] { return rig_show(args); },
                          {.reads = {args.rig}, .writes = folder_of(args.sheet)});
}

int sheet_command(const SheetArgs& args) {
  bool failed = false;
  for (std::size_t i = 0; i < args.files.size(); ++i) {
    fs::path output = args.output;
    if (args.files.size() > 1) {
      output.replace_filename(
          fmt::format("{}-{}{}", output.stem().string(), i + 1, output.extension().string()));
    }
    const json answer = isolated_json(
        [&]() -> json {
          const auto failed_with = [](const Error& e) {
            return json{{"error", {{"code", e.code}, {"message", e.message}, {"hint", e.hint}}}};
          };
          const auto imported = import_within_budget(args.files[i], args.import);
          if (!imported) return failed_with(imported.error());
          const Clip* clip = imported->clips.empty() ? nullptr : &imported->clips.front();
          const auto png = draw_file_sheet(imported->character, clip,
                                           fs::path(args.files[i]).filename().string());
          if (!png) return failed_with(png.error());
          const auto r = write_whole(output, *png);
          if (r) return json::object();
          json out = failed_with(r.error());
          out["file"] = output.string();
          return out;
        },
        {.reads = {args.files[i]}, .writes = folder_of(output)});
    if (answer.contains("error")) {
      failed = true;
      print_error(error_of(answer, answer.value("file", args.files[i])));
    } else {
      fmt::print(stderr, "{}\n", output.string());
    }
  }
  return failed ? kSomeFailed : kAllPassed;
}

int explain_command(const std::string& code) {
  if (code.empty()) {
    for (const CodeInfo& info : all_codes()) fmt::print("{:30} {}\n", info.code, info.meaning);
    return kAllPassed;
  }
  const CodeInfo* info = find_code(code);
  if (info == nullptr) {
    print_error({.code = "code-unknown",
                 .message = "'" + code + "' is no code of Limber",
                 .hint = "`limber explain` lists them all"});
    return kUsage;
  }
  fmt::print("{}\n  {}\n  {}\n", info->code, info->meaning, info->way_out);
  return kAllPassed;
}

}  // namespace limber
