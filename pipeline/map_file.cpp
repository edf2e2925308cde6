#include "pipeline/map_file.h"

#include <nlohmann/json.hpp>

#include "pipeline/file_io.h"

namespace limber {

Result<MapFile> read_map_json(std::string_view text) {
  const auto invalid = [](std::string message) {
    return Error{.code = "map-file",
                 .message = std::move(message),
                 .hint = "start from a file that `limber map SOURCE TARGET -o` wrote"};
  };
  const auto document = nlohmann::json::parse(text, nullptr, false);
  if (document.is_discarded()) return invalid("not JSON");
  if (!document.is_object() || !document.contains("format") ||
      document["format"] != "limber-map/1") {
    return invalid("/format: expected \"limber-map/1\"");
  }
  if (!document.contains("source") && !document.contains("target")) {
    return invalid("/source, /target: the map says nothing of either side");
  }
  MapFile map;
  for (const char* side : {"source", "target"}) {
    if (!document.contains(side)) continue;
    const auto& entry = document[side];
    if (!entry.is_object()) return invalid(std::string("/") + side + ": expected an object");
    if (!entry.contains("roles")) continue;
    if (!entry["roles"].is_object()) {
      return invalid(std::string("/") + side + "/roles: expected an object");
    }
    for (const auto& [role, joint] : entry["roles"].items()) {
      if (!joint.is_string()) {
        return invalid(std::string("/") + side + "/roles/" + role + ": expected a joint's name");
      }
      (side == std::string("source") ? map.source : map.target)[role] = joint.get<std::string>();
    }
  }
  return map;
}

Result<MapFile> read_map_file(const std::filesystem::path& path) {
  const auto text = read_text(path);
  if (!text) return text.error();
  auto map = read_map_json(*text);
  if (!map) map.error().file = path.string();
  return map;
}

}  // namespace limber
