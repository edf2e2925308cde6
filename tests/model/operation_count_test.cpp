// What concatenating and mending cost, counted. Kenwright 2012, section 11, states 42
// multiplications and 38 additions for the dual quaternion and 48 and 32 for the 4x3 matrix; the
// products as its text writes them (section 7.1 and 3.5) take what stands here.

#include <gtest/gtest.h>

#include "tests/model/counted.h"
#include "tests/model/random_motion.h"
#include "tests/model/rigid_forms.h"

namespace limber::test {

void PrintTo(const Operations& o, std::ostream* out) {
  *out << o.multiplications << " mult " << o.additions << " add " << o.divisions << " div "
       << o.square_roots << " sqrt";
}

namespace {

template <class Form>
Form any(unsigned seed) {
  Random random(seed);
  const DualQuaternion q = random.motion();
  ExactMotion exact;
  exact.real.coeffs() = q.real.coeffs().cast<long double>();
  exact.dual.coeffs() = q.dual.coeffs().cast<long double>();
  return Form::from(exact);
}

template <class Form>
Operations of_product() {
  const Form a = any<Form>(1), b = any<Form>(2);
  return operations_of([&] { return a * b; });
}

template <class Form>
Operations of_mending() {
  const Form a = any<Form>(1);
  return operations_of([&] { return a.mended(); });
}

using Dual = DualQuaternionForm<Counted>;
using Pair = QuaternionVectorForm<Counted>;
using Affine = Matrix3x4Form<Counted>;
using Full = Matrix4x4Form<Counted>;

TEST(OperationCount, ADualQuaternionProductIsThreeQuaternionProductsAndASum) {
  const auto a = any<Dual>(1).q, b = any<Dual>(2).q;
  const Operations one = operations_of([&] { return a.real * b.real; });
  EXPECT_EQ(one, (Operations{16, 12}));
  EXPECT_EQ(of_product<Dual>(), (Operations{3 * 16, 3 * 12 + 4}));
}

TEST(OperationCount, MatricesAreSumsOfRowTimesColumn) {
  // 16 entries of 4 products and 3 sums; or 9 of 3 and 2 for the rotation and 3 of 3 and 3 for the
  // translation.
  EXPECT_EQ(of_product<Full>(), (Operations{16 * 4, 16 * 3}));
  EXPECT_EQ(of_product<Affine>(), (Operations{9 * 3 + 3 * 3, 9 * 2 + 3 * 3}));
}

TEST(OperationCount, QuaternionAndVectorIsTheCheapestProduct) {
  // Turning a vector, v + 2 w (u x v) + u x 2 (u x v): two cross products (6 and 3), a doubling by
  // addition (3), a scaling (3) and two sums (6).
  const Operations turn{2 * 6 + 3, 2 * 3 + 3 + 6};
  EXPECT_EQ(of_product<Pair>(), (Operations{16 + turn.multiplications, 12 + turn.additions + 3}));
}

TEST(OperationCount, MendingADualQuaternionCostsNearlyWhatGramSchmidtCosts) {
  // |r|^2 (4 and 3), a root, a division, scaling (8), r.d (4 and 3), d - (r.d) r (4 and 4).
  EXPECT_EQ(of_mending<Dual>(), (Operations{4 + 8 + 4 + 4, 3 + 3 + 4, 1, 1}));
  EXPECT_EQ(of_mending<Pair>(), (Operations{4 + 4, 3, 1, 1}));
  // Two lengths (3 and 2) and scalings (3), one projection (6 and 5), one cross product (6 and 3).
  const Operations gram_schmidt{2 * 6 + 6 + 6, 2 * 2 + 5 + 3, 2, 2};
  EXPECT_EQ(of_mending<Affine>(), gram_schmidt);
  EXPECT_EQ(of_mending<Full>(), gram_schmidt);
}

}  // namespace
}  // namespace limber::test
