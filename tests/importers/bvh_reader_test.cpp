// The BVH reader: one motion in many dialects gives one answer; damage gives a coded error.

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <map>
#include <sstream>

#include "importers/bvh_parser.h"
#include "importers/frame_rate.h"
#include "tests/importers/bvh_dialects.h"
#include "tests/importers/support.h"

namespace limber::test {
namespace {

/// Largest distance, m, of any joint in any frame from the figure's true motion.
double largest_miss(const Imported& imported, int frames, const std::string& prefix = "") {
  const Skeleton& skeleton = imported.character.skeleton;
  EXPECT_EQ(imported.clips.at(0).frames(), frames);
  double miss = 0.0;
  for (int f = 0; f < frames; ++f) {
    const auto points = joint_positions(skeleton, imported.clips[0].frame(f));
    const auto truth = figure_positions(f);
    for (std::size_t j = 0; j < figure().size(); ++j) {
      const std::int32_t joint = skeleton.find(prefix + figure()[j].name);
      EXPECT_NE(joint, kNoJoint) << figure()[j].name;
      if (joint != kNoJoint) miss = std::max(miss, (points[joint] - truth[j]).norm());
    }
  }
  return miss;
}

class BvhDialect : public testing::TestWithParam<NamedDialect> {};

TEST_P(BvhDialect, GivesTheSameMotion) {
  const Dialect& dialect = GetParam().dialect;
  const auto imported = import_text(BvhWriter(dialect).write(), "bvh");
  ASSERT_TRUE(imported) << imported.error().message;
  EXPECT_LT(largest_miss(*imported, dialect.frames, dialect.name_prefix_utf8), 1e-4);
  EXPECT_DOUBLE_EQ(imported->clips[0].rate_hz, 30.0);
  EXPECT_NEAR(imported->facts.unit_m, dialect.unit_m, 1e-12) << imported->facts.unit_evidence;
  EXPECT_EQ(imported->facts.up, dialect.z_up ? "+Z" : "+Y");
  EXPECT_EQ(imported->facts.joints, std::int64_t(figure().size()));
  EXPECT_EQ(has_warning(*imported, "bvh-zero-positions"), dialect.zero_filled);
  EXPECT_EQ(has_warning(*imported, "up-axis-mixed"), dialect.y_up_offsets);
}

TEST_P(BvhDialect, RestPoseStandsWithItsOffsets) {
  const Dialect& dialect = GetParam().dialect;
  const auto imported = import_text(BvhWriter(dialect).write(), "bvh");
  ASSERT_TRUE(imported);
  const Skeleton& skeleton = imported->character.skeleton;
  const auto points = joint_positions(skeleton, skeleton.rest_parent_from_joint);
  Eigen::Vector3d head = Eigen::Vector3d::Zero();
  for (int j = 4; j >= 0; j = figure()[j].parent) head += figure()[j].offset;
  EXPECT_LT((points[skeleton.find(dialect.name_prefix_utf8 + "Head")] - head).norm(), 1e-4);
}

INSTANTIATE_TEST_SUITE_P(All, BvhDialect, testing::ValuesIn(dialects()),
                         [](const auto& info) { return info.param.name; });

TEST(BvhReader, OptionsOverrideUnitAndUp) {
  Dialect dialect;
  dialect.z_up = true;
  ImportOptions options;
  options.unit_m = 0.02;  // twice the truth
  options.up = 'z';
  const auto imported = import_text(BvhWriter(dialect).write(), "bvh", options);
  ASSERT_TRUE(imported);
  const auto points = joint_positions(imported->character.skeleton, imported->clips[0].frame(3));
  EXPECT_LT((points[0] - 2.0 * figure_root(3)).norm(), 1e-4);
}

TEST(BvhReader, ReferenceFrameIsDroppedAndTimeStampsStay) {
  Dialect dialect;
  dialect.reference_frame = true;
  const std::string text = BvhWriter(dialect).write();
  const auto imported = import_text(text, "bvh");
  ASSERT_TRUE(imported);
  ASSERT_TRUE(imported->facts.reference_frame_dropped);
  EXPECT_TRUE(has_warning(*imported, "clip-reference-frame"));
  EXPECT_EQ(imported->facts.frames, 21);
  EXPECT_LT(largest_miss(*imported, 20), 1e-4);
  EXPECT_DOUBLE_EQ(imported->clips[0].start_s, 1.0 / 30.0);
  const auto points = joint_positions(imported->character.skeleton, imported->reference_pose);
  EXPECT_NEAR(points[imported->character.skeleton.find("LeftHand")].x(), 0.18 + 0.28 + 0.25, 1e-4);

  ImportOptions keep;
  keep.keep_reference_frame = true;
  const auto kept = import_text(text, "bvh", keep);
  ASSERT_TRUE(kept);
  EXPECT_EQ(kept->clips[0].frames(), 21);
  EXPECT_EQ(kept->clips[0].start_s, 0.0);
  EXPECT_TRUE(kept->reference_pose.empty());
}

TEST(BvhReader, EndSitesAreJointsThatDeformNothing) {
  const auto imported = import_text(BvhWriter({}).write(), "bvh");
  ASSERT_TRUE(imported);
  const Skeleton& skeleton = imported->character.skeleton;
  const std::int32_t crown = skeleton.find("Head_End");
  ASSERT_NE(crown, kNoJoint);
  EXPECT_EQ(skeleton.names[skeleton.parents[crown]], "Head");
  EXPECT_EQ(imported->character.deforming[crown], 0);
  EXPECT_EQ(imported->character.deforming[skeleton.find("Head")], 1);
  EXPECT_NEAR(skeleton.rest_parent_from_joint[crown].translation().norm(), 0.05, 1e-9);
  EXPECT_EQ(skeleton.size(), std::int32_t(figure().size()) + 5);
}

// ---- small files, written by hand

std::string body(const std::string& joints, const std::string& motion) {
  return "HIERARCHY\n" + joints + "MOTION\n" + motion;
}
const char* const kOneJoint =
    "ROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation "
    "Yrotation\n}\n";

TEST(BvhReader, WhatIsPassedIsNotReadAgain) {
  constexpr int kFrames = 2'000'000;
  std::string text = body(kOneJoint, fmt::format("Frames: {}\nFrame Time: 0.05\n", kFrames));
  const auto lines = std::count(text.begin(), text.end(), '\n') + kFrames;
  for (int f = 0; f < kFrames; ++f) text += "1 2 3 0 0 0\n";
  ImportOptions options;
  std::size_t passed = 0;
  options.on_passed = [&](std::size_t bytes) {
    std::fill(text.begin() + std::ptrdiff_t(passed), text.begin() + std::ptrdiff_t(bytes), 'x');
    passed = bytes;
  };
  text += "1 2 3 0 0 zero\n";
  const auto imported = import_text(text, "bvh", options);
  ASSERT_FALSE(imported);
  EXPECT_GT(passed, 0.5 * double(text.size()));
  EXPECT_TRUE(imported.error().message.starts_with(fmt::format("line {}:", lines + 1)))
      << imported.error().message;
}

TEST(BvhReader, SeveralRootsAndEndSites) {
  const std::string end = "End Site\n{\nOFFSET 0 1 0\n}\n";
  const std::string root = "\n{\nOFFSET 0 0 0\nCHANNELS 1 Yrotation\n" + end + end + end + "}\n";
  ImportOptions options;
  options.unit_m = 1.0;
  const auto imported =
      import_text(body("ROOT A" + root + "ROOT B" + root, "Frames: 1\nFrame Time: 0.05\n90 -90\n"),
                  "bvh", options);
  ASSERT_TRUE(imported) << imported.error().message;
  const Skeleton& s = imported->character.skeleton;
  EXPECT_EQ(s.names, (std::vector<std::string>{"A", "A_End", "A_End_2", "A_End_3", "B", "B_End",
                                               "B_End_2", "B_End_3"}));
  EXPECT_EQ(s.parents[4], kNoJoint);
  EXPECT_EQ(imported->facts.joints, 2);
  EXPECT_DOUBLE_EQ(imported->clips[0].rate_hz, 20.0);
}

TEST(BvhReader, NamesKeepSpacesAndColonsAndBecomeUnique) {
  const std::string leaf = "\n{\nOFFSET 0 1 0\nCHANNELS 0\n}\n";
  const std::string joints =
      "ROOT  mixamorig:Left Hand \n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n"
      "JOINT a" +
      leaf + "JOINT a" + leaf + "JOINT" + leaf + "}\n";
  const auto imported = import_text(body(joints, "Frames: 1\nFrame Time: 1\n0\n"), "bvh");
  ASSERT_TRUE(imported) << imported.error().message;
  EXPECT_EQ(imported->character.skeleton.names,
            (std::vector<std::string>{"mixamorig:Left Hand", "a", "a_2", "joint_3"}));
  EXPECT_TRUE(has_warning(*imported, "joint-renamed"));
  EXPECT_TRUE(has_warning(*imported, "joint-unnamed"));
}

TEST(BvhReader, ShiftJisAndLatin1NamesBecomeUtf8) {
  const auto name_of = [](const std::string& raw) {
    const auto imported =
        import_text(body("ROOT " + raw + "\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n}\n",
                         "Frames: 1\nFrame Time: 1\n0\n"),
                    "bvh");
    EXPECT_TRUE(imported);
    return imported ? imported->character.skeleton.names[0] : std::string();
  };
  EXPECT_EQ(name_of("\x8D\xB6\x98\x72"), "\xE5\xB7\xA6\xE8\x85\x95");  // left arm, in Japanese
  EXPECT_EQ(name_of("H\xFC"
                    "fte"),
            "H\xC3\xBC"
            "fte");
  EXPECT_EQ(name_of("H\xC3\xBC"
                    "fte"),
            "H\xC3\xBC"
            "fte");
}

TEST(BvhReader, ReadsTheFramesThatAreThere) {
  const std::string row = "0 1 0 0 0 0\n";
  const auto frames = [&](const std::string& motion) {
    const auto imported = import_text(body(kOneJoint, motion), "bvh");
    EXPECT_TRUE(imported) << imported.error().message;
    return imported ? imported->clips.at(0).frames() : -1;
  };
  EXPECT_EQ(frames("Frames: 2000000000\nFrame Time: 1\n" + row + row), 2);
  EXPECT_EQ(frames("Frames: 1\nFrame Time: 1\n" + row + row + row), 3);
  EXPECT_EQ(frames("Frames: 3\nFrame Time: 1\n" + row + row + "0 1 0"), 2);
  // the last number may be cut off as well
  EXPECT_EQ(frames("Frames: 3\nFrame Time: 1\n" + row + "0 1 0 0 0 18"), 1);
  EXPECT_EQ(frames("Frames: 2\nFrame Time: 1\n" + row + "0 1 0 0 0 18"), 2);
  EXPECT_EQ(frames("Frames: 1\nFrame Time: 1\n0 1 0\n0 0 0\n"), 1);  // a wrapped row
}

TEST(BvhReader, PartialPositionChannelsReplaceOnlyTheirAxis) {
  ImportOptions options;
  options.unit_m = 1.0;
  options.up = 'y';
  const auto imported =
      import_text(body("ROOT a\n{\nOFFSET 1 2 3\nCHANNELS 2 Yposition Zrotation\n}\n",
                       "Frames: 1\nFrame Time: 1\n7 90\n"),
                  "bvh", options);
  ASSERT_TRUE(imported);
  const DualQuaternion& local = imported->clips[0].frame(0)[0];
  EXPECT_LT((local.translation() - Eigen::Vector3d(1, 7, 3)).norm(), 1e-12);
  EXPECT_LT((local.transform_direction({1, 0, 0}) - Eigen::Vector3d(0, 1, 0)).norm(), 1e-12);
}

TEST(BvhReader, DamageHasACode) {
  const std::string good = "Frames: 1\nFrame Time: 1\n0 0 0 0 0 0\n";
  const std::map<std::string, std::pair<std::string, std::string>> cases = {
      {"nan", {body(kOneJoint, "Frames: 1\nFrame Time: 1\n0 0 0 0 nan 0\n"), "bvh-nan"}},
      {"ind", {body(kOneJoint, "Frames: 1\nFrame Time: 1\n0 0 0 0 -1.#IND 0\n"), "bvh-nan"}},
      {"inf", {body(kOneJoint, "Frames: 1\nFrame Time: 1\n0 1e999 0 0 0 0\n"), "bvh-nan"}},
      {"comma", {body(kOneJoint, "Frames: 1\nFrame Time: 1\n0 0,5 0 0 0 0\n"), "bvh-number"}},
      {"long", {body(kOneJoint, "Frames: 1\nFrame Time: 1\n0 0 0 0 0 0 0\n"), "bvh-row-length"}},
      {"short", {body(kOneJoint, "Frames: 1\nFrame Time: 1\n0 0 0\n"), "bvh-row-length"}},
      {"zero", {body(kOneJoint, "Frames: 1\nFrame Time: 0\n0 0 0 0 0 0\n"), "bvh-frame-time"}},
      {"no_motion", {std::string("HIERARCHY\n") + kOneJoint, "bvh-no-motion"}},
      {"brace", {body(std::string(kOneJoint) + "}\n", good), "bvh-syntax"}},
      {"open", {body("ROOT a\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n", good), "bvh-syntax"}},
      {"twice",
       {body("ROOT a\n{\nOFFSET 0 0 0\nCHANNELS 2 Xposition Xposition\n}\n", good),
        "bvh-channels"}},
      {"none", {body("ROOT a\n{\nOFFSET 0 0 0\n}\n", good), "bvh-channels"}},
      {"late",
       {body("ROOT a\n{\nJOINT b\n{\nCHANNELS 1 Xrotation\n}\nCHANNELS 1 Xrotation\n}\n", good),
        "bvh-channels"}}};
  for (const auto& [name, text_and_code] : cases) {
    const auto imported = import_text(text_and_code.first, "bvh");
    ASSERT_FALSE(imported) << name;
    EXPECT_EQ(imported.error().code, text_and_code.second) << name;
    EXPECT_FALSE(imported.error().hint.empty()) << name;
  }
}

TEST(BvhReader, LengthsBeyondMeasureAreRefused) {
  std::string text = BvhWriter({}).write();
  const std::size_t spine = text.find("OFFSET", text.find("Spine"));
  text.replace(spine, text.find('\n', spine) - spine, "OFFSET 0 1e290 0");
  const auto imported = import_text(text, "bvh");
  ASSERT_FALSE(imported);
  EXPECT_EQ(imported.error().code, "size-absurd");
  EXPECT_EQ(imported.error().joint, "Spine");
}

TEST(BvhReader, NanNamesItsJointAndFrame) {
  const auto imported = import_text(
      body("ROOT a\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\nJOINT b\n{\nOFFSET 0 1 0\nCHANNELS 1 "
           "Yrotation\n}\n}\n",
           "Frames: 3\nFrame Time: 1\n0 0\n0 0\n0 nan\n"),
      "bvh");
  ASSERT_FALSE(imported);
  EXPECT_EQ(imported.error().joint, "b");
  EXPECT_EQ(imported.error().frame, 2);
}

TEST(BvhReader, DeepNestingIsRefused) {
  std::string text = "HIERARCHY\n";
  for (int i = 0; i < 60000; ++i)
    text += (i == 0 ? "ROOT j" : "JOINT j") + std::to_string(i) + "\n{\n";
  const auto imported = import_text(text, "bvh");
  ASSERT_FALSE(imported);
  EXPECT_EQ(imported.error().code, "bvh-depth");
}

TEST(BvhReader, AnyDamagedByteIsSurvived) {
  Dialect dialect;
  dialect.frames = 3;
  const std::string good = BvhWriter(dialect).write();
  std::uint64_t state = 12345;
  const auto random = [&] {
    return state = state * 6364136223846793005ULL + 1442695040888963407ULL;
  };
  int read = 0;
  for (int round = 0; round < 3000; ++round) {
    std::string text = good;
    for (int k = 0; k < 1 + round % 4; ++k) {
      text[(random() >> 20) % text.size()] = static_cast<char>(random() >> 40);
    }
    if (round % 5 == 0) text.resize((random() >> 20) % text.size());
    const auto imported = import_text(text, "bvh");
    if (imported) {
      ++read;
    } else {
      EXPECT_FALSE(imported.error().code.empty());
      EXPECT_NE(imported.error().code, "import-internal") << imported.error().message;
    }
  }
  EXPECT_GT(read, 0);
}

// ---- rates

TEST(FrameRate, RoundedTimesMeanUsualRates) {
  const auto rate = [](const char* text) { return snap_rate_hz(std::atof(text), text); };
  EXPECT_EQ(rate(".0083333"), 120.0);
  EXPECT_EQ(rate("0.008333"), 120.0);
  EXPECT_EQ(rate("0.0083"), 120.0);
  EXPECT_EQ(rate(".03333"), 30.0);
  EXPECT_EQ(rate("0.033333"), 30.0);
  EXPECT_EQ(rate("0.033"), 30.0);
  EXPECT_EQ(rate("0.0416667"), 24.0);
  EXPECT_EQ(rate("0.041667"), 24.0);
  EXPECT_EQ(rate("0.0417"), 24.0);
  EXPECT_EQ(rate("0.016667"), 60.0);
  EXPECT_EQ(rate("0.0166667"), 60.0);
  EXPECT_EQ(rate("0.04"), 25.0);
  EXPECT_EQ(rate("0.05"), 20.0);
  EXPECT_EQ(rate("0.010000"), 100.0);
  EXPECT_EQ(rate("0.008"), 125.0);
  EXPECT_EQ(rate("3.33333e-2"), 30.0);
  EXPECT_EQ(rate("0.0142857"), 70.0);
  EXPECT_DOUBLE_EQ(rate("0.041708"), 24000.0 / 1001.0);
  EXPECT_DOUBLE_EQ(rate("0.0333667"), 30000.0 / 1001.0);
  EXPECT_DOUBLE_EQ(rate("0.033367"), 30000.0 / 1001.0);
  EXPECT_DOUBLE_EQ(rate("0.0166833"), 60000.0 / 1001.0);
  EXPECT_DOUBLE_EQ(rate("0.0127354"), 1.0 / 0.0127354);  // an odd rate stays as it is
}

// ---- real clips against an independent computation

/// World joint positions in file units by 4 x 4 matrices; single-word tokens, no End Sites.
class NaiveBvh {
 public:
  explicit NaiveBvh(std::istream& in) {
    std::string word;
    std::vector<int> stack;
    bool end = false;
    while (in >> word && word != "MOTION") {
      if (word == "ROOT" || word == "JOINT") {
        in >> word;
        names.push_back(word);
        parents.push_back(stack.empty() ? -1 : stack.back());
        offsets.emplace_back(0, 0, 0);
        channels.emplace_back();
      } else if (word == "End") {
        in >> word;
        end = true;
      } else if (word == "{") {
        stack.push_back(end ? -2 : int(names.size()) - 1);
      } else if (word == "}") {
        if (stack.back() == -2) end = false;
        stack.pop_back();
      } else if (word == "OFFSET") {
        double x, y, z;
        in >> x >> y >> z;
        if (!end) offsets.back() = {x, y, z};
      } else if (word == "CHANNELS") {
        int n = 0;
        in >> n;
        for (int k = 0; k < n; ++k) {
          in >> word;
          channels.back().push_back(word);
        }
      }
    }
    int frames = 0;
    in >> word >> frames >> word >> word >> word;
    for (double v; in >> v;) values.push_back(v);
  }

  std::vector<Eigen::Vector3d> positions(int frame) const {
    std::size_t columns = 0;
    for (const auto& c : channels) columns += c.size();
    const double* v = values.data() + std::size_t(frame) * columns;
    std::vector<Eigen::Affine3d> world;
    std::vector<Eigen::Vector3d> points;
    for (std::size_t j = 0; j < names.size(); ++j) {
      Eigen::Vector3d p = offsets[j];
      Eigen::Matrix3d r = Eigen::Matrix3d::Identity();
      for (const std::string& channel : channels[j]) {
        const int axis = channel[0] - 'X';
        if (channel.substr(1) == "position") {
          p[axis] = *v++;
        } else {
          r = r * Eigen::AngleAxisd(*v++ * M_PI / 180.0, Eigen::Vector3d::Unit(axis));
        }
      }
      Eigen::Affine3d local = Eigen::Affine3d::Identity();
      local.linear() = r;
      local.translation() = p;
      world.push_back(parents[j] < 0 ? local : Eigen::Affine3d(world[parents[j]] * local));
      points.push_back(world.back().translation());
    }
    return points;
  }

  std::vector<std::string> names;
  std::vector<int> parents;
  std::vector<Eigen::Vector3d> offsets;
  std::vector<std::vector<std::string>> channels;
  std::vector<double> values;
};

TEST(BvhReader, RealClipsEqualAnIndependentComputation) {
  LIMBER_NEEDS_SHARED(data);
  for (const char* file :
       {"cmu_mb_12_01_walk", "cmu_max_131_01_start_walk_stop", "cmu_jumping_jacks_30fps",
        "cmu_iclone_05_03_dance", "fair_zombie_zup", "mixed_orders_60j", "rokoko_jesse_dance_60j",
        "fixture_rotation_before_position", "performs_sit_idle_52j", "xsens_style_crlf"}) {
    SCOPED_TRACE(file);
    const auto path = *data / "bvh" / (std::string(file) + ".bvh");
    const auto imported = import_file(path);
    ASSERT_TRUE(imported) << imported.error().message;
    std::ifstream in(path);
    const NaiveBvh naive(in);
    const Skeleton& skeleton = imported->character.skeleton;
    const Clip& clip = imported->clips[0];
    const int first = imported->facts.reference_frame_dropped ? 1 : 0;
    double miss = 0.0;
    for (std::int64_t f = 0; f < clip.frames(); f += 37) {
      const auto truth = naive.positions(int(f) + first);
      const auto points = joint_positions(skeleton, clip.frame(f));
      for (std::size_t j = 0; j < truth.size(); ++j) {
        const Eigen::Vector3d& p = truth[j];
        const Eigen::Vector3d canonical =
            imported->facts.unit_m *
            (imported->facts.up == "+Z" ? Eigen::Vector3d(p.x(), p.z(), -p.y()) : p);
        miss = std::max(miss, (points[skeleton.find(naive.names[j])] - canonical).norm());
      }
    }
    EXPECT_LT(miss, 1e-9);
  }
}

}  // namespace
}  // namespace limber::test
