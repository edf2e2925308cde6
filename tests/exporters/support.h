#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "assets/model/character.h"
#include "assets/model/clip.h"
#include "importers/importer.h"
#include "tests/model/random_motion.h"

namespace limber::test {

inline std::vector<std::byte> to_bytes(std::string_view text) {
  const auto* p = reinterpret_cast<const std::byte*>(text.data());
  return {p, p + text.size()};
}

inline std::string read_text(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

inline void write_file(const std::filesystem::path& path, std::span<const std::byte> bytes) {
  std::ofstream(path, std::ios::binary)
      .write(reinterpret_cast<const char*>(bytes.data()),
             static_cast<std::streamsize>(bytes.size()));
}

/// The folder of shared data, or empty where this machine has none.
inline std::filesystem::path shared_folder() {
  if (const char* given = std::getenv("LIMBER_SHARED")) return given;
  const std::filesystem::path beside =
      std::filesystem::path(LIMBER_SOURCE_DIR).parent_path() / "shared";
  return std::filesystem::is_directory(beside) ? beside : std::filesystem::path();
}

/// A folder for this test's files.
inline std::filesystem::path scratch_folder() {
  const auto* info = testing::UnitTest::GetInstance()->current_test_info();
  std::string name = std::string(info->test_suite_name()) + "." + info->name();
  std::replace(name.begin(), name.end(), '/', '_');
  const std::filesystem::path folder = std::filesystem::path(testing::TempDir()) / "limber" / name;
  std::filesystem::create_directories(folder);
  return folder;
}

inline UriResolver no_files() {
  return [](std::string_view) -> Result<std::vector<std::byte>> {
    return Error{"uri-refused", "no files here"};
  };
}

inline Result<Imported> read_back(std::span<const std::byte> bytes, std::string_view extension,
                                  ReaderChoice reader) {
  ImportOptions options;
  options.reader = reader;
  if (extension == "bvh") {
    options.unit_m = 0.01;
    options.up = 'y';
    options.keep_reference_frame = true;
  }
  return import_bytes(bytes, extension, no_files(), options);
}

/// A tree of joints with rest poses at random, names 'j0', 'j1', ...
inline Skeleton random_skeleton(int joints, Random& random) {
  Skeleton skeleton;
  for (int j = 0; j < joints; ++j) {
    skeleton.names.push_back("j" + std::to_string(j));
    skeleton.parents.push_back(j == 0 ? kNoJoint : random.integer(std::max(0, j - 3), j - 1));
    skeleton.rest_parent_from_joint.push_back(DualQuaternion::from_rotation_translation(
        random.rotation(), 0.1 * random.unit() + 0.2 * random.vector()));
  }
  return skeleton;
}

inline Character bare_character(Skeleton skeleton) {
  Character character;
  character.name = "test";
  character.deforming.assign(skeleton.parents.size(), 1);
  character.roles.assign(skeleton.parents.size(), "");
  character.skeleton = std::move(skeleton);
  return character;
}

/// Every joint turns by a few tens of degrees a frame at random; the root, and `sliding` if it is a
/// joint, also moves.
inline Clip random_clip(const Skeleton& skeleton, int frames, Random& random, int sliding = -1) {
  Clip clip;
  clip.name = "wander";
  clip.rate_hz = 120.0;
  clip.joints = skeleton.size();
  std::vector<DualQuaternion> pose = skeleton.rest_parent_from_joint;
  for (int f = 0; f < frames; ++f) {
    for (int j = 0; j < skeleton.size(); ++j) {
      Eigen::Vector3d t = pose[j].translation();
      if (skeleton.parents[j] == kNoJoint || j == sliding) t += random.vector(0.05);
      const Eigen::Quaterniond r = (pose[j].rotation() * random.small_rotation(0.6)).normalized();
      pose[j] = DualQuaternion::from_rotation_translation(r, t).normalized();
      clip.parent_from_joint.push_back(pose[j]);
    }
  }
  return clip;
}

/// A mesh whose vertices hang on up to `influences` joints, in a space of its own scale.
inline Mesh random_mesh(const Skeleton& skeleton, int vertices, int influences, Random& random) {
  Mesh mesh;
  mesh.name = "skin";
  for (int j = 0; j < skeleton.size(); ++j) {
    Eigen::Matrix4d m = random.motion().matrix();
    m.topLeftCorner<3, 3>() *= 0.01;
    mesh.skin.push_back({j, m});
  }
  for (int v = 0; v < vertices; ++v) {
    mesh.positions.push_back(random.vector(20.0).cast<float>());
    mesh.normals.push_back(random.unit().cast<float>());
    mesh.uvs.push_back(random.vector().head<2>().cast<float>());
    mesh.influence_begin.push_back(static_cast<std::uint32_t>(mesh.influences.size()));
    const int first = random.integer(0, skeleton.size() - 1);
    for (int i = 0; i < influences; ++i) {
      mesh.influences.push_back({static_cast<std::uint32_t>((first + i) % skeleton.size()),
                                 1.0F / static_cast<float>(influences)});
    }
  }
  mesh.influence_begin.push_back(static_cast<std::uint32_t>(mesh.influences.size()));
  for (int v = 0; v + 2 < vertices; ++v) {
    for (int k = 0; k < 3; ++k) mesh.triangles.push_back(static_cast<std::uint32_t>(v + k));
  }
  return mesh;
}

struct Difference {
  double metres = 0.0, radians = 0.0;
  int joints = 0;  ///< compared
};

/// The largest difference in model space over all frames, joints matched by name.
inline Difference compare(const Skeleton& a, const Clip& clip_a, const Skeleton& b,
                          const Clip& clip_b) {
  Difference worst;
  std::vector<DualQuaternion> model_a(a.parents.size()), model_b(b.parents.size());
  for (std::int64_t f = 0; f < clip_a.frames(); ++f) {
    model_from_local(a, clip_a.frame(f), model_a);
    model_from_local(b, clip_b.frame(f), model_b);
    worst.joints = 0;
    for (std::int32_t j = 0; j < a.size(); ++j) {
      const std::int32_t k = b.find(a.names[j]);
      if (k == kNoJoint) continue;
      ++worst.joints;
      worst.metres =
          std::max(worst.metres, (model_a[j].translation() - model_b[k].translation()).norm());
      worst.radians =
          std::max(worst.radians, rotation_angle(model_a[j].rotation(), model_b[k].rotation()));
    }
  }
  return worst;
}

}  // namespace limber::test
