#include "pipeline/conventions.h"

#include <nlohmann/json.hpp>

#include "pipeline/embedded.h"

namespace limber {
namespace {

/// The data is ours and tested, so a fault in it is a bug, not an input error.
std::vector<Convention> load() {
  const auto document =
      nlohmann::json::parse(embedded_file("conventions/conventions.json"), nullptr, false);
  std::vector<Convention> out;
  if (document.is_discarded()) return out;
  for (const auto& entry : document.at("conventions")) {
    Convention convention{.name = entry.at("name").get<std::string>(), .names = {}};
    convention.either_hand = entry.value("hand", "") == "either";
    for (const auto& [role, joint] : entry.at("names").items()) {
      if (const auto known = role_named(role)) {
        convention.names.emplace_back(*known, joint.get<std::string>());
      }
    }
    out.push_back(std::move(convention));
  }
  return out;
}

}  // namespace

const std::vector<Convention>& conventions() {
  static const std::vector<Convention> all = load();
  return all;
}

}  // namespace limber
