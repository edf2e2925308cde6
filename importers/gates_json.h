#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "assets/model/result.h"

namespace limber {

/// A level for one figure of a clip's report.
struct Gate {
  /// Path of the figure in the report, its parts joined by '/'. A part is a member's name; in an
  /// array the element of that `name` or `joint`, or its index; `*` is every member or element.
  std::string figure;
  std::optional<double> warn{}, fail{};  ///< what is beyond is a warning, a failure; one is there
  bool at_least = false;                 ///< the figure must not be less, instead of not more
  bool required = false;                 ///< a report without the figure misses the gate
};

/// A file of format `limber/gates/1` (assets/data/schemas/gates.schema.json).
struct Gates {
  std::string description;
  std::vector<Gate> gates;  ///< at least one
};

/// Errors, with the JSON pointer: `gates-json`.
Result<Gates> read_gates_json(std::string_view text);

}  // namespace limber
