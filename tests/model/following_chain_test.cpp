// Kenwright 2012, section 10.1, measured: what a form's drift does to a chain that follows a
// target.

#include "tests/model/following_chain.h"

#include <gtest/gtest.h>

namespace limber::test {
namespace {

constexpr int kFrames = 6000;  // 100 s

/// The drift of one link's product is a walk of one product per frame (long_chain_test.cpp); the
/// end is the product of six links.
template <class Form>
double walk() {
  return 50.0 * unit_roundoff<typename Form::Scalar>() *
         std::sqrt(double(kFrames) * FollowingChain<Form>::kLinks);
}

template <class Form>
class Follows : public testing::Test {};
using Forms = testing::Types<DualQuaternionForm<float>, DualQuaternionForm<double>,
                             Matrix4x4Form<float>, Matrix4x4Form<double>>;
TYPED_TEST_SUITE(Follows, Forms);

TYPED_TEST(Follows, DriftStaysBelowTheWalkAndRepairTakesItAway) {
  const double u = unit_roundoff<typename TypeParam::Scalar>();
  const Following never = follow<TypeParam>(Repair::never, kFrames);
  EXPECT_LT(never.not_rigid, walk<TypeParam>());
  for (const Repair repair : {Repair::links, Repair::levels}) {
    const Following mended = follow<TypeParam>(repair, kFrames);
    EXPECT_LT(mended.not_rigid, 50.0 * u * FollowingChain<TypeParam>::kLinks) << to_string(repair);
    // The paper's figure 4 shows broken joints and an end away from its ideal: neither follows from
    // putting rotations right. The motion is the unrepaired one's to within the drift.
    EXPECT_NEAR(mended.miss_m, never.miss_m, 2.0 * walk<TypeParam>()) << to_string(repair);
    EXPECT_NEAR(mended.joint_step_rad, never.joint_step_rad, 10.0 * walk<TypeParam>())
        << to_string(repair);
  }
}

TYPED_TEST(Follows, LinksKeepTheirLengths) {
  // A matrix's translation is not touched by a turn on its right; a dual quaternion's is read as
  // 2 dual real*, so its length follows the drift unless normalised.
  const double u = unit_roundoff<typename TypeParam::Scalar>();
  EXPECT_LT(follow<TypeParam>(Repair::never, kFrames).link_stretch_m, walk<TypeParam>());
  EXPECT_LT(follow<TypeParam>(Repair::links, kFrames).link_stretch_m,
            50.0 * u * std::sqrt(double(kFrames)));
}

}  // namespace
}  // namespace limber::test
