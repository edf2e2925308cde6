#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "assets/model/character.h"
#include "assets/model/clip.h"
#include "assets/model/result.h"

namespace limber {

/// Which code reads a file. `automatic`: our exact readers for BVH and glTF (.gltf, .glb, .vrm),
/// assimp for every other format. `assimp`: assimp for any format.
enum class ReaderChoice : std::uint8_t { automatic, assimp };

struct ImportOptions {
  ReaderChoice reader = ReaderChoice::automatic;
  std::optional<double> unit_m;  ///< metres per file unit; overrides what the file says or implies
  std::optional<char> up;        ///< 'y' or 'z'; overrides likewise
  /// Keep frame 0 even where it is the separate T-pose of a MotionBuilder conversion.
  bool keep_reference_frame = false;
  /// Told of every file beside it that a file refers to, whether it is there or not; import_file
  /// alone calls it.
  std::function<void(const std::filesystem::path&)> on_reference = {};
  /// Told how many of the first bytes of a BVH will not be looked at again; import_file alone sets
  /// it, and gives their memory back: a long motion need not stand beside its text.
  std::function<void(std::size_t)> on_passed = {};
};

/// What the file was before it became canonical; `limber inspect` prints it.
struct SourceFacts {
  std::string format;  ///< bvh, gltf, glb, vrm, fbx, dae, ...
  std::string reader;  ///< limber-bvh, limber-gltf or assimp
  std::string reader_reason;
  double unit_m = 1.0;        ///< metres per file unit
  std::string unit_evidence;  ///< how that was known or guessed
  std::string up = "+Y";      ///< of the file: +Y, +Z, -Y, ...
  double rate_hz = 0.0;       ///< of the first clip; 0 where there is none
  std::int64_t frames = 0;    ///< raw frames of the first clip, a dropped reference frame included
  std::int64_t joints = 0;    ///< joints, End Sites not counted (skin joints, for a skinned file)
  std::int64_t clips = 0;
  bool reference_frame_dropped = false;
};

/// A file in canonical space: metres, Y up, right-handed, no scale, unit rotations. Every invariant
/// of Character and Clip has been checked.
struct Imported {
  Character character;
  std::vector<Clip> clips;
  /// The pose held by a dropped reference frame (frame 0 of a MotionBuilder conversion); else
  /// empty.
  Pose reference_pose;
  SourceFacts facts;
  Warnings warnings;
};

/// Returns the bytes of a URI that a file refers to, or an error where it may not be read.
using UriResolver = std::function<Result<std::vector<std::byte>>(std::string_view uri)>;

/// `extension` without dot, any case. Errors name a stable code, and the joint and frame if known;
/// the caller adds the file.
Result<Imported> import_bytes(std::span<const std::byte> bytes, std::string_view extension,
                              const UriResolver&, const ImportOptions& = {});

/// Reads the file and whatever it refers to inside its own folder (no absolute path, no "..", no
/// link out, regular files only).
Result<Imported> import_file(const std::filesystem::path&, const ImportOptions& = {});

/// Extensions that can be read, lower case, without dot.
std::vector<std::string> readable_extensions();

}  // namespace limber
