#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "pipeline/job.h"

namespace limber {

/// Exit codes of the program (DESIGN section 7).
enum ExitCode : int {
  kAllPassed = 0,
  kSomeFailed = 1,
  kUsage = 2,  ///< also an unreadable target, map or rig
  kEnvironment = 3,
  kGateMissed = 4,
  kInterrupted = 130,
};

struct InspectArgs {
  std::vector<std::string> files;
  ImportOptions import;
  bool json = false;
};
int inspect_command(const InspectArgs&);

struct MapArgs {
  std::string source, target;
  std::filesystem::path output;
  ImportOptions import;
  bool json = false;
};
int map_command(const MapArgs&);

struct RigNewArgs {
  std::string character;
  std::filesystem::path output;
  ImportOptions import;
};
int rig_list_command(bool json);
int rig_new_command(const RigNewArgs&);

struct RigShowArgs {
  std::string rig;
  std::filesystem::path sheet;
  bool json = false;
};
int rig_show_command(const RigShowArgs&);

struct RetargetArgs {
  std::vector<std::string> sources;
  std::string target;
  JobOptions job;
  std::string gates;            ///< a file, or a shipped one's name; "": none
  std::filesystem::path junit;  ///< write the verdicts here
  int processes = 0;            ///< 0: one per core
  bool json = false;
};
int retarget_command(const RetargetArgs&);

struct SheetArgs {
  std::vector<std::string> files;
  std::filesystem::path output;
  ImportOptions import;
};
int sheet_command(const SheetArgs&);

struct ValidateArgs {
  std::string file, source;
  std::string rig, gates;
  std::string clip, map;  ///< of the source; "": its first clip, no map file
  std::optional<std::pair<std::int64_t, std::int64_t>> range;  ///< of the source's frames
  bool json = false;
};
int validate_command(const ValidateArgs&);

/// Without a code: all of them, a line each.
int explain_command(const std::string& code);

/// A command that parses files of strangers runs in a jailed process and prints from there.
int isolated_command(const std::function<int()>& work, const JailRules&);

/// "file: message [code] (joint J, frame F)" and the way out, on standard error.
void print_error(const Error&);
/// The same, and with `json` the document {"error": {code, message, ...}} on standard output.
void print_error(const Error&, bool json);

}  // namespace limber
