#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "importers/gates_json.h"

namespace limber {

enum class GateLevel : std::uint8_t { pass, warn, fail };
const char* to_string(GateLevel);

/// What one gate says of a report. Where it names several figures, the worst of them.
struct GateVerdict {
  std::string figure;           ///< path, every `*` replaced by what it stood for
  std::optional<double> value;  ///< none: the report has no such figure
  double limit = 0.0;           ///< the level that was missed, or the first that would be
  bool at_least = false;
  GateLevel level = GateLevel::pass;
};

/// A file's gates, or shipped ones by name ("default"). Errors: `gates-json`, `file-unreadable`.
Result<Gates> load_gates(const std::string& path_or_name);

/// Judges a report (or a validation) as JSON. Gates whose figure the report lacks say nothing,
/// unless they are required.
std::vector<GateVerdict> judge_gates(const Gates&, const std::string& report);

/// The `gates` of a report: [{figure, value?, limit, at_least?, level}].
std::string to_json(const std::vector<GateVerdict>&);

/// "contacts/output/slide_cm_s is 4.2, at most 3"
std::string describe(const GateVerdict&);

}  // namespace limber
