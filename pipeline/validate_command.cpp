#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>

#include "pipeline/commands.h"
#include "pipeline/gates.h"
#include "pipeline/isolated.h"
#include "pipeline/validation_check.h"

namespace limber {
using json = nlohmann::ordered_json;

namespace {

std::string where_of(const nlohmann::ordered_json& finding) {
  std::string where;
  if (finding.contains("joint")) where += " joint " + finding["joint"].get<std::string>();
  if (finding.contains("frame")) where += fmt::format(" frame {}", finding["frame"].get<int>());
  return where.empty() ? where : " (" + where.substr(1) + ")";
}

}  // namespace

int validate_command(const ValidateArgs& args) {
  std::optional<Gates> gates;
  if (!args.gates.empty()) {
    auto read = load_gates(args.gates);
    if (!read) {
      print_error(read.error(), args.json);
      return kUsage;
    }
    gates = std::move(*read);
  }
  const auto answer =
      run_isolated([&] { return check_against_source(args); },
                   {.may = {.reads = {args.file, args.source, args.rig, args.map}}});
  if (!answer) {
    Error error = answer.error();
    error.file = args.file;
    print_error(error, args.json);
    return kSomeFailed;
  }
  auto found = nlohmann::ordered_json::parse(*answer, nullptr, false);
  if (found.contains("error")) {
    const auto& e = found["error"];
    print_error({.code = e["code"],
                 .message = e["message"],
                 .file = e["file"],
                 .joint = e["joint"],
                 .hint = e["hint"]},
                args.json);
    return found.value("usage", false) ? kUsage : kSomeFailed;
  }
  std::vector<GateVerdict> verdicts;
  if (gates) {
    verdicts = judge_gates(*gates, *answer);
    found["gates"] = nlohmann::ordered_json::parse(to_json(verdicts));
  }
  if (args.json) {
    fmt::print("{}\n", found.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace));
  } else {
    fmt::print("{}: {}\n  {} frames at {:g} Hz, {:.3f} s (source {:.3f} s)\n", args.file,
               found["status"].get<std::string>(), found["frames"].get<std::int64_t>(),
               found["rate_hz"].get<double>(), found["duration_s"].get<double>(),
               found["source_duration_s"].get<double>());
    for (const auto& finding : found["findings"]) {
      fmt::print("  {}: {} [{}]{}\n", finding["level"].get<std::string>(),
                 finding["message"].get<std::string>(), finding["code"].get<std::string>(),
                 where_of(finding));
    }
    fmt::print("  limits of {}: {} violations in {} joints, worst {:.4f} degrees\n",
               found["rig"].get<std::string>(), found["limits"]["violations"].get<std::int64_t>(),
               found["limits"]["joints"].get<std::int64_t>(),
               found["limits"]["max_violation_deg"].get<double>());
    fmt::print("  feet slide {:.1f} cm/s (source {:.1f}), {} pops\n",
               found["contacts"]["output"]["slide_cm_s"].get<double>(),
               found["contacts"]["source"]["slide_cm_s"].get<double>(),
               found["smoothness"]["pops"].get<std::int64_t>());
    for (const GateVerdict& verdict : verdicts) {
      if (verdict.level == GateLevel::pass) continue;
      fmt::print("  gate {}: {}\n", to_string(verdict.level), describe(verdict));
    }
  }
  const bool missed = std::any_of(verdicts.begin(), verdicts.end(),
                                  [](const GateVerdict& v) { return v.level == GateLevel::fail; });
  if (found["status"] == "fail") return kSomeFailed;
  return missed ? kGateMissed : kAllPassed;
}

}  // namespace limber
