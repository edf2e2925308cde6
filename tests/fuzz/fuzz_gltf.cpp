// glTF and GLB, buffers in data URIs: reads or refuses; what is read keeps every invariant.

#include <fmt/format.h>

#include <cstring>
#include <nlohmann/json.hpp>

#include "importers/file_resolver.h"
#include "importers/importer.h"
#include "tests/fuzz/fuzz_target.h"

namespace limber::fuzz {

namespace {

using nlohmann::json;

/// Two skinned joints that move, a morphed triangle, a sparse and a normalised accessor: what the
/// reader knows, in a kilobyte.
class Seed {
 public:
  Seed() {
    const int times = floats("SCALAR", {0, 0.5, 1});
    const int turns = floats("VEC4", {0, 0, 0, 1, 0, 0, 0.6, 0.8, 0, 0, 0, 1});
    const int places = floats("VEC3", {0, 1, 0, 0.5, 1, 0, 1, 1, 0});
    const int corners = floats("VEC3", {0, 0, 0, 1, 0, 0, 0, 2, 0});
    const int binds = floats("MAT4", {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0,  0, 0, 1,
                                      1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -1, 0, 0, 1});
    const int joints = bytes("VEC4", {0, 1, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0}, false);
    const int weights = bytes("VEC4", {255, 0, 0, 0, 128, 127, 0, 0, 255, 0, 0, 0}, true);
    const int faces = bytes("SCALAR", {0, 1, 2}, false);
    const int one = bytes("SCALAR", {1}, false);
    const int moved = floats("VEC3", {0, 0, 1});
    const int sparse = static_cast<int>(doc_["accessors"].size());
    doc_["accessors"].push_back({{"componentType", 5126},
                                 {"count", 3},
                                 {"type", "VEC3"},
                                 {"sparse",
                                  {{"count", 1},
                                   {"indices", {{"bufferView", one}, {"componentType", 5121}}},
                                   {"values", {{"bufferView", moved}}}}}});
    doc_["nodes"] = {{{"name", "hips"}, {"children", {1}}},
                     {{"name", "arm"}, {"translation", {1, 0, 0}}},
                     {{"mesh", 0}, {"skin", 0}}};
    doc_["scenes"] = {{{"nodes", {0, 2}}}};
    doc_["scene"] = 0;
    doc_["skins"] = {{{"joints", {0, 1}}, {"inverseBindMatrices", binds}}};
    doc_["meshes"] = {
        {{"primitives",
          {{{"attributes", {{"POSITION", corners}, {"JOINTS_0", joints}, {"WEIGHTS_0", weights}}},
            {"indices", faces},
            {"targets", {{{"POSITION", sparse}}}}}}}}};
    const auto channel = [](int sampler, int node, const char* path) {
      return json{{"sampler", sampler}, {"target", {{"node", node}, {"path", path}}}};
    };
    doc_["animations"] = {
        {{"name", "wave"},
         {"samplers",
          {{{"input", times}, {"output", turns}},
           {{"input", times}, {"output", places}, {"interpolation", "STEP"}}}},
         {"channels", {channel(0, 1, "rotation"), channel(1, 0, "translation")}}}};
  }

  std::string gltf() {
    static const char* digits = "0123456789ABCDEF";
    std::string uri = "data:application/octet-stream,";
    for (const char c : bin_) {
      uri += {'%', digits[std::uint8_t(c) >> 4], digits[std::uint8_t(c) & 15]};
    }
    doc_["buffers"] = {{{"byteLength", bin_.size()}, {"uri", uri}}};
    return doc_.dump();
  }

  std::string glb() {
    doc_["buffers"] = {{{"byteLength", bin_.size()}}};
    std::string text = doc_.dump();
    text.resize((text.size() + 3) / 4 * 4, ' ');
    std::string bin = bin_;
    bin.resize((bin.size() + 3) / 4 * 4);
    return "glTF" + word(2) + word(28 + text.size() + bin.size()) + word(text.size()) + "JSON" +
           text + word(bin.size()) + std::string("BIN\0", 4) + bin;
  }

 private:
  static std::string word(std::size_t value) {
    const auto narrow = static_cast<std::uint32_t>(value);
    std::string out(4, '\0');
    std::memcpy(out.data(), &narrow, 4);
    return out;
  }
  int add(const char* type, std::size_t values, int component_type, std::size_t begin) {
    const std::string kind = type;
    const std::size_t size = kind == "SCALAR" ? 1 : kind == "MAT4" ? 16 : kind[3] - '0';
    doc_["bufferViews"].push_back(
        {{"buffer", 0}, {"byteOffset", begin}, {"byteLength", bin_.size() - begin}});
    doc_["accessors"].push_back({{"bufferView", doc_["bufferViews"].size() - 1},
                                 {"componentType", component_type},
                                 {"count", values / size},
                                 {"type", type}});
    bin_.resize((bin_.size() + 3) / 4 * 4);
    return static_cast<int>(doc_["accessors"].size()) - 1;
  }
  int floats(const char* type, const std::vector<float>& values) {
    const std::size_t begin = bin_.size();
    bin_.append(reinterpret_cast<const char*>(values.data()), 4 * values.size());
    return add(type, values.size(), 5126, begin);
  }
  int bytes(const char* type, const std::vector<std::uint8_t>& values, bool normalized) {
    const std::size_t begin = bin_.size();
    bin_.append(values.begin(), values.end());
    const int index = add(type, values.size(), 5121, begin);
    if (normalized) doc_["accessors"][index]["normalized"] = true;
    return index;
  }

  json doc_ = {{"asset", {{"version", "2.0"}}}};
  std::string bin_;
};

}  // namespace

std::vector<std::string> seeds() { return {Seed().gltf(), Seed().glb()}; }

}  // namespace limber::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace limber;
  const auto embedded_only = [](std::string_view uri) -> Result<std::vector<std::byte>> {
    if (uri.starts_with("data:")) return decode_data_uri(uri);
    return Error{.code = "uri-refused", .message = "not embedded", .hint = "embed it"};
  };
  const auto imported = import_bytes(std::as_bytes(std::span(data, size)), "gltf", embedded_only);
  if (!imported) fuzz::require_honest(imported.error());
  return 0;
}
