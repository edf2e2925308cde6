#include <assimp/BaseImporter.h>
#include <assimp/config.h>
#include <assimp/importerdesc.h>
#include <assimp/postprocess.h>
#include <fmt/format.h>

#include <algorithm>
#include <assimp/IOStream.hpp>
#include <assimp/IOSystem.hpp>
#include <cstring>
#include <new>

#include "importers/assimp_scene.h"
#include "importers/failure.h"

namespace limber {
namespace {

/// Read-only bytes.
class MemoryStream final : public Assimp::IOStream {
 public:
  explicit MemoryStream(std::span<const std::byte> view) : view_(view) {}
  explicit MemoryStream(std::vector<std::byte> owned) : owned_(std::move(owned)), view_(owned_) {}

  std::size_t Read(void* out, std::size_t size, std::size_t count) override {
    if (size == 0 || count == 0) return 0;
    const std::size_t whole = std::min(count, (view_.size() - position_) / size);
    std::memcpy(out, view_.data() + position_, whole * size);
    position_ += whole * size;
    return whole;
  }
  std::size_t Write(const void*, std::size_t, std::size_t) override { return 0; }
  aiReturn Seek(std::size_t offset, aiOrigin origin) override {
    const std::size_t base = origin == aiOrigin_CUR   ? position_
                             : origin == aiOrigin_END ? view_.size()
                                                      : 0;
    const std::size_t target = base + offset;  // offsets may be negative: two's complement
    if (target > view_.size()) return aiReturn_FAILURE;
    position_ = target;
    return aiReturn_SUCCESS;
  }
  std::size_t Tell() const override { return position_; }
  std::size_t FileSize() const override { return view_.size(); }
  void Flush() override {}

 private:
  std::vector<std::byte> owned_;
  std::span<const std::byte> view_;
  std::size_t position_ = 0;
};

/// The file itself under an invented name, and what the resolver grants beside it.
class ConfinedIo final : public Assimp::IOSystem {
 public:
  ConfinedIo(std::span<const std::byte> bytes, std::string name, const UriResolver& resolver)
      : bytes_(bytes), name_(std::move(name)), resolver_(resolver) {}

  bool Exists(const char* path) const override {
    return is_main(path) || (resolver_ && resolver_(plain(path)).ok());
  }
  char getOsSeparator() const override { return '/'; }
  Assimp::IOStream* Open(const char* path, const char* mode) override {
    if (std::strpbrk(mode, "wa+") != nullptr) return nullptr;
    if (is_main(path)) return new MemoryStream(bytes_);
    if (!resolver_) return nullptr;
    Result<std::vector<std::byte>> found = resolver_(plain(path));
    return found ? new MemoryStream(std::move(*found)) : nullptr;
  }
  void Close(Assimp::IOStream* stream) override { delete stream; }

 private:
  static std::string plain(std::string_view path) {
    while (path.starts_with("./")) path.remove_prefix(2);
    return std::string(path);
  }
  bool is_main(const char* path) const { return plain(path) == name_; }

  std::span<const std::byte> bytes_;
  std::string name_;
  const UriResolver& resolver_;
};

/// assimp sniffs contents, so every importer but the wanted one is removed.
void keep_only(Assimp::Importer& importer, std::string_view format) {
  const std::string_view wanted = format == "fbx"   ? "Autodesk FBX Importer"
                                  : format == "dae" ? "Collada Importer"
                                  : format == "bvh" ? "BVH Importer (MoCap)"
                                  : format == "x"   ? "Direct3D XFile Importer"
                                                    : "glTF2 Importer";
  for (std::size_t i = importer.GetImporterCount(); i-- > 0;) {
    if (importer.GetImporterInfo(i)->mName == wanted) continue;
    Assimp::BaseImporter* other = importer.GetImporter(i);
    importer.UnregisterLoader(other);
    delete other;
  }
  if (importer.GetImporterCount() == 0) {
    fail("format-unsupported", fmt::format("this build of assimp reads no '{}'", format),
         "convert the file to GLB, FBX, DAE or BVH");
  }
}

/// FBX 5 and 6 have another layout that assimp refuses with an obscure message.
void check_fbx_version(std::span<const std::byte> bytes) {
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  std::uint32_t version = 7000;
  if (text.starts_with("Kaydara FBX Binary") && text.size() >= 27) {
    std::memcpy(&version, text.data() + 23, 4);
  } else if (const auto at = text.find("FBXVersion:"); at != std::string_view::npos) {
    version = static_cast<std::uint32_t>(std::atoi(std::string(text.substr(at + 11, 12)).c_str()));
  }
  if (version >= 7000) return;
  fail("fbx-version-unsupported",
       fmt::format("FBX {}.{} cannot be read", version / 1000, version % 1000 / 100),
       "convert the file to FBX 7 (2011 or later), for instance with Autodesk's FBX Converter");
}

/// assimp multiplies PostRotation where FBX divides by it (on nodes without pivots) and then drops
/// the number. Under another name of the same length the property reaches us as node metadata, and
/// NodeTree applies it.
std::vector<std::byte> hide_post_rotations(std::span<const std::byte> bytes) {
  constexpr std::string_view kName = "PostRotation";
  std::vector<std::byte> out(bytes.begin(), bytes.end());
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  for (auto at = text.find(kName); at != std::string_view::npos; at = text.find(kName, at + 1)) {
    std::memcpy(out.data() + at, kHiddenPostRotation, kName.size());
  }
  return out;
}

unsigned import_flags() {
  return aiProcess_Triangulate | aiProcess_JoinIdenticalVertices | aiProcess_GenSmoothNormals |
         aiProcess_SortByPType | aiProcess_FlipUVs;
}

}  // namespace

const aiScene* load_assimp_scene(Assimp::Importer& importer, std::span<const std::byte> bytes,
                                 std::string_view format, const UriResolver& resolver,
                                 const ImportOptions& options) {
  std::vector<std::byte> patched;
  if (format == "fbx") {
    check_fbx_version(bytes);
    patched = hide_post_rotations(bytes);
    bytes = patched;
  }
  keep_only(importer, format);
  const std::string name = fmt::format("input.{}", format);
  importer.SetIOHandler(new ConfinedIo(bytes, name, resolver));  // the importer owns it
  importer.SetPropertyBool(AI_CONFIG_IMPORT_FBX_PRESERVE_PIVOTS, true);
  importer.SetPropertyBool(AI_CONFIG_IMPORT_FBX_READ_CAMERAS, false);
  importer.SetPropertyBool(AI_CONFIG_IMPORT_FBX_READ_LIGHTS, false);
  importer.SetPropertyBool(AI_CONFIG_IMPORT_NO_SKELETON_MESHES, true);
  importer.SetPropertyBool(AI_CONFIG_IMPORT_COLLADA_IGNORE_UP_DIRECTION, options.up.has_value());
  importer.SetPropertyInteger(AI_CONFIG_PP_SBP_REMOVE,
                              aiPrimitiveType_LINE | aiPrimitiveType_POINT);
  const aiScene* scene = nullptr;
  try {
    scene = importer.ReadFile(name, import_flags());
  } catch (const std::bad_alloc&) {
    throw;
  } catch (const std::exception& e) {
    fail("assimp-rejected", e.what(), "re-export the file, or convert it to GLB");
  }
  if (scene == nullptr || scene->mRootNode == nullptr) {
    const std::string reason = importer.GetErrorString();
    if (reason.find("bad_alloc") != std::string::npos) throw std::bad_alloc();
    fail("assimp-rejected", reason.empty() ? "the file holds no scene" : reason,
         "re-export the file, or convert it to GLB");
  }
  return scene;
}

}  // namespace limber
