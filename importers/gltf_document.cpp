#include "importers/gltf_document.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <limits>

#include "importers/failure.h"

namespace limber::gltf {

namespace {

constexpr std::uint32_t kJsonChunk = 0x4E4F534A;  // "JSON"
constexpr std::uint32_t kBinChunk = 0x004E4942;   // "BIN"

/// Extensions that a file may *require* and that change nothing we read, or that we honour.
constexpr std::array kHonoured = {"KHR_mesh_quantization",
                                  "KHR_texture_transform",
                                  "KHR_materials_unlit",
                                  "KHR_lights_punctual",
                                  "KHR_materials_variants",
                                  "KHR_xmp_json_ld",
                                  "EXT_texture_webp",
                                  "KHR_texture_basisu",
                                  "MSFT_texture_dds",
                                  "KHR_node_visibility",
                                  "KHR_materials_pbrSpecularGlossiness",
                                  "VRM",
                                  "VRMC_vrm",
                                  "VRMC_materials_mtoon",
                                  "VRMC_springBone",
                                  "VRMC_node_constraint",
                                  "VRMC_vrm_animation"};

std::uint32_t word_at(std::span<const std::byte> bytes, std::size_t offset) {
  std::uint32_t word = 0;
  for (int k = 3; k >= 0; --k) word = word << 8 | std::to_integer<std::uint32_t>(bytes[offset + k]);
  return word;
}

std::string_view as_text(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

[[noreturn]] void broken_container(const std::string& what) {
  fail("gltf-container", "GLB: " + what, "the file is damaged or cut short: get it again");
}

}  // namespace

Document::Document(std::span<const std::byte> bytes, const UriResolver& resolver,
                   Warnings& warnings) {
  if (as_text(bytes).starts_with("glTF")) {
    open_glb(bytes, warnings);
  } else {
    text_ = as_text(bytes);
  }
  std::string_view text = text_;
  if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);
  json_ = parse_json(text, "gltf-json");
  check_header();
  load_buffers(resolver);
}

void Document::open_glb(std::span<const std::byte> bytes, Warnings& warnings) {
  is_glb_ = true;
  if (bytes.size() < 12) broken_container("the header is cut short");
  if (word_at(bytes, 4) != 2) {
    fail("gltf-version", fmt::format("GLB version {} is not 2", word_at(bytes, 4)),
         "convert the file to glTF 2.0");
  }
  const std::size_t length = word_at(bytes, 8);
  if (length > bytes.size()) {
    broken_container(
        fmt::format("the header announces {} bytes, the file has {}", length, bytes.size()));
  }
  if (length < bytes.size()) {
    warnings.push_back({"gltf-extra-bytes", fmt::format("{} bytes follow the GLB and were ignored",
                                                        bytes.size() - length)});
  }
  std::size_t at = 12;
  for (int chunk = 0; at < length; ++chunk) {
    if (length - at < 8) broken_container("a chunk header is cut short");
    const std::size_t size = word_at(bytes, at);
    const std::uint32_t type = word_at(bytes, at + 4);
    at += 8;
    if (size > length - at) broken_container("a chunk is longer than the file");
    if (size % 4 != 0) broken_container("a chunk's length is no multiple of four");
    const std::span<const std::byte> body = bytes.subspan(at, size);
    if (chunk == 0 && type != kJsonChunk) broken_container("the first chunk is not JSON");
    if (chunk != 0 && type == kJsonChunk) broken_container("there is a second JSON chunk");
    if (chunk == 0) text_ = as_text(body);
    if (chunk == 1 && type == kBinChunk) {
      bin_.assign(body.begin(), body.end());
      has_bin_ = true;
    }
    at += size;
  }
  if (text_.empty()) broken_container("there is no JSON chunk");
}

void Document::check_header() const {
  const JsonView version = root().at("asset").at("version");
  if (!version.string().starts_with("2.")) {
    fail("gltf-version", fmt::format("glTF version '{}' is not 2", version.string()),
         "convert the file to glTF 2.0");
  }
  const auto required = root().find("extensionsRequired");
  for (std::size_t i = 0; required && i < required->array().size(); ++i) {
    const std::string& name = (*required)[i].string();
    const bool honoured = std::find(kHonoured.begin(), kHonoured.end(), name) != kHonoured.end() ||
                          name.starts_with("KHR_materials_");
    if (!honoured) {
      fail("gltf-unsupported-extension", fmt::format("the file requires the extension '{}'", name),
           "export it without compression or that extension, or remove it with gltf-transform");
    }
  }
}

void Document::load_buffers(const UriResolver& resolver) {
  const std::size_t total = count("buffers");
  for (std::size_t i = 0; i < total; ++i) {
    const JsonView buffer = item("buffers", static_cast<std::int64_t>(i));
    const auto length = static_cast<std::size_t>(
        buffer.at("byteLength").integer(1, std::numeric_limits<std::int32_t>::max()));
    std::vector<std::byte> bytes;
    if (const auto uri = buffer.find("uri")) {
      Result<std::vector<std::byte>> resolved = resolver(uri->string());
      if (!resolved) throw Failure{resolved.error()};
      bytes = std::move(*resolved);
    } else if (i == 0 && has_bin_) {
      bytes = std::move(bin_);
    } else {
      fail("gltf-buffer", fmt::format("/buffers/{}: there is neither a uri nor a BIN chunk", i),
           "the file is cut short: get it again");
    }
    if (bytes.size() < length) {
      fail("gltf-buffer",
           fmt::format("/buffers/{}: {} bytes announced, {} there", i, length, bytes.size()),
           "the file is cut short: get it again");
    }
    buffers_.push_back(std::move(bytes));
  }
}

std::size_t Document::count(const char* collection) const {
  const auto items = root().find(collection);
  return items ? items->array().size() : 0;
}

JsonView Document::item(const char* collection, std::int64_t index) const {
  const JsonView items = root().at(collection);
  if (index < 0 || static_cast<std::size_t>(index) >= items.array().size()) {
    items.complain(fmt::format("there is no entry {}", index));
  }
  const JsonView entry = items[static_cast<std::size_t>(index)];
  entry.object();
  return entry;
}

std::int64_t Document::index_of(const JsonView& owner, const char* key,
                                const char* collection) const {
  const auto index = owner.find(key);
  if (!index) return -1;
  const auto total = static_cast<std::int64_t>(count(collection));
  if (total == 0) index->complain(fmt::format("there are no {}", collection));
  return index->integer(0, total - 1);
}

std::span<const std::byte> Document::buffer_view(std::int64_t index) const {
  const JsonView view = item("bufferViews", index);
  const std::int64_t buffer = index_of(view, "buffer", "buffers");
  if (buffer < 0) view.complain("'buffer' is missing");
  const auto offset_view = view.find("byteOffset");
  constexpr auto kMax = std::numeric_limits<std::int32_t>::max();
  const auto offset = static_cast<std::size_t>(offset_view ? offset_view->integer(0, kMax) : 0);
  const auto length = static_cast<std::size_t>(view.at("byteLength").integer(1, kMax));
  const std::vector<std::byte>& bytes = buffers_[static_cast<std::size_t>(buffer)];
  if (offset > bytes.size() || length > bytes.size() - offset) {
    fail("gltf-buffer", fmt::format("/bufferViews/{}: it reaches beyond its buffer", index),
         "the file is damaged: export it again");
  }
  return std::span(bytes).subspan(offset, length);
}

void Document::move_into(GltfDocument& out) {
  out.json = std::move(text_);
  out.binary_chunk = is_glb_ && has_bin_ && !buffers_.empty() && !item("buffers", 0).has("uri");
  out.buffers = std::move(buffers_);
}

}  // namespace limber::gltf
