#include "importers/gates_json.h"

#include <fmt/format.h>

#include "importers/failure.h"
#include "importers/json_view.h"

namespace limber {

namespace {

constexpr const char* kCode = "gates-json";
constexpr std::size_t kMostGates = 256, kLongestFigure = 256;

Gate read_gate(const JsonView& view) {
  view.only({"figure", "warn", "fail", "at_least", "required"});
  Gate gate;
  const JsonView figure = view.at("figure");
  gate.figure = figure.string();
  const bool whole = !gate.figure.empty() && gate.figure.size() <= kLongestFigure &&
                     gate.figure.front() != '/' && gate.figure.back() != '/' &&
                     gate.figure.find("//") == std::string::npos;
  if (!whole) figure.complain("a path like 'contacts/output/slide_cm_s' is expected");
  if (const auto warn = view.find("warn")) gate.warn = warn->number();
  if (const auto fail = view.find("fail")) gate.fail = fail->number();
  if (const auto at_least = view.find("at_least")) gate.at_least = at_least->boolean();
  if (const auto required = view.find("required")) gate.required = required->boolean();
  if (!gate.warn && !gate.fail) view.complain("'warn' or 'fail' is missing");
  if (gate.warn && gate.fail &&
      (gate.at_least ? *gate.warn < *gate.fail : *gate.warn > *gate.fail)) {
    view.complain("what fails must be worse than what warns");
  }
  return gate;
}

Gates read_gates(const JsonView& root) {
  root.only({"$schema", "format", "description", "gates"});
  if (root.at("format").string() != "limber/gates/1") {
    root.at("format").complain("the format is not 'limber/gates/1'");
  }
  Gates out;
  if (const auto schema = root.find("$schema")) schema->string();
  if (const auto description = root.find("description")) out.description = description->string();
  const JsonView gates = root.at("gates");
  if (gates.array().size() == 0) gates.complain("there is no gate");
  if (gates.size() > kMostGates) gates.complain(fmt::format("more than {} gates", kMostGates));
  for (std::size_t i = 0; i < gates.size(); ++i) out.gates.push_back(read_gate(gates[i]));
  return out;
}

}  // namespace

Result<Gates> read_gates_json(std::string_view text) {
  return guarded<Gates>([&]() -> Result<Gates> {
    const nlohmann::json document = parse_json(text, kCode, true);
    return read_gates(JsonView(document, kCode));
  });
}

}  // namespace limber
