// Our second reading of FBX animation curves, and what it says that assimp's loses.

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>
#include <random>

#include "importers/failure.h"
#include "importers/fbx_curves.h"
#include "importers/fbx_nodes.h"
#include "tests/importers/fbx_writer.h"
#include "tests/importers/support.h"

namespace limber::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

/// Every way to write the same nodes.
std::vector<std::string> all_forms(const std::vector<FbxOut>& nodes) {
  return {ascii_fbx(nodes), FbxBinary{}.write(nodes), FbxBinary{.deflate = true}.write(nodes),
          FbxBinary{.version = 7700}.write(nodes),
          FbxBinary{.version = 7500, .deflate = true}.write(nodes)};
}

Result<Imported> read_cm(std::string_view file) {
  ImportOptions options;
  options.unit_m = 0.01;
  return import_text(file, "fbx", options);
}

const Warning* warning_of(const Imported& imported, std::string_view code) {
  for (const Warning& warning : imported.warnings) {
    if (warning.code == code) return &warning;
  }
  return nullptr;
}

/// The figure before a word, as "8.66" before "degrees"; -1 where there is none.
double figure_before(const std::string& message, const std::string& word) {
  const auto end = message.find(" " + word);
  if (end == std::string::npos) return -1.0;
  const auto begin = message.rfind(' ', end - 1);
  return std::strtod(message.c_str() + begin, nullptr);
}

// ---- nodes

TEST(FbxNodes, AllFormsOfAFileSayTheSame) {
  const auto nodes = animated_fbx({{.keys = {{0.0, 1.5F, kFbxUser, 2.0F, -3.0F}, {0.5, -2.25F}}}});
  for (const std::string& form : all_forms(nodes)) {
    const auto curves = read_fbx_curves(bytes_of(form));
    ASSERT_EQ(curves.size(), 1U);
    EXPECT_EQ(curves[0].take, "walk");
    EXPECT_EQ(curves[0].layer, "Base");
    EXPECT_EQ(curves[0].joint, "Hips");
    EXPECT_EQ(curves[0].property, FbxProperty::rotation);
    EXPECT_EQ(curves[0].axis, 0);
    ASSERT_EQ(curves[0].keys.size(), 2U);
    const FbxKey& key = curves[0].keys[0];
    EXPECT_EQ(key.interpolation, FbxInterpolation::cubic);
    EXPECT_EQ(key.value, 1.5);
    EXPECT_EQ(key.slope, 2.0);
    EXPECT_EQ(key.next_slope, -3.0);
    EXPECT_NEAR(curves[0].keys[1].time_s, 0.5, 1e-9);
    EXPECT_EQ(curves[0].keys[1].value, -2.25);
  }
}

TEST(FbxNodes, WhatIsNotWantedIsPassedOver) {
  const std::vector<FbxOut> nodes = {
      {"Left", {std::string("a; b { } \"")}, {{"Wanted", {std::int64_t{1}}}}},
      {"Wanted", {std::int64_t{2}, std::string("x")}, {{"Other", {2.5}}, {"Wanted", {-7.5}}}}};
  const std::array<std::string_view, 1> wanted = {"Wanted"};
  for (std::string form : all_forms(nodes)) {
    if (const auto quote = form.find("\"a; b { } \"\""); quote != std::string::npos) {
      form.erase(quote + 10, 1);  // ASCII has no quote within a text
    }
    const auto found = read_fbx_nodes(bytes_of(form), wanted);
    ASSERT_EQ(found.size(), 1U);
    EXPECT_EQ(found[0].integer(0), 2);
    EXPECT_EQ(found[0].text(1), "x");
    ASSERT_EQ(found[0].children.size(), 1U);
    EXPECT_EQ(std::get<double>(found[0].children[0].values[0]), -7.5);
  }
}

/// Cut anywhere, or with any byte changed: nodes or a refusal, within the memory of the file.
TEST(FbxNodes, DamageIsRefusedOrRead) {
  const auto nodes = animated_fbx({{.keys = {{0.0, 1.0F, kFbxUser, 2.0F, 3.0F}, {0.5, 2.0F}}}});
  std::mt19937 random(5);
  int refused = 0;
  const auto try_reading = [&](const std::string& damaged) {
    const auto read = guarded<std::size_t>(
        [&]() -> Result<std::size_t> { return read_fbx_curves(bytes_of(damaged)).size(); });
    if (read) return;
    ++refused;
    EXPECT_EQ(read.error().code, "fbx-nodes") << read.error().message;
  };
  for (const std::string& form : all_forms(nodes)) {
    for (std::size_t size = 0; size < form.size(); size += 7) try_reading(form.substr(0, size));
    for (int round = 0; round < 2000; ++round) {
      std::string damaged = form;
      damaged[random() % damaged.size()] = static_cast<char>(random());
      try_reading(damaged);
    }
  }
  EXPECT_GT(refused, 100);
}

TEST(FbxNodes, ACountIsNotBelieved) {
  // Four million compressed numbers in twenty bytes, and as many stored ones.
  for (const std::uint32_t encoding : {0U, 1U}) {
    std::string record("Kaydara FBX Binary  \0\x1A\0", 23);
    const auto put = [&](std::uint32_t value) {
      record.append(reinterpret_cast<const char*>(&value), 4);
    };
    put(7400);
    put(27 + 13 + 7 + 33);
    put(1);
    put(33);
    record += std::string("\7Objects") + "d";
    put(4'000'000);
    put(encoding);
    put(20);
    record += std::string(20, 'x');
    const std::array<std::string_view, 1> wanted = {"Objects"};
    EXPECT_THROW(read_fbx_nodes(bytes_of(record), wanted), Failure);
  }
}

// ---- curves

TEST(FbxCurve, APieceBeginsAndEndsAtItsKeysWithItsSlopes) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> any(-3.0, 3.0), weight(0.05, 0.95);
  for (int round = 0; round < 200; ++round) {
    FbxKey from{.time_s = any(random),
                .value = any(random),
                .interpolation = FbxInterpolation::cubic,
                .slope = any(random),
                .next_slope = any(random)};
    if (round % 2 == 1) from.weight = weight(random), from.next_weight = weight(random);
    const FbxKey to{.time_s = from.time_s + 0.7, .value = any(random)};
    EXPECT_NEAR(fbx_value_at(from, to, from.time_s), from.value, 1e-9);
    EXPECT_NEAR(fbx_value_at(from, to, to.time_s), to.value, 1e-9);
    const double h = 1e-5;
    EXPECT_NEAR((fbx_value_at(from, to, from.time_s + h) - from.value) / h, from.slope, 5e-2);
    EXPECT_NEAR((to.value - fbx_value_at(from, to, to.time_s - h)) / h, from.next_slope, 5e-2);
  }
}

FbxCurve read_curve(std::vector<FbxOutKey> keys) {
  const std::string file = FbxBinary{}.write(animated_fbx({{.keys = std::move(keys)}}));
  return read_fbx_curves(bytes_of(file)).at(0);
}

/// On a straight line every kind of tangent is the line; without tension, continuity and bias, TCB
/// is the cardinal spline, which has a parabola's own slopes between even keys.
TEST(FbxCurve, ComputedTangentsFollowLinesAndParabolas) {
  for (const std::int32_t flags : {kFbxAuto, kFbxTcb}) {
    std::vector<FbxOutKey> keys;
    for (int k = 0; k < 5; ++k) {
      keys.push_back({.time_s = 0.5 * k, .value = 0.25F * float(k * k), .flags = flags});
    }
    const FbxCurve curve = read_curve(keys);
    for (int k = 1; k + 2 < 5; ++k) {  // the ends are level
      EXPECT_NEAR(curve.keys[k].slope, 2.0 * curve.keys[k].time_s, 1e-6);
      EXPECT_NEAR(curve.keys[k].next_slope, 2.0 * curve.keys[k + 1].time_s, 1e-6);
      const double middle = curve.keys[k].time_s + 0.2;
      EXPECT_NEAR(fbx_value_at(curve.keys[k], curve.keys[k + 1], middle), middle * middle, 1e-6);
    }
  }
}

/// Full tension stops at the key, full bias keeps what came, continuity breaks both ways.
TEST(FbxCurve, TensionContinuityAndBias) {
  const auto at_middle = [](float tension, float continuity, float bias) {
    return read_curve({{.time_s = 0, .value = 0, .flags = kFbxTcb},
                       {.time_s = 1,
                        .value = 1,
                        .flags = kFbxTcb,
                        .slope = tension,
                        .next_slope = continuity,
                        .bias = bias},
                       {.time_s = 2, .value = 4, .flags = kFbxTcb}});
  };
  EXPECT_NEAR(at_middle(1, 0, 0).keys[1].slope, 0.0, 1e-6);
  EXPECT_NEAR(at_middle(0, 0, 1).keys[1].slope, 1.0, 1e-6);
  EXPECT_NEAR(at_middle(0, 0, -1).keys[1].slope, 3.0, 1e-6);
  EXPECT_NEAR(at_middle(0, -1, 0).keys[0].next_slope, 1.0, 1e-6);
  EXPECT_NEAR(at_middle(0, -1, 0).keys[1].slope, 3.0, 1e-6);
}

TEST(FbxCurve, NothingIsTakenFromKeysThatMakeNoSense) {
  for (auto keys : {std::vector<FbxOutKey>{{.time_s = 1.0}, {.time_s = 0.5}},
                    std::vector<FbxOutKey>{{.time_s = 0.0, .value = NAN}, {.time_s = 0.5}},
                    std::vector<FbxOutKey>{{.time_s = 0.0}, {.time_s = 0.0}}}) {
    const std::string file = FbxBinary{}.write(animated_fbx({{.keys = std::move(keys)}}));
    EXPECT_TRUE(read_fbx_curves(bytes_of(file)).empty());
  }
}

// ---- what is told

/// From 0 to 90 degrees with level ends: 90 (3 x^2 - 2 x^3) against 90 x.
TEST(FbxLosses, TheLargestDeviationOfTangentsIsTold) {
  const auto nodes = animated_fbx(
      {{.joint = "Spine", .axis = 'Z', .keys = {{0.0, 0.0F, kFbxUser}, {1.0, 90.0F, kFbxUser}}},
       {.joint = "Hips",
        .property = "Lcl Translation",
        .axis = 'Y',
        .keys = {{0.0, 50.0F, kFbxUser}, {1.0, 60.0F, kFbxUser}}},
       {.joint = "Head", .keys = {{0.0, 5.0F}, {1.0, 25.0F}}}});
  double bend = 0.0;
  for (int f = 0; f <= 30; ++f) {
    const double x = f / 30.0;
    bend = std::max(bend, std::abs(3 * x * x - 2 * x * x * x - x));
  }
  for (const std::string& form : all_forms(nodes)) {
    const auto imported = read_cm(form);
    ASSERT_TRUE(imported) << imported.error().message;
    ASSERT_EQ(imported->clips.size(), 1U);
    EXPECT_EQ(imported->clips[0].frames(), 31);
    const Warning* told = warning_of(*imported, "fbx-tangents");
    ASSERT_NE(told, nullptr);
    EXPECT_EQ(told->joint, "Spine");
    EXPECT_NE(told->message.find("2 of 3 curves"), std::string::npos) << told->message;
    EXPECT_NEAR(figure_before(told->message, "degrees"), 90.0 * bend, 0.01) << told->message;
    EXPECT_NEAR(figure_before(told->message, "mm"), 100.0 * bend, 0.01) << told->message;
  }
}

TEST(FbxLosses, NothingIsToldWhereNothingIsLost) {
  std::vector<FbxOutKey> baked,
      straight = {{0.0, 0.0F, kFbxUser, 30.0F, 30.0F}, {1.0, 30.0F, kFbxUser}};
  for (int f = 0; f <= 30; ++f) baked.push_back({f / 30.0, float(std::sin(0.3 * f)), kFbxAuto});
  for (const auto& keys : {baked, straight}) {
    const auto imported = read_cm(FbxBinary{}.write(animated_fbx({{.keys = keys}})));
    ASSERT_TRUE(imported) << imported.error().message;
    EXPECT_EQ(imported->clips.at(0).frames(), 31);
    for (const char* code : {"fbx-tangents", "fbx-layers", "fbx-losses-unknown"}) {
      EXPECT_FALSE(has_warning(*imported, code)) << code;
    }
  }
}

TEST(FbxLosses, AHeldKeyIsToldAsWell) {
  const auto nodes = animated_fbx({{.keys = {{0.0, 0.0F, kFbxHold}, {1.0, 30.0F, kFbxHold}}}});
  const auto imported = read_cm(FbxBinary{}.write(nodes));
  ASSERT_TRUE(imported) << imported.error().message;
  const Warning* told = warning_of(*imported, "fbx-tangents");
  ASSERT_NE(told, nullptr);
  EXPECT_NEAR(figure_before(told->message, "degrees"), 29.0, 0.05);  // just before the step
}

TEST(FbxLosses, LayersAreCountedAndMeasured) {
  const std::vector<FbxOutKey> walk = {{0.0, 0.0F}, {1.0, 30.0F}};
  const std::vector<FbxOutKey> more = {{0.0, 0.0F}, {0.5, -12.0F}, {1.0, 4.0F}};
  const auto nodes = animated_fbx(
      {{.joint = "Spine", .keys = walk}, {.joint = "Spine", .layer = "Correction", .keys = more}});
  const auto imported = read_cm(FbxBinary{}.write(nodes));
  ASSERT_TRUE(imported) << imported.error().message;
  const Warning* told = warning_of(*imported, "fbx-layers");
  ASSERT_NE(told, nullptr);
  EXPECT_EQ(told->joint, "Spine");
  EXPECT_NE(told->message.find("2 animation layers"), std::string::npos) << told->message;
  EXPECT_NEAR(figure_before(told->message, "degrees"), 12.0, 1e-6) << told->message;
}

TEST(FbxLosses, RealFilesWithTangentsAreTold) {
  LIMBER_NEEDS_SHARED(data);
  for (const auto& [file, tangents] : {std::pair("mocap_other/ozz_jog_biped.fbx", true),
                                       std::pair("mocap_other/ozz_crossarms_fingers.fbx", true),
                                       std::pair("mocap_other/cmu_07_01_walk.fbx", false),
                                       std::pair("characters/quaternius_male_casual.fbx", false)}) {
    const auto imported = import_file(*data / file);
    ASSERT_TRUE(imported) << imported.error().message;
    EXPECT_EQ(has_warning(*imported, "fbx-tangents"), tangents) << file;
    EXPECT_FALSE(has_warning(*imported, "fbx-losses-unknown")) << file;
  }
}

// ---- Blender's own evaluation

/// Each curve's values on its frames, 30 a second, as Blender has them; null where it cannot be
/// asked.
json ask_blender(const std::vector<FbxOutCurve>& curves) {
  if (std::system("command -v blender >/dev/null 2>&1") != 0) return nullptr;
  json asked = json::array();
  for (const FbxOutCurve& curve : curves) {
    json keys = json::array();
    for (std::size_t k = 0; k < curve.keys.size(); ++k) {
      const FbxOutKey& key = curve.keys[k];
      const FbxOutKey& before = curve.keys[k == 0 ? 0 : k - 1];
      keys.push_back({std::round(30.0 * key.time_s), key.value, key.slope / 30.0,
                      before.next_slope / 30.0, key.weight, before.next_weight});
    }
    asked.push_back(keys);
  }
  const fs::path folder = fs::temp_directory_path();
  const fs::path in = folder / fmt::format("limber-curves-{}.json", ::getpid());
  const fs::path out = folder / fmt::format("limber-values-{}.json", ::getpid());
  std::ofstream(in) << asked;
  const int status = std::system(
      fmt::format("blender -b --python '{}' -- '{}' '{}' >/dev/null 2>&1",
                  LIMBER_SOURCE_DIR "/tests/importers/blender_curves.py", in.string(), out.string())
          .c_str());
  std::ifstream answer(out);
  json told = status == 0 && answer ? json::parse(answer, nullptr, false) : json(nullptr);
  fs::remove(in);
  fs::remove(out);
  return told;
}

/// Random keys with tangents set by hand, half of them weighted, two to sixteen frames apart. The
/// weights of two tangents that meet stay below one, beyond which Blender shortens them.
FbxOutCurve random_curve(std::mt19937& random, bool weighted) {
  std::uniform_real_distribution<float> value(-60.0F, 60.0F), slope(-300.0F, 300.0F);
  const auto weight = [&] { return 1e-4F * float(500 + random() % 4400); };  // as FBX packs them
  FbxOutCurve curve;
  int frame = 0;
  for (int k = 0; k < 6; ++k, frame += 2 + int(random() % 15)) {
    curve.keys.push_back({.time_s = frame / 30.0,
                          .value = value(random),
                          .flags = weighted ? kFbxWeighted : kFbxUser,
                          .slope = slope(random),
                          .next_slope = slope(random)});
    if (weighted) curve.keys.back().weight = weight();
    if (weighted) curve.keys.back().next_weight = weight();
  }
  return curve;
}

TEST(FbxLosses, TheSizeToldIsThatOfBlendersOwnCurves) {
  std::mt19937 random(17);
  std::vector<std::string> files;
  std::vector<FbxOutCurve> curves;
  for (int k = 0; k < 12; ++k) {
    curves.push_back(random_curve(random, k % 2 == 1));
    files.push_back(FbxBinary{}.write(animated_fbx({curves.back()})));
  }
  const json told = ask_blender(curves);
  if (told.is_null()) GTEST_SKIP() << "Blender cannot be asked; apt install blender python3-numpy";
  ASSERT_EQ(told.size(), curves.size());
  for (std::size_t c = 0; c < curves.size(); ++c) {
    SCOPED_TRACE(c);
    const std::vector<FbxKey> keys = read_fbx_curves(bytes_of(files[c])).at(0).keys;
    double largest = 0.0;
    std::size_t k = 0;
    for (std::size_t f = 0; f < told[c].size(); ++f) {
      const double time_s = double(f) / 30.0;
      while (k + 2 < keys.size() && keys[k + 1].time_s <= time_s + 1e-9) ++k;
      const double theirs = told[c][f];
      EXPECT_NEAR(fbx_value_at(keys[k], keys[k + 1], time_s), theirs, 2e-3) << "frame " << f;
      const double share = (time_s - keys[k].time_s) / (keys[k + 1].time_s - keys[k].time_s);
      const double line = keys[k].value + share * (keys[k + 1].value - keys[k].value);
      largest = std::max(largest, std::abs(theirs - line));
    }
    const auto imported = read_cm(files[c]);
    ASSERT_TRUE(imported) << imported.error().message;
    const Warning* warning = warning_of(*imported, "fbx-tangents");
    ASSERT_NE(warning, nullptr);
    EXPECT_NEAR(figure_before(warning->message, "degrees"), largest, 6e-3 * largest);
  }
}

}  // namespace
}  // namespace limber::test
