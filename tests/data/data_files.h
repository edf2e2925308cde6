#pragma once

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <string>

namespace limber::test {

inline const std::filesystem::path kSource = LIMBER_SOURCE_DIR;
inline const std::filesystem::path kData = kSource / "assets/data";

inline std::string read_text(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  std::ostringstream text;
  text << in.rdbuf();
  return text.str();
}

inline nlohmann::json read_json(const std::filesystem::path& path) {
  return nlohmann::json::parse(read_text(path));
}

/// The folder of shared material, where there is one.
inline std::optional<std::filesystem::path> shared() {
  const char* given = std::getenv("LIMBER_SHARED");
  const std::filesystem::path folder = given ? given : (kSource / "../shared").string();
  if (std::filesystem::is_directory(folder)) return folder;
  return std::nullopt;
}

inline constexpr const char* kNoShared = "no shared folder beside the source (LIMBER_SHARED)";
inline constexpr double kRadians = 3.14159265358979323846 / 180.0;

}  // namespace limber::test
