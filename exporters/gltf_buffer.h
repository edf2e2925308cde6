#pragma once

#include <cstddef>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

namespace limber {

using Json = nlohmann::ordered_json;

inline constexpr int kGltfFloat = 5126;
inline constexpr int kGltfUnsignedShort = 5123;
inline constexpr int kGltfUnsignedInt = 5125;

/// Fills a document's one buffer (index 0, the GLB's BIN chunk), its bufferViews and accessors.
/// An ordered_json object is a vector: adding may move the document's members, so no reference to
/// one may be held across a call.
class GltfBuffer {
 public:
  /// `bytes`: what the buffer starts with.
  GltfBuffer(Json& document, std::vector<std::byte> bytes)
      : document_(document), bytes_(std::move(bytes)) {}

  std::size_t size() const { return bytes_.size(); }

  /// Zero bytes up to the next multiple of four.
  void pad();

  /// Appends bytes, aligned to four, and returns their offset.
  std::size_t append(std::span<const std::byte> bytes);

  /// Appends bytes under a bufferView of their own; `target` 0 writes none.
  std::size_t add_view(std::span<const std::byte> bytes, int target = 0);

  /// Appends values under a bufferView and an accessor of their own. `bounds` writes min and max.
  std::size_t add_floats(std::span<const float> values, std::string_view type, bool bounds,
                         int target = 0);
  std::size_t add_shorts(std::span<const std::uint16_t> values, std::string_view type, int target);
  std::size_t add_indices(std::span<const std::uint32_t> values);

  std::vector<std::byte> take_bytes() && { return std::move(bytes_); }

  /// Writes the buffer's length into the document and gives the whole file.
  std::vector<std::byte> finish() &&;

 private:
  std::size_t add_accessor(std::size_t view, int component, std::size_t count,
                           std::string_view type);

  Json& document_;
  std::vector<std::byte> bytes_;
};

/// Components of an accessor type: SCALAR 1, VEC3 3, MAT4 16, ...
std::size_t gltf_components(std::string_view type);

}  // namespace limber
