#include "assets/model/clip.h"

#include <gtest/gtest.h>

#include "tests/model/random_motion.h"

namespace limber {
namespace {

Skeleton one_joint() {
  Skeleton skeleton;
  skeleton.names = {"root"};
  skeleton.parents = {kNoJoint};
  skeleton.rest_parent_from_joint.resize(1);
  return skeleton;
}

/// A steady screw: 1 rad/s about y and 0.5 m/s along it.
Clip screw(double rate_hz, int frames) {
  Clip clip;
  clip.rate_hz = rate_hz;
  clip.joints = 1;
  for (int f = 0; f < frames; ++f) {
    const double t = f / rate_hz;
    clip.parent_from_joint.push_back(
        DualQuaternion::exp({t * Eigen::Vector3d::UnitY(), 0.5 * t * Eigen::Vector3d::UnitY()}));
  }
  return clip;
}

TEST(Clip, ResamplingASteadyScrewIsExact) {
  const Clip clip = screw(30.0, 31);
  for (const double rate : {10.0, 30.0, 60.0, 120.0, 37.0}) {
    const Clip out = resample(clip, rate);
    EXPECT_EQ(out.frames(), static_cast<std::int64_t>(rate * 1.0 + 1e-9) + 1) << rate;
    EXPECT_EQ(out.rate_hz, rate);
    const Clip expected = screw(rate, static_cast<int>(out.frames()));
    for (std::int64_t f = 0; f < out.frames(); ++f) {
      EXPECT_LT((out.frame(f)[0].matrix() - expected.frame(f)[0].matrix()).norm(), 1e-12);
    }
  }
}

TEST(Clip, SignsBecomeContinuousAndTheMotionStays) {
  test::Random random(31);
  Clip clip = screw(10.0, 100);  // turns by 10 rad: the sign must follow through
  Clip flipped = clip;
  for (auto& q : flipped.parent_from_joint) {
    if (random.integer(0, 1) == 1) q = -q;
  }
  make_signs_continuous(flipped);
  for (std::int64_t f = 1; f < clip.frames(); ++f) {
    EXPECT_GT(flipped.frame(f)[0].real.coeffs().dot(flipped.frame(f - 1)[0].real.coeffs()), 0.0);
    EXPECT_LT((flipped.frame(f)[0].matrix() - clip.frame(f)[0].matrix()).norm(), 1e-15);
  }
}

TEST(Clip, EveryInvariantIsChecked) {
  const Skeleton skeleton = one_joint();
  const Clip good = screw(30.0, 5);
  EXPECT_TRUE(validate(skeleton, good).ok());
  EXPECT_DOUBLE_EQ(good.duration_s(), 4.0 / 30.0);
  const auto refused = [&](const Clip& clip) {
    const auto result = validate(skeleton, clip);
    return !result.ok() && result.error().code == "clip-invalid";
  };
  Clip bad = good;
  bad.rate_hz = 0.0;
  EXPECT_TRUE(refused(bad));
  bad.rate_hz = std::numeric_limits<double>::infinity();
  EXPECT_TRUE(refused(bad));
  bad = good;
  bad.parent_from_joint.clear();
  EXPECT_TRUE(refused(bad));
  bad = good;
  bad.joints = 2;
  EXPECT_TRUE(refused(bad));
  bad = good;
  bad.frame(3)[0].dual.x() = std::nan("");
  ASSERT_TRUE(refused(bad));
  EXPECT_EQ(validate(skeleton, bad).error().frame, 3);
  EXPECT_EQ(validate(skeleton, bad).error().joint, "root");
  bad = good;
  bad.frame(1)[0] = 1.001 * bad.frame(1)[0];
  EXPECT_TRUE(refused(bad));
}

}  // namespace
}  // namespace limber
