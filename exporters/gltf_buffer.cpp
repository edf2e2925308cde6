#include "exporters/gltf_buffer.h"

#include <algorithm>
#include <cstring>

namespace limber {
namespace {

template <class T>
void put(std::vector<std::byte>& out, const T& value) {
  const auto* p = reinterpret_cast<const std::byte*>(&value);
  out.insert(out.end(), p, p + sizeof(T));
}

constexpr std::uint32_t kMagic = 0x46546C67;      // "glTF"
constexpr std::uint32_t kJsonChunk = 0x4E4F534A;  // "JSON"
constexpr std::uint32_t kBinChunk = 0x004E4942;   // "BIN\0"

}  // namespace

std::size_t gltf_components(std::string_view type) {
  if (type == "SCALAR") return 1;
  if (type == "VEC2") return 2;
  if (type == "VEC3") return 3;
  return type == "MAT4" ? 16 : 4;
}

void GltfBuffer::pad() { bytes_.resize((bytes_.size() + 3) / 4 * 4); }

std::size_t GltfBuffer::append(std::span<const std::byte> bytes) {
  pad();
  const std::size_t offset = bytes_.size();
  bytes_.insert(bytes_.end(), bytes.begin(), bytes.end());
  return offset;
}

std::size_t GltfBuffer::add_view(std::span<const std::byte> bytes, int target) {
  Json view = {{"buffer", 0}, {"byteOffset", append(bytes)}, {"byteLength", bytes.size()}};
  if (target != 0) view["target"] = target;
  Json& views = document_["bufferViews"];
  views.push_back(std::move(view));
  return views.size() - 1;
}

std::size_t GltfBuffer::add_accessor(std::size_t view, int component, std::size_t count,
                                     std::string_view type) {
  Json& accessors = document_["accessors"];
  accessors.push_back(
      {{"bufferView", view}, {"componentType", component}, {"count", count}, {"type", type}});
  return accessors.size() - 1;
}

std::size_t GltfBuffer::add_floats(std::span<const float> values, std::string_view type,
                                   bool bounds, int target) {
  const std::size_t n = gltf_components(type);
  const std::size_t accessor =
      add_accessor(add_view(std::as_bytes(values), target), kGltfFloat, values.size() / n, type);
  if (!bounds) return accessor;
  std::vector<float> low(values.begin(), values.begin() + n), high = low;
  for (std::size_t i = 0; i < values.size(); ++i) {
    low[i % n] = std::min(low[i % n], values[i]);
    high[i % n] = std::max(high[i % n], values[i]);
  }
  // As doubles: JSON must read back as exactly the float that is in the buffer.
  document_["accessors"][accessor]["min"] = std::vector<double>(low.begin(), low.end());
  document_["accessors"][accessor]["max"] = std::vector<double>(high.begin(), high.end());
  return accessor;
}

std::size_t GltfBuffer::add_shorts(std::span<const std::uint16_t> values, std::string_view type,
                                   int target) {
  return add_accessor(add_view(std::as_bytes(values), target), kGltfUnsignedShort,
                      values.size() / gltf_components(type), type);
}

std::size_t GltfBuffer::add_indices(std::span<const std::uint32_t> values) {
  constexpr int kElementArray = 34963;
  return add_accessor(add_view(std::as_bytes(values), kElementArray), kGltfUnsignedInt,
                      values.size(), "SCALAR");
}

std::vector<std::byte> GltfBuffer::finish() && {
  pad();
  if (!bytes_.empty()) {
    Json& buffers = document_["buffers"];
    if (buffers.empty()) buffers.push_back(Json::object());
    buffers[0]["byteLength"] = bytes_.size();
  }
  std::string json = document_.dump(-1, ' ', false, Json::error_handler_t::replace);
  json.resize((json.size() + 3) / 4 * 4, ' ');
  const std::size_t bin_chunk = bytes_.empty() ? 0 : 8 + bytes_.size();
  std::vector<std::byte> out;
  out.reserve(12 + 8 + json.size() + bin_chunk);
  put(out, kMagic);
  put(out, std::uint32_t{2});
  put(out, static_cast<std::uint32_t>(12 + 8 + json.size() + bin_chunk));
  put(out, static_cast<std::uint32_t>(json.size()));
  put(out, kJsonChunk);
  const auto text = std::as_bytes(std::span(json));
  out.insert(out.end(), text.begin(), text.end());
  if (!bytes_.empty()) {
    put(out, static_cast<std::uint32_t>(bytes_.size()));
    put(out, kBinChunk);
    out.insert(out.end(), bytes_.begin(), bytes_.end());
  }
  return out;
}

}  // namespace limber
