#include "pipeline/gates.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <nlohmann/json.hpp>

#include "pipeline/embedded.h"
#include "pipeline/file_io.h"

namespace limber {

namespace {

using nlohmann::json;

struct NamedFigure {
  std::string path;
  double value;
};

std::string joined(const std::string& path, const std::string& part) {
  return path.empty() ? part : path + "/" + part;
}

/// What an array's element is called, else its index.
std::string label_of(const json& element, std::size_t index) {
  for (const char* key : {"name", "joint"}) {
    if (element.is_object() && element.contains(key) && element[key].is_string()) {
      return element[key].get<std::string>();
    }
  }
  return std::to_string(index);
}

/// All numbers that the rest of a figure's path leads to.
void collect(const json& value, std::string_view rest, const std::string& path,
             std::vector<NamedFigure>& found) {
  if (rest.empty()) {
    if (value.is_number()) found.push_back({path, value.get<double>()});
    if (value.is_boolean()) found.push_back({path, value.get<bool>() ? 1.0 : 0.0});
    return;
  }
  const std::size_t slash = rest.find('/');
  const std::string part(rest.substr(0, slash));
  const std::string_view after = slash == rest.npos ? "" : rest.substr(slash + 1);
  if (value.is_object()) {
    for (const auto& [key, member] : value.items()) {
      if (part == "*" || part == key) collect(member, after, joined(path, key), found);
    }
  } else if (value.is_array()) {
    for (std::size_t i = 0; i < value.size(); ++i) {
      const std::string label = label_of(value[i], i);
      if (part == "*" || part == label || part == std::to_string(i)) {
        collect(value[i], after, joined(path, label), found);
      }
    }
  }
}

bool beyond(const Gate& gate, double value, const std::optional<double>& limit) {
  return limit && !(gate.at_least ? value >= *limit : value <= *limit);
}

GateVerdict judge(const Gate& gate, const json& report) {
  std::vector<NamedFigure> found;
  collect(report, gate.figure, "", found);
  GateVerdict out{.figure = gate.figure,
                  .value = std::nullopt,
                  .limit = gate.warn ? *gate.warn : *gate.fail,
                  .at_least = gate.at_least,
                  .level = GateLevel::pass};
  if (found.empty()) {
    if (gate.required) out.level = gate.fail ? GateLevel::fail : GateLevel::warn;
    return out;
  }
  const auto worst =
      std::max_element(found.begin(), found.end(), [&](const NamedFigure& a, const NamedFigure& b) {
        return gate.at_least ? a.value > b.value : a.value < b.value;
      });
  out.figure = worst->path;
  out.value = worst->value;
  if (beyond(gate, worst->value, gate.fail)) {
    out.level = GateLevel::fail;
    out.limit = *gate.fail;
  } else if (beyond(gate, worst->value, gate.warn)) {
    out.level = GateLevel::warn;
  }
  return out;
}

}  // namespace

const char* to_string(GateLevel level) {
  constexpr const char* kNames[] = {"pass", "warn", "fail"};
  return kNames[static_cast<int>(level)];
}

Result<Gates> load_gates(const std::string& path_or_name) {
  const std::string_view shipped = embedded_file("gates/" + path_or_name + ".json");
  if (!shipped.empty()) return read_gates_json(shipped);
  const auto bytes = read_file(path_or_name);
  if (!bytes) return bytes.error();
  auto gates = read_gates_json({reinterpret_cast<const char*>(bytes->data()), bytes->size()});
  if (gates) return gates;
  Error error = gates.error();
  error.file = path_or_name;
  return error;
}

std::vector<GateVerdict> judge_gates(const Gates& gates, const std::string& report) {
  const json document = json::parse(report, nullptr, false);
  std::vector<GateVerdict> out;
  for (const Gate& gate : gates.gates) out.push_back(judge(gate, document));
  return out;
}

std::string to_json(const std::vector<GateVerdict>& verdicts) {
  nlohmann::ordered_json out = json::array();
  for (const GateVerdict& verdict : verdicts) {
    nlohmann::ordered_json entry{{"figure", verdict.figure}};
    if (verdict.value) entry["value"] = *verdict.value;
    entry["limit"] = verdict.limit;
    if (verdict.at_least) entry["at_least"] = true;
    entry["level"] = to_string(verdict.level);
    out.push_back(std::move(entry));
  }
  return out.dump();
}

std::string describe(const GateVerdict& verdict) {
  if (!verdict.value) return verdict.figure + " was not measured";
  return fmt::format("{} is {:g}, {} {:g}", verdict.figure, *verdict.value,
                     verdict.at_least ? "at least" : "at most", verdict.limit);
}

}  // namespace limber
