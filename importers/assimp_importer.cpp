#include "importers/assimp_importer.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <optional>
#include <string>
#include <utility>

#include "importers/assimp_scene.h"
#include "importers/failure.h"
#include "importers/fbx_losses.h"
#include "importers/figure_guess.h"
#include "importers/joint_names.h"

namespace limber {
namespace {

/// Heights between which a unit that the file states is believed, as shares of an adult's.
constexpr double kSmallestFigure = 0.3 / 1.72;
constexpr double kLargestFigure = 4.0 / 1.72;

struct Import {
  const aiScene& scene;
  std::string_view text;
  std::string format;
  const ImportOptions& options;
  NodeTree tree;
  JointTree joints;
  CanonicalSpace space;
  bool size_unknown = false;  ///< the stated unit is absurd and no known one fits
  Imported out;

  Import(const aiScene& s, std::string_view t, std::string f, const ImportOptions& o)
      : scene(s), text(t), format(std::move(f)), options(o), tree(s) {
    joints = find_joints(scene, tree, format);
  }
};

template <class T>
bool read_metadata(const aiScene& scene, const char* key, T& value) {
  return scene.mMetaData != nullptr && scene.mMetaData->Get(key, value);
}

/// The metres of Collada's <unit meter="...">; 1 where it says none.
double collada_unit_m(std::string_view text) {
  const std::size_t unit = text.find("<unit");
  if (unit == std::string_view::npos) return 1.0;
  const std::string_view element = text.substr(unit, text.find('>', unit) - unit);
  const std::size_t at = element.find("meter=");
  if (at == std::string_view::npos || at + 7 >= element.size()) return 1.0;
  double metres = 1.0;
  const auto parsed =
      std::from_chars(element.data() + at + 7, element.data() + element.size(), metres);
  return parsed.ec == std::errc() && metres > 0.0 && std::isfinite(metres) ? metres : 1.0;
}

/// The file's up axis. Collada: assimp has already turned the root, unless `options.up` forbade it.
std::string stated_up(const Import& import) {
  if (import.format == "dae") {
    const bool z = import.text.find("Z_UP") != std::string_view::npos;
    return z ? "+Z" : import.text.find("X_UP") != std::string_view::npos ? "+X" : "+Y";
  }
  std::int32_t axis = 1, sign = 1;
  if (import.format == "fbx") {
    read_metadata(import.scene, "UpAxis", axis);
    read_metadata(import.scene, "UpAxisSign", sign);
  }
  if (axis < 0 || axis > 2) axis = 1;
  return std::string(sign < 0 ? "-" : "+") + "XYZ"[axis];
}

/// FBX also says which axis points to the figure's left and which to its front. nullopt where
/// that is left out, or makes no right-handed space with the up axis.
std::optional<Eigen::Quaterniond> stated_axes(const aiScene& scene) {
  const std::array<std::pair<const char*, const char*>, 3> names = {
      {{"CoordAxis", "CoordAxisSign"}, {"UpAxis", "UpAxisSign"}, {"FrontAxis", "FrontAxisSign"}}};
  Eigen::Matrix3d canonical_from_file = Eigen::Matrix3d::Zero();
  for (int row = 0; row < 3; ++row) {
    std::int32_t axis = -1, sign = 1;
    read_metadata(scene, names[row].first, axis);
    read_metadata(scene, names[row].second, sign);
    if (axis < 0 || axis > 2) return std::nullopt;
    canonical_from_file(row, axis) = sign < 0 ? -1.0 : 1.0;
  }
  if (canonical_from_file.determinant() != 1.0) return std::nullopt;
  return Eigen::Quaterniond(canonical_from_file);
}

/// A skeleton in file space: rest pose folded, neither scaled to metres nor turned upright.
void read_skeleton(Import& import) {
  Character& character = import.out.character;
  Skeleton& skeleton = character.skeleton;
  skeleton.parents = import.joints.parents;
  for (const std::int32_t node : import.joints.node_of_joint) {
    skeleton.names.push_back(import.tree.names[node]);
  }
  make_names_valid(skeleton.names, std::vector<std::uint8_t>(skeleton.names.size(), 0), "joint_",
                   import.out.warnings);
  skeleton.rest_parent_from_joint =
      fold_pose(import.joints, import.tree.world(import.tree.local), {});
  const bool skinned = std::find(import.joints.skinned.begin(), import.joints.skinned.end(), 1) !=
                       import.joints.skinned.end();
  character.deforming = import.joints.skinned;
  if (!skinned) character.deforming.assign(skeleton.parents.size(), 1);
  character.roles.assign(skeleton.parents.size(), "");
}

void choose_up(Import& import, const Clip* clip) {
  SourceFacts& facts = import.out.facts;
  facts.up = stated_up(import);
  if (import.format == "bvh") facts.up = guess_up(import.out.character.skeleton, clip).up;
  if (import.options.up) {
    facts.up = *import.options.up == 'z' || *import.options.up == 'Z' ? "+Z" : "+Y";
  }
  const bool turned_by_assimp = import.format == "dae" && !import.options.up;
  if (turned_by_assimp) return;
  import.space.canonical_from_file = canonical_from_up(facts.up);
  if (import.format == "fbx" && !import.options.up) {
    import.space.canonical_from_file =
        stated_axes(import.scene).value_or(import.space.canonical_from_file);
  }
}

/// What the file states, in metres per unit of assimp's scene.
double stated_unit_m(Import& import) {
  SourceFacts& facts = import.out.facts;
  if (import.format == "fbx") {
    double factor = 1.0;
    float narrow = 1.0F;
    if (!read_metadata(import.scene, "UnitScaleFactor", factor) &&
        read_metadata(import.scene, "UnitScaleFactor", narrow)) {
      factor = narrow;
    }
    if (!(factor > 0.0) || !std::isfinite(factor)) factor = 1.0;
    facts.unit_evidence = fmt::format("UnitScaleFactor {:.6g} cm", factor);
    return 0.01 * factor;
  }
  facts.unit_evidence = import.format == "dae"
                            ? fmt::format("<unit> of {:.6g} m", collada_unit_m(import.text))
                        : import.format == "x" ? "DirectX files state no unit"
                                               : "glTF is in metres";
  return 1.0;
}

/// Whether the guess contradicts a stated unit: a figure under 0.3 or above 4 m.
bool implausible(const UnitGuess& guess) {
  if (guess.evidence.starts_with("no head and feet")) return false;  // not known to be a person
  if (guess.unit_m == 1.0) return false;
  if (guess.plausible) return true;  // some other unit makes it human, ten times off or more
  const double share = 1.0 / guess.unit_m;
  return share < kSmallestFigure || share > kLargestFigure;
}

void choose_unit(Import& import, const Clip* clip, std::string_view up_of_scene) {
  SourceFacts& facts = import.out.facts;
  const Skeleton& skeleton = import.out.character.skeleton;
  const double folded = import.format == "dae" ? collada_unit_m(import.text) : 1.0;
  if (import.options.unit_m) {
    facts.unit_m = *import.options.unit_m;
    facts.unit_evidence = "given by option";
    import.space.unit_m = facts.unit_m / folded;
    return;
  }
  if (import.format == "bvh") {
    const UnitGuess guess = guess_unit(skeleton, clip, up_of_scene);
    facts.unit_m = import.space.unit_m = guess.unit_m;
    facts.unit_evidence = guess.evidence;
    return;
  }
  const double stated = stated_unit_m(import);
  Skeleton metric = skeleton;
  make_canonical(metric, metric.rest_parent_from_joint, stated, Eigen::Quaterniond::Identity());
  Clip metric_clip;
  if (clip != nullptr) {
    metric_clip = *clip;
    make_canonical(metric, metric_clip.parent_from_joint, stated, Eigen::Quaterniond::Identity());
  }
  const UnitGuess guess = guess_unit(metric, clip != nullptr ? &metric_clip : nullptr, up_of_scene);
  import.space.unit_m = stated;
  const bool certain =
      import.format == "gltf" || import.format == "glb";  // metres, by the standard
  if (!certain && implausible(guess)) {
    import.space.unit_m = stated * guess.unit_m;
    import.size_unknown = !guess.plausible;
    facts.unit_evidence += fmt::format(", but taken as metres: {}", guess.evidence);
    import.out.warnings.push_back(
        {.code = "unit-guessed",
         .message = fmt::format("1 unit = {:.4g} m ({})", import.space.unit_m * folded,
                                facts.unit_evidence)});
  }
  facts.unit_m = import.space.unit_m * folded;
}

void set_facts(Import& import) {
  SourceFacts& facts = import.out.facts;
  facts.format = import.format;
  facts.reader = "assimp";
  facts.reader_reason = "asked for";
  facts.clips = static_cast<std::int64_t>(import.out.clips.size());
  const auto& skinned = import.joints.skinned;
  const auto bones = std::count(skinned.begin(), skinned.end(), 1);
  facts.joints = bones > 0 ? bones : import.joints.size();
  if (!import.out.clips.empty()) {
    facts.rate_hz = import.out.clips[0].rate_hz;
    facts.frames = import.out.clips[0].frames();
  }
}

/// Multiplies all lengths of the skeleton and its clips, and turns them upright.
void transform(Imported& out, double scale, const Eigen::Quaterniond& turn) {
  Skeleton& skeleton = out.character.skeleton;
  make_canonical(skeleton, skeleton.rest_parent_from_joint, scale, turn);
  for (Clip& c : out.clips) make_canonical(skeleton, c.parent_from_joint, scale, turn);
}

void read_figure(Import& import, const UriResolver& resolver) {
  read_assimp_figure(import.scene, import.tree, import.joints, import.space, import.format,
                     resolver, import.out.character, import.out.warnings);
}

/// Height of the skin at binding.
double skin_height(const Character& character) {
  double low = 1e300, high = -1e300;
  if (character.bind_model_from_joint.empty()) return 0.0;
  for (const Mesh& mesh : character.meshes) {
    std::vector<Eigen::Vector3f> posed(mesh.positions.size());
    skin_positions(mesh, character.bind_model_from_joint, posed);
    for (const Eigen::Vector3f& p : posed) {
      low = std::min<double>(low, p.y());
      high = std::max<double>(high, p.y());
    }
  }
  return high - low;
}

/// Where no unit is known, a skin tells the person's height better than its bones do.
void size_by_skin(Import& import, const UriResolver& resolver) {
  constexpr double kStature = 1.72;
  Imported& out = import.out;
  const double height = skin_height(out.character);
  if (!import.size_unknown || !(height > 0.1) || !std::isfinite(height)) return;
  const double ratio = kStature / height;
  transform(out, ratio, Eigen::Quaterniond::Identity());
  out.facts.unit_m *= ratio;
  out.facts.unit_evidence += fmt::format("; the skin is {:.4g} units high, scaled to {:.3g} m",
                                         height / import.space.unit_m, kStature);
  import.space.unit_m *= ratio;
  std::erase_if(out.warnings, [](const Warning& w) {
    return w.code.starts_with("weights-") || w.code.starts_with("texture-") ||
           w.code.starts_with("mesh-") || w.code == "unit-guessed";
  });
  out.warnings.push_back({.code = "unit-guessed",
                          .message = fmt::format("1 unit = {:.4g} m ({})", out.facts.unit_m,
                                                 out.facts.unit_evidence)});
  out.character.meshes.clear();
  out.character.materials.clear();
  out.character.textures.clear();
  read_figure(import, resolver);
}

Result<Imported> import_scene(Import& import, const UriResolver& resolver) {
  Imported& out = import.out;
  read_skeleton(import);
  out.clips =
      read_assimp_clips(import.scene, import.tree, import.joints, {}, import.format, out.warnings);
  const Clip* clip = out.clips.empty() ? nullptr : &out.clips[0];
  choose_up(import, clip);
  const bool upright = import.format == "dae" && !import.options.up;
  choose_unit(import, clip, upright ? "+Y" : out.facts.up);
  transform(out, import.space.unit_m, import.space.canonical_from_file);
  read_figure(import, resolver);
  size_by_skin(import, resolver);
  set_facts(import);
  if (import.format == "fbx") {
    tell_fbx_losses(std::as_bytes(std::span(import.text)), out.clips, import.space.unit_m,
                    out.warnings);
  }
  if (auto r = validate(out.character); !r) return r.error();
  for (const Clip& c : out.clips) {
    if (auto r = validate(out.character.skeleton, c); !r) return r.error();
  }
  return std::move(out);
}

std::string lower_case(std::string_view text) {
  std::string out(text.starts_with('.') ? text.substr(1) : text);
  for (char& c : out) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  return out == "vrm" ? "glb" : out;
}

}  // namespace

Result<Imported> import_with_assimp(std::span<const std::byte> bytes, std::string_view extension,
                                    const UriResolver& resolver, const ImportOptions& options) {
  return guarded<Imported>([&]() -> Result<Imported> {
    const std::string format = lower_case(extension);
    Assimp::Importer importer;
    const aiScene* scene = load_assimp_scene(importer, bytes, format, resolver, options);
    const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    Import import(*scene, text, format, options);
    return import_scene(import, resolver);
  });
}

}  // namespace limber
