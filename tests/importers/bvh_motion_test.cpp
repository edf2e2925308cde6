// Numbers and turns at the speed of memory: the quick ways against plain ones.

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <random>

#include "importers/plain_number.h"
#include "tests/importers/support.h"

namespace limber::test {
namespace {

struct Read {
  double value = 0.0;
  std::ptrdiff_t characters = -1;  ///< -1: not plain
};
Read read(const std::string& text) {
  const std::string padded = text + " 12345678 12345678 ";
  Read read;
  const char* const behind =
      read_plain_number(padded.data(), padded.data() + padded.size(), read.value);
  if (behind != nullptr) read.characters = behind - padded.data();
  return read;
}

std::string random_digits(std::mt19937& random, int count) {
  std::string out;
  for (int k = 0; k < count; ++k) out += static_cast<char>('0' + random() % 10);
  return out;
}

TEST(PlainNumber, IsTheNearestDoubleForEveryNumberOfDigits) {
  std::mt19937 random(7);
  for (int round = 0; round < 2000; ++round) {
    for (int whole = 0; whole <= 7; ++whole) {
      for (int decimals = whole == 0 ? 1 : 0; decimals <= 7; ++decimals) {
        std::string text = (random() % 2 == 0 ? "-" : "") + random_digits(random, whole);
        if (decimals > 0 || random() % 2 == 0) text += "." + random_digits(random, decimals);
        const Read plain = read(text);
        ASSERT_EQ(plain.characters, std::ptrdiff_t(text.size())) << text;
        const double truth = std::strtod(text.c_str(), nullptr);
        ASSERT_EQ(std::bit_cast<std::uint64_t>(plain.value), std::bit_cast<std::uint64_t>(truth))
            << text;
      }
    }
  }
}

TEST(PlainNumber, StopsBehindItsLastDigit) {
  EXPECT_EQ(read("12.5e3").characters, 4);
  EXPECT_EQ(read("1.2.3").characters, 3);
  EXPECT_EQ(read("7}").characters, 1);
  EXPECT_EQ(read("7\xC3\xA4").characters, 1);
}

TEST(PlainNumber, LeavesWhatItCannotDo) {
  for (const char* text : {"", "-", ".", "-.", "+1", "nan", "inf", "--1", "12345678", "0.12345678",
                           "\xB0\xB1", "e5", "1234567890123456789"}) {
    EXPECT_EQ(read(text).characters, -1) << text;
  }
  double value = 0.0;
  const std::string at_the_end = "1.5";
  EXPECT_EQ(read_plain_number(at_the_end.data(), at_the_end.data() + 3, value), nullptr);
}

// ---- turns

constexpr std::array kOrders = {"XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"};

/// One chain, a joint per order.
std::string chain() {
  std::string out = "HIERARCHY\n";
  for (std::size_t j = 0; j < kOrders.size(); ++j) {
    out += fmt::format("{} j{}\n{{\nOFFSET {} 2 3\nCHANNELS 3", j == 0 ? "ROOT" : "JOINT", j, j);
    for (const char axis : std::string_view(kOrders[j])) out += fmt::format(" {}rotation", axis);
    out += "\n";
  }
  return out + std::string(kOrders.size(), '}') + "\nMOTION\n";
}

Eigen::Quaterniond turn(char axis, double degrees) {
  return Eigen::Quaterniond(Eigen::AngleAxisd(std::remainder(degrees, 720.0) * M_PI / 180.0,
                                              Eigen::Vector3d::Unit(axis - 'X')));
}

/// Small, large, beyond whole turns, at the quarters, and absurd.
double random_angle(std::mt19937& random) {
  const double unit = std::uniform_real_distribution(-1.0, 1.0)(random);
  switch (random() % 6) {
    case 0:
      return 1e-5 * unit;
    case 1:
      return 600.0 * unit;
    case 2:
      return 90.0 * std::round(8.0 * unit);
    case 3:
      return 1e7 * unit;
    case 4:
      return 1e15 * unit;
    default:
      return 179.0 * unit;
  }
}

/// Any number of frames, whole blocks or not, gives R(first) R(second) R(third) in each.
TEST(BvhMotion, EveryFrameIsTheProductOfItsTurns) {
  std::mt19937 random(11);
  for (const int frames : {1, 15, 16, 17, 100}) {
    std::vector<double> angles;
    std::string text = chain() + fmt::format("Frames: {}\nFrame Time: 0.01\n", frames);
    for (int f = 0; f < frames; ++f) {
      for (std::size_t c = 0; c < 3 * kOrders.size(); ++c) {
        angles.push_back(random_angle(random));
        text += fmt::format("{:.17g} ", angles.back());
      }
      text += "\n";
    }
    ImportOptions options{.unit_m = 1.0, .up = 'y', .keep_reference_frame = true};
    const auto imported = import_text(text, "bvh", options);
    ASSERT_TRUE(imported) << imported.error().message;
    const Clip& clip = imported->clips.at(0);
    ASSERT_EQ(clip.frames(), frames);
    std::size_t at = 0;
    for (int f = 0; f < frames; ++f) {
      for (std::size_t j = 0; j < kOrders.size(); ++j, at += 3) {
        const DualQuaternion& pose = clip.frame(f)[j];
        const Eigen::Quaterniond truth = turn(kOrders[j][0], angles[at]) *
                                         turn(kOrders[j][1], angles[at + 1]) *
                                         turn(kOrders[j][2], angles[at + 2]);
        EXPECT_LT((truth.conjugate() * pose.rotation()).vec().norm(), 1e-14) << f << " " << j;
        EXPECT_NEAR(pose.rotation().norm(), 1.0, 1e-15 * 8);
        EXPECT_LT((pose.translation() - Eigen::Vector3d(double(j), 2, 3)).norm(), 1e-14 * 8);
        EXPECT_GE(pose.real.dot(clip.frame(std::max(f - 1, 0))[j].real), 0.0);
      }
    }
  }
}

}  // namespace
}  // namespace limber::test
