#pragma once

#include <cstdlib>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "importers/importer.h"

namespace limber::test {

/// The folder with real clips, where there is one.
inline std::optional<std::filesystem::path> shared_data() {
  const char* given = std::getenv("LIMBER_SHARED");
  const std::filesystem::path root =
      given != nullptr ? std::filesystem::path(given)
                       : std::filesystem::path(LIMBER_SOURCE_DIR) / ".." / "shared";
  if (std::filesystem::exists(root / "data" / "manifest.json")) return root / "data";
  return std::nullopt;
}

#define LIMBER_NEEDS_SHARED(data)                \
  const auto data = limber::test::shared_data(); \
  if (!data) GTEST_SKIP() << "no shared data beside the sources; set LIMBER_SHARED to its folder"

inline std::span<const std::byte> bytes_of(std::string_view text) {
  return std::as_bytes(std::span(text.data(), text.size()));
}

inline Result<std::vector<std::byte>> no_uris(std::string_view uri) {
  return Error{.code = "uri-refused", .message = std::string(uri)};
}

inline Result<Imported> import_text(std::string_view text, std::string_view extension,
                                    const ImportOptions& options = {}) {
  return import_bytes(bytes_of(text), extension, no_uris, options);
}

inline bool has_warning(const Imported& imported, std::string_view code) {
  for (const Warning& warning : imported.warnings) {
    if (warning.code == code) return true;
  }
  return false;
}

inline std::vector<Eigen::Vector3d> joint_positions(const Skeleton& skeleton,
                                                    std::span<const DualQuaternion> pose) {
  std::vector<DualQuaternion> model(skeleton.parents.size());
  model_from_local(skeleton, pose, model);
  std::vector<Eigen::Vector3d> points;
  for (const DualQuaternion& m : model) points.push_back(m.translation());
  return points;
}

}  // namespace limber::test
