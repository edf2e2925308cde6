#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <csignal>
#include <exception>
#include <sstream>

#include "pipeline/batch_command.h"
#include "pipeline/bench_command.h"
#include "pipeline/commands.h"
#include "pipeline/doctor.h"
#include "pipeline/pose_command.h"
#include "pipeline/report_command.h"
#include "pipeline/version.h"

namespace limber {
namespace {

/// Units as people write them, in metres.
const std::map<std::string, double> kUnits = {
    {"m", 1.0},     {"dm", 0.1},      {"cm", 0.01},   {"mm", 0.001},
    {"in", 0.0254}, {"inch", 0.0254}, {"ft", 0.3048}, {"cmu", 0.0254 / 0.45}};

struct ImportFlags {
  std::string reader = "auto", unit, up;

  void add(CLI::App& app) {
    app.add_option("--reader", reader, "auto: exact readers for BVH and glTF, assimp for the rest")
        ->check(CLI::IsMember({"auto", "assimp"}))
        ->capture_default_str();
    app.add_option("--unit", unit, "length unit of the file: m, dm, cm, mm, in, ft, cmu");
    app.add_option("--up", up, "up axis of the file")->check(CLI::IsMember({"y", "z"}));
  }
  ImportOptions options() const {
    ImportOptions out;
    if (reader == "assimp") out.reader = ReaderChoice::assimp;
    if (!unit.empty()) {
      const auto known = kUnits.find(unit);
      if (known == kUnits.end()) throw CLI::ValidationError("--unit", "unknown unit " + unit);
      out.unit_m = known->second;
    }
    if (!up.empty()) out.up = up[0];
    return out;
  }
};

std::pair<std::int64_t, std::int64_t> parse_range(const std::string& text) {
  std::istringstream in(text);
  std::int64_t first = 0, last = 0;
  char colon = 0;
  if (!(in >> first >> colon >> last) || colon != ':' || !in.eof()) {
    throw CLI::ValidationError("--range", "expected FIRST:LAST, e.g. 100:250");
  }
  return {first, last};
}

ReferenceChoice parse_reference(const std::string& text) {
  ReferenceChoice choice;
  if (text.empty()) return choice;
  if (text == "rest") {
    choice.kind = ReferenceChoice::rest;
  } else if (text == "bind") {
    choice.kind = ReferenceChoice::bind;
  } else if (text == "motion") {
    choice.kind = ReferenceChoice::motion;
  } else if (text.rfind("frame:", 0) == 0) {
    choice.kind = ReferenceChoice::frame;
    std::istringstream in(text.substr(6));
    if (!(in >> choice.frame_index) || choice.frame_index < 0) {
      throw CLI::ValidationError("--reference", "expected frame:N");
    }
  } else {
    throw CLI::ValidationError("--reference", "expected rest, bind, frame:N or motion");
  }
  return choice;
}

SolverChoice solver_named(const std::string& name) {
  return name == "pgs"     ? SolverChoice::pgs
         : name == "ceres" ? SolverChoice::ceres
                           : SolverChoice::pgs_paper;
}

class Program {
 public:
  Program()
      : app_("Limber retargets animation onto joint-limited rigs and characters, and proves it.") {
    app_.set_version_flag("--version", std::string("limber ") + kVersion);
    app_.require_subcommand(1);
    add_inspect();
    add_map();
    add_rig();
    add_retarget();
    add_batch();
    add_pose();
    add_validate();
    add_sheet();
    add_report();
    add_bench();
    add_doctor();
  }

  int run(int argc, char** argv) {
    try {
      app_.parse(argc, argv);
    } catch (const CLI::ParseError& e) {
      return app_.exit(e) == 0 ? kAllPassed : kUsage;
    }
    return code_;
  }

  /// What flags of `limber retarget` mean; nothing is run.
  static Result<JobOptions> parse_retarget_flags(const std::vector<std::string>& flags) {
    Program program;
    program.parse_only_ = true;
    std::vector<std::string> arguments(flags.rbegin(), flags.rend());  // CLI11 takes the last first
    arguments.insert(arguments.end(), {"output", "-o", "target", "--target", "source", "retarget"});
    try {
      program.app_.parse(arguments);
    } catch (const CLI::ParseError& e) {
      return Error{
          .code = "job-field", .message = e.what(), .hint = "see `limber retarget --help`"};
    }
    return program.retarget_.job;
  }

 private:
  void add_inspect() {
    auto* c = app_.add_subcommand("inspect", "what a file holds: joints, frames, unit, convention");
    c->add_option("files", inspect_.files, "files to read")->required();
    c->add_flag("--json", inspect_.json, "one JSON document on standard output");
    inspect_import_.add(*c);
    c->callback([this] {
      inspect_.import = inspect_import_.options();
      code_ = inspect_command(inspect_);
    });
  }

  void add_map() {
    auto* c = app_.add_subcommand("map", "which joint is what, and a map file to edit");
    c->add_option("source", map_.source)->required();
    c->add_option("target", map_.target)->required();
    c->add_option("-o,--output", map_.output, "write the map here");
    c->add_flag("--json", map_.json, "print the map");
    map_import_.add(*c);
    c->callback([this] {
      map_.import = map_import_.options();
      code_ = map_command(map_);
    });
  }

  void add_rig() {
    auto* rig = app_.add_subcommand("rig", "joint-limited rigs");
    rig->require_subcommand(1);
    auto* list = rig->add_subcommand("list", "the shipped rigs");
    list->add_flag("--json", rig_json_);
    list->callback([this] { code_ = rig_list_command(rig_json_); });
    auto* make = rig->add_subcommand("new", "a rig with anatomical limits for a character");
    make->add_option("character", rig_new_.character)->required();
    make->add_option("-o,--output", rig_new_.output, "rig file to write")->required();
    rig_import_.add(*make);
    make->callback([this] {
      rig_new_.import = rig_import_.options();
      code_ = rig_new_command(rig_new_);
    });
    auto* show = rig->add_subcommand("show", "a rig's joints and limits");
    show->add_option("rig", rig_show_.rig)->required();
    show->add_option("-o,--output", rig_show_.sheet, "draw it here (PNG)");
    show->add_flag("--json", rig_show_.json, "the rig in ikrig/1");
    show->callback([this] { code_ = rig_show_command(rig_show_); });
  }

  void add_retarget() {
    auto* c = app_.add_subcommand("retarget", "retarget clips onto a rig or a character");
    c->add_option("sources", retarget_.sources, "animation files")->required();
    c->add_option("--target", retarget_.target,
                  "a shipped rig's name, a rig JSON, a character or a BVH")
        ->required();
    c->add_option("-o,--output", retarget_.job.output, "folder for outputs")->required();
    c->add_option("--clip", clip_, "only the clip of this name");
    c->add_option("--range", range_, "only the frames FIRST:LAST");
    c->add_option("--map", map_file_, "a map file made by `limber map`");
    c->add_option("--rate", rate_, "sample rate of the output, 1 to 1000 Hz")
        ->check(CLI::Range(1.0, 1000.0));
    c->add_option("--formats", formats_, "comma-separated: glb, bvh")
        ->delimiter(',')
        ->check(CLI::IsMember({"glb", "bvh"}));
    const auto on_off = CLI::IsMember({"on", "off"});
    c->add_option("--limits", limits_, "keep joints within their limits")->check(on_off);
    c->add_option("--contacts", contacts_, "pin feet that stand")->check(on_off);
    c->add_option("--collision", collision_, "keep body parts apart")->check(on_off);
    c->add_option("--cycle", cycle_, "solve clips that go round as cycles")->check(on_off);
    c->add_option("--root", root_, "root motion: scale with leg length, keep, or in-place")
        ->check(CLI::IsMember({"scale", "keep", "in-place"}));
    c->add_option("--refine", refine_,
                  "none; frame: measure the gap to Ceres; clip: the whole clip's optimum")
        ->check(CLI::IsMember({"none", "frame", "clip"}));
    c->add_option("--solver", solver_)->check(CLI::IsMember({"pgs", "pgs-paper", "ceres"}));
    c->add_option("--reference", reference_, "source's T-pose from: rest, bind, frame:N, motion");
    c->add_option("--fingers", fingers_, "fingers that the source lacks")
        ->check(CLI::IsMember({"rest", "curl"}));
    c->add_option("--gates", retarget_.gates,
                  "levels that figures must keep: a file, or `default`; exit code 4 if missed");
    c->add_option("--junit", retarget_.junit, "write the clips' verdicts here (JUnit XML)");
    c->add_option("--sandbox", sandbox_)->check(CLI::IsMember({"auto", "require", "off"}));
    c->add_option("-j,--jobs", retarget_.processes, "clips at a time; 0: one per core")
        ->check(CLI::NonNegativeNumber);
    c->add_flag("--json", retarget_.json, "one JSON document on standard output");
    retarget_import_.add(*c);
    c->callback([this] { code_ = run_retarget(); });
  }

  int run_retarget() {
    JobOptions& job = retarget_.job;
    job.import = retarget_import_.options();
    job.reference = parse_reference(reference_);
    if (!clip_.empty()) job.clip = clip_;
    if (!range_.empty()) job.range = parse_range(range_);
    if (std::isnan(rate_)) throw CLI::ValidationError("--rate", "expected 1 to 1000");
    if (rate_ > 0.0) job.rate_hz = rate_;
    if (!map_file_.empty()) job.map = map_file_;
    if (!formats_.empty()) job.formats = formats_;
    RetargetOptions& options = job.retarget;
    options.limits = limits_ == "on";
    options.collision = collision_ == "on";
    options.cycles = cycle_ == "on";
    options.effectors.contacts = contacts_ == "on";
    options.effectors.root = root_ == "scale"  ? RootMode::scale
                             : root_ == "keep" ? RootMode::keep
                                               : RootMode::in_place;
    options.effectors.fingers = fingers_ == "curl" ? FingerMode::curl : FingerMode::rest;
    options.refine = refine_ == "none"   ? RefineMode::none
                     : refine_ == "clip" ? RefineMode::clip
                                         : RefineMode::frame;
    options.solver = solver_named(solver_);
    job.sandbox = sandbox_ == "auto"  ? SandboxMode::automatic
                  : sandbox_ == "off" ? SandboxMode::off
                                      : SandboxMode::require;
    return parse_only_ ? kAllPassed : retarget_command(retarget_);
  }

  void add_batch() {
    auto* c = app_.add_subcommand("batch", "retarget many clips onto many targets, as a job says");
    c->add_option("job", batch_.job, "limber-job/1, see assets/data/schemas/job.schema.json")
        ->required();
    c->add_option("-j,--jobs", batch_.processes, "clips at a time; 0: one per core")
        ->check(CLI::NonNegativeNumber);
    c->add_option("--shard", batch_.shard, "I/N: the I-th of N parts, counted from 1");
    c->add_flag("--resume", batch_.resume, "leave out what is finished and has not changed");
    c->add_flag("--verify", batch_.verify, "resume, but read every input and output again");
    c->add_flag("--retry-failed", batch_.retry_failed, "resume, and run failed clips again");
    c->add_option("--junit", batch_.junit, "write the clips' verdicts here (JUnit XML)");
    c->add_flag("--dry-run", batch_.dry_run, "list every output and stop");
    c->add_flag("--json", batch_.json, "events on standard output, one JSON document a line");
    c->callback([this] {
      batch_.parse_flags = parse_retarget_flags;
      code_ = batch_command(batch_);
    });
  }

  void add_pose() {
    auto* c = app_.add_subcommand("pose", "pull a rig to targets and draw what it reaches");
    c->add_option("rig", pose_.rig, "a shipped rig's name, a rig JSON or a character")->required();
    auto* targets = c->add_option("--targets", pose_.targets,
                                  "limber/targets/1: a file, or a shipped one's name");
    auto* example = c->add_flag("--example", pose_.example, "print targets to start from");
    targets->excludes(example);
    c->add_option("-o,--output", pose_.sheet, "draw the poses here (PNG)");
    c->add_option("--solver", pose_solver_)
        ->check(CLI::IsMember({"pgs", "pgs-paper", "ceres"}))
        ->capture_default_str();
    c->add_flag("--json", pose_.json, "one JSON document on standard output");
    c->callback([this] {
      if (pose_.targets.empty() && !pose_.example) {
        throw CLI::RequiredError("--targets (or --example)");
      }
      pose_.solver = solver_named(pose_solver_);
      code_ = pose_command(pose_);
    });
  }

  void add_validate() {
    auto* c = app_.add_subcommand("validate", "check a retargeted file against its source");
    c->add_option("file", validate_.file)->required();
    c->add_option("--source", validate_.source, "the clip it was made from")->required();
    c->add_option("--rig", validate_.rig, "whose limits count; default: the file's own figure");
    c->add_option("--clip", validate_.clip, "the source's clip of this name");
    c->add_option("--range", range_, "only the source's frames FIRST:LAST");
    c->add_option("--map", validate_.map, "a map file, for the source's joints");
    c->add_option("--gates", validate_.gates,
                  "levels that figures must keep; a file, or `default`");
    c->add_flag("--json", validate_.json);
    c->callback([this] {
      if (!range_.empty()) validate_.range = parse_range(range_);
      code_ = validate_command(validate_);
    });
  }

  void add_sheet() {
    auto* c = app_.add_subcommand("sheet", "contact sheets of any files");
    c->add_option("files", sheet_.files)->required();
    c->add_option("-o,--output", sheet_.output, "PNG; numbered where there are several files")
        ->required();
    sheet_import_.add(*c);
    c->callback([this] {
      sheet_.import = sheet_import_.options();
      code_ = sheet_command(sheet_);
    });
  }

  void add_report() {
    auto* c = app_.add_subcommand("report", "one page of all clips of a folder");
    c->add_option("folder", report_.folder, "where reports and sheets lie")->required();
    c->add_option("-o,--output", report_.page, "HTML file to write, best in that folder")
        ->required();
    c->callback([this] { code_ = report_command(report_); });
  }

  void add_bench() {
    auto* c = app_.add_subcommand("bench", "time and judge the solver on a workload");
    c->add_option("workload", bench_.workload, "ikwork/1, may be gzipped")->required();
    c->add_option("--solver", bench_.solver)->check(CLI::IsMember({"pgs", "pgs-paper", "ceres"}));
    c->add_flag("--pos", bench_.pos, "positions alone");
    c->add_option("--start", bench_.start)->check(CLI::IsMember({"extrapolate", "previous"}));
    c->add_flag("--cycle", bench_.cycle, "the workload is a cycle: close it, report its seam");
    c->add_option("--lanes", bench_.lanes)->check(CLI::PositiveNumber);
    c->add_option("--stop-mm", bench_.stop_mm)->check(CLI::PositiveNumber);
    c->add_option("--stop-deg", bench_.stop_deg)->check(CLI::PositiveNumber);
    c->add_option("--sweeps", bench_.sweeps, "of pgs-paper, per iteration")
        ->check(CLI::PositiveNumber);
    c->add_option("--solutions", bench_.solutions, "write the solutions here, raw float64");
    c->add_flag("--json", bench_.json);
    c->callback([this] { code_ = bench_command(bench_); });
  }

  void add_doctor() {
    auto* c = app_.add_subcommand("doctor", "what this program can do here");
    c->add_flag("--json", doctor_json_);
    c->callback([this] { code_ = doctor_command(doctor_json_); });
    auto* e = app_.add_subcommand("explain", "what an error or warning code means");
    e->add_option("code", explain_, "none: list all codes");
    e->callback([this] { code_ = explain_command(explain_); });
  }

  CLI::App app_;
  int code_ = kAllPassed;
  InspectArgs inspect_;
  ImportFlags inspect_import_, map_import_, rig_import_, retarget_import_, sheet_import_;
  MapArgs map_;
  RigNewArgs rig_new_;
  RigShowArgs rig_show_;
  bool rig_json_ = false, doctor_json_ = false;
  RetargetArgs retarget_;
  bool parse_only_ = false;
  BatchArgs batch_;
  std::string clip_, range_, map_file_,
      limits_ = "on", contacts_ = "on", collision_ = "on", cycle_ = "on", root_ = "scale",
      refine_ = "frame", solver_ = "pgs", reference_, fingers_ = "rest", sandbox_ = "auto";
  double rate_ = 0.0;
  std::vector<std::string> formats_;
  PoseArgs pose_;
  std::string pose_solver_ = "pgs";
  ValidateArgs validate_;
  SheetArgs sheet_;
  ReportArgs report_;
  BenchArgs bench_;
  std::string explain_;
};

}  // namespace
}  // namespace limber

int main(int argc, char** argv) {
  // Children die with their parent; retarget replaces this by a handler that cleans up.
  std::signal(SIGINT, [](int) { ::_exit(limber::kInterrupted); });
  std::signal(SIGTERM, [](int) { ::_exit(limber::kInterrupted); });
  try {
    return limber::Program().run(argc, argv);
  } catch (const std::exception& e) {
    fmt::print(stderr, "limber: {}\n", e.what());
    return limber::kEnvironment;
  }
}
