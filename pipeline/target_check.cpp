#include "pipeline/target_check.h"

#include <filesystem>
#include <nlohmann/json.hpp>

namespace limber {

using nlohmann::json;

std::string label_of(const std::string& target) {
  return shipped_rig(target) ? target : std::filesystem::path(target).stem().string();
}

Result<std::string> check_target(const std::string& target, const JobOptions& job) {
  if (job.sandbox == SandboxMode::require && !sandbox_available()) {
    return Error{.code = "sandbox-unavailable",
                 .message = "this system confines by " + sandbox_level() + " only",
                 .hint = "see `limber doctor`, or use --sandbox auto"};
  }
  const auto told = [](const json& document) {
    return document.dump(-1, ' ', false, json::error_handler_t::replace);
  };
  const auto error_of = [](const Error& e) {
    return json{{"code", e.code},
                {"message", e.message},
                {"file", e.file},
                {"joint", e.joint},
                {"hint", e.hint}};
  };
  JailRules may{.reads = {target}};
  if (job.map) may.reads.push_back(*job.map);
  const auto checked = run_isolated(
      [&] {
        const auto options = target_options(job);
        if (!options) return told(error_of(options.error()));
        const auto read = load_target(target, *options);
        return told(read ? json{{"label", read->label}} : error_of(read.error()));
      },
      {.may = may, .sandbox = job.sandbox});
  if (!checked) {
    Error error = checked.error();
    error.file = target;
    return error;
  }
  const json answer = json::parse(*checked, nullptr, false);
  if (answer.contains("label")) return answer["label"].get<std::string>();
  return Error{.code = answer.value("code", "process-failed"),
               .message = answer.value("message", "the target's process gave no answer"),
               .file = answer.value("file", target),
               .joint = answer.value("joint", ""),
               .hint = answer.value("hint", "")};
}

}  // namespace limber
