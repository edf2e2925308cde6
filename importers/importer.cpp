#include "importers/importer.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>

#include "importers/assimp_importer.h"
#include "importers/bvh_reader.h"
#include "importers/failure.h"
#include "importers/file_resolver.h"
#include "importers/gltf_reader.h"
#include "importers/memory_pages.h"
#include "importers/reference_frame.h"
#include "importers/text_encoding.h"

namespace limber {

namespace {

/// What assimp reads soundly enough to offer (see docs), besides our own bvh, gltf, glb and vrm.
constexpr std::array kAssimpExtensions = {"fbx", "dae", "x"};
constexpr std::array kOwnExtensions = {"bvh", "gltf", "glb", "vrm"};

std::string lower_case(std::string_view text) {
  std::string out(text.starts_with('.') ? text.substr(1) : text);
  for (char& c : out) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  return out;
}

std::string_view as_text(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

bool starts_with_any_case(std::string_view text, std::string_view lower) {
  return text.size() >= lower.size() && lower_case(text.substr(0, lower.size())) == lower;
}

/// The first bytes after a byte order mark and white space.
std::string_view opening(std::string_view text) {
  if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);
  const std::size_t begin = text.find_first_not_of(" \t\r\n");
  return begin == std::string_view::npos ? std::string_view{} : text.substr(begin);
}

/// What no reader can use, whatever the file is called; nullptr where nothing is known against it.
const char* known_stranger(std::string_view text) {
  const std::string_view head = opening(text);
  if (text.starts_with("version https://git-lfs")) {
    return "a Git LFS pointer, not the file itself (run 'git lfs pull')";
  }
  if (starts_with_any_case(head, "<!doctype html") || starts_with_any_case(head, "<html")) {
    return "a web page, not an animation (the download went wrong)";
  }
  if (text.starts_with("\x1F\x8B")) return "gzip data (unpack it first)";
  if (text.starts_with("PK\x03\x04")) return "a zip archive (unpack it first)";
  if (text.starts_with("\x28\xB5\x2F\xFD")) return "zstd data (unpack it first)";
  if (text.starts_with("7z\xBC\xAF")) return "a 7z archive (unpack it first)";
  if (text.starts_with("%PDF")) return "a PDF document";
  if (text.starts_with("\x89PNG") || text.starts_with("\xFF\xD8\xFF")) return "a picture";
  return nullptr;
}

/// The family that the content shows: "bvh", "glb", "gltf", "fbx", "dae", "x" or "" (not
/// recognised).
std::string content_family(std::string_view text) {
  const std::string_view head = opening(text);
  if (text.starts_with("glTF")) return "glb";
  if (text.starts_with("Kaydara FBX Binary") || head.starts_with("; FBX")) return "fbx";
  if (text.starts_with("xof ")) return "x";
  if (starts_with_any_case(head, "hierarchy")) return "bvh";
  if (head.starts_with("{")) return "gltf";
  if (head.starts_with("<") && head.substr(0, 4096).find("<COLLADA") != std::string_view::npos) {
    return "dae";
  }
  return "";
}

std::string family_of(const std::string& extension) {
  return extension == "vrm" ? "glb" : extension;
}

Error stranger_error(const std::string& extension, const std::string& what) {
  return {.code = "format-mismatch",
          .message = fmt::format("the file is called .{} but is {}", extension, what),
          .hint = "get the file again, or give it the extension of what it holds"};
}

/// Says why the content cannot be what the name claims.
Result<void> check_content(std::string_view text, const std::string& extension) {
  if (text.empty()) {
    return Error{.code = "file-empty", .message = "the file is empty", .hint = "get it again"};
  }
  if (const char* stranger = known_stranger(text)) return stranger_error(extension, stranger);
  const std::string family = content_family(text);
  const std::string claimed = family_of(extension);
  const bool own_json =
      (family == "gltf" || family == "glb") && (claimed == "gltf" || claimed == "glb");
  if (!family.empty() && family != claimed && !own_json) {
    return stranger_error(extension, family + " by its content");
  }
  return {};
}

/// A UTF-16 text file in UTF-8; nullopt where it is none.
std::optional<std::string> from_utf16(std::string_view text) {
  if (text.starts_with("\xFF\xFE")) return to_utf8(text.substr(2), "UTF-16LE");
  if (text.starts_with("\xFE\xFF")) return to_utf8(text.substr(2), "UTF-16BE");
  return std::nullopt;
}

Result<Imported> dispatch(std::span<const std::byte> bytes, const std::string& extension,
                          const UriResolver& resolver, const ImportOptions& options) {
  const bool own =
      std::find(kOwnExtensions.begin(), kOwnExtensions.end(), extension) != kOwnExtensions.end();
  if (options.reader == ReaderChoice::assimp || !own) {
    Result<Imported> imported = import_with_assimp(bytes, extension, resolver, options);
    if (imported) {
      imported->facts.reader_reason =
          own ? "asked for by option" : "no reader of our own for this format";
      if (!options.keep_reference_frame) drop_any_reference_frame(*imported);
    }
    return imported;
  }
  Result<Imported> imported = extension == "bvh" ? import_bvh(bytes, options)
                                                 : import_gltf(bytes, extension, resolver, options);
  if (imported) imported->facts.reader_reason = "our exact reader for this format";
  return imported;
}

/// Nobody means a figure that is larger than the Earth; sums of such lengths overflow.
Result<void> check_sizes(const Skeleton& skeleton, std::span<const DualQuaternion> poses) {
  constexpr double kEarth_m = 1.3e7;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    if (4.0 * poses[i].dual.squaredNorm() < kEarth_m * kEarth_m) continue;  // |t|^2
    const std::size_t joints = skeleton.names.size();
    return Error{.code = "size-absurd",
                 .message = "a joint stands farther from its parent than the Earth is wide",
                 .joint = skeleton.names[i % joints],
                 .frame = poses.size() > joints ? static_cast<std::int64_t>(i / joints) : -1,
                 .hint = "the file is damaged, or --unit is wrong"};
  }
  return {};
}

Result<void> check_invariants(const Imported& imported) {
  const Skeleton& skeleton = imported.character.skeleton;
  if (Result<void> valid = validate(imported.character); !valid) return valid;
  if (auto sane = check_sizes(skeleton, skeleton.rest_parent_from_joint); !sane) return sane;
  for (const Clip& clip : imported.clips) {
    if (Result<void> valid = validate(skeleton, clip); !valid) return valid;
    if (auto sane = check_sizes(skeleton, clip.parent_from_joint); !sane) return sane;
  }
  return {};
}

/// Errors travel into JSON reports: whatever a file put into them must be UTF-8.
Error with_clean_text(Error error) {
  std::array<std::string, 2> texts = {error.message, error.joint};
  repair_names(texts);
  error.message = std::move(texts[0]);
  error.joint = std::move(texts[1]);
  return error;
}

/// Why files of a kind are not read, where there is more to say than that.
const char* reason_against(std::string_view kind) {
  struct Refusal {
    std::string_view kind;
    const char* reason;
  };
  constexpr const char* kSurface = "they hold surfaces, neither joints nor motion";
  constexpr const char* kUnsafe = "damaged ones crash the reader that assimp has for them";
  constexpr const char* kProject = "they are an editor's own: export GLB or FBX from it";
  constexpr auto kRefusals = std::to_array<Refusal>({{"obj", kSurface},
                                                     {"stl", kSurface},
                                                     {"ply", kSurface},
                                                     {"off", kSurface},
                                                     {"md5mesh", kUnsafe},
                                                     {"md5anim", kUnsafe},
                                                     {"mdl", kUnsafe},
                                                     {"smd", kUnsafe},
                                                     {"blend", kProject},
                                                     {"ma", kProject},
                                                     {"mb", kProject},
                                                     {"max", kProject}});
  for (const Refusal& refusal : kRefusals) {
    if (refusal.kind == kind) return refusal.reason;
  }
  return nullptr;
}

Result<Imported> import_checked(std::span<const std::byte> bytes, std::string_view extension,
                                const UriResolver& resolver, const ImportOptions& options) {
  const std::string kind = lower_case(extension);
  const std::vector<std::string> readable = readable_extensions();
  if (std::find(readable.begin(), readable.end(), kind) == readable.end()) {
    const char* const reason = reason_against(kind);
    return Error{
        .code = "format-unknown",
        .message = fmt::format("files called .{} cannot be read{}{}", kind,
                               reason != nullptr ? ": " : "", reason != nullptr ? reason : ""),
        .hint = fmt::format("readable are {}", fmt::join(readable, ", "))};
  }
  const std::optional<std::string> converted = from_utf16(as_text(bytes));
  if (converted) bytes = std::as_bytes(std::span(*converted));
  if (Result<void> fits = check_content(as_text(bytes), kind); !fits) return fits.error();
  ImportOptions told = options;
  if (converted) told.on_passed = {};  // those are not the file's bytes
  Result<Imported> imported = dispatch(bytes, kind, resolver, told);
  if (!imported) return imported;
  if (converted) imported->warnings.push_back({"text-encoding", "the file is UTF-16 text"});
  if (Result<void> valid = check_invariants(*imported); !valid) return valid.error();
  return imported;
}

/// The folder's resolver, which also tells of what is asked for and may be asked for.
UriResolver telling_resolver(const std::filesystem::path& folder, const ImportOptions& options) {
  UriResolver resolve = folder_resolver(folder);
  if (!options.on_reference) return resolve;
  return [resolve, folder, tell = options.on_reference](std::string_view uri) {
    Result<std::vector<std::byte>> bytes = resolve(uri);
    const bool refused = !bytes && bytes.error().code == "uri-refused";
    if (!refused && !uri.starts_with("data:")) {
      tell(folder / percent_decoded(uri).value_or(std::string(uri)));
    }
    return bytes;
  };
}

}  // namespace

Result<Imported> import_bytes(std::span<const std::byte> bytes, std::string_view extension,
                              const UriResolver& resolver, const ImportOptions& options) {
  Result<Imported> imported = guarded<Imported>(
      [&]() -> Result<Imported> { return import_checked(bytes, extension, resolver, options); });
  if (!imported) return with_clean_text(std::move(imported.error()));
  return imported;
}

Result<Imported> import_file(const std::filesystem::path& path, const ImportOptions& options) {
  Result<Imported> imported = guarded<Imported>([&]() -> Result<Imported> {
    Result<std::vector<std::byte>> bytes = read_whole_file(path);
    if (!bytes) return bytes.error();
    ImportOptions telling = options;
    telling.on_passed = [&, kept = std::size_t{0}](std::size_t passed) mutable {
      forget_pages(std::span(*bytes).subspan(kept, passed - kept));
      kept = passed;
    };
    return import_bytes(*bytes, path.extension().string(),
                        telling_resolver(path.parent_path(), options), telling);
  });
  if (!imported) imported.error().file = path.string();
  return imported;
}

std::vector<std::string> readable_extensions() {
  std::vector<std::string> all(kOwnExtensions.begin(), kOwnExtensions.end());
  all.insert(all.end(), kAssimpExtensions.begin(), kAssimpExtensions.end());
  return all;
}

}  // namespace limber
