// FBX curves: our second reading beside assimp's, which alone may see hostile bytes in one process
// with us. Reads or refuses; what is read can be evaluated.

#include <algorithm>
#include <cmath>

#include "importers/failure.h"
#include "importers/fbx_curves.h"
#include "tests/fuzz/fuzz_target.h"
#include "tests/importers/fbx_writer.h"

namespace limber::fuzz {

std::vector<std::string> seeds() {
  using namespace limber::test;
  const auto nodes = animated_fbx(
      {{.keys = {{0.0, 1.0F, kFbxUser, 2.0F, 3.0F}, {0.5, 2.0F, kFbxWeighted}, {1.0, 0.0F}}},
       {.joint = "Head",
        .property = "Lcl Translation",
        .layer = "More",
        .keys = {{0.0, 1.0F, kFbxAuto}, {0.5, 2.0F, kFbxTcb}, {1.0, 0.0F, kFbxHold}}}});
  return {ascii_fbx(nodes), FbxBinary{}.write(nodes), FbxBinary{.deflate = true}.write(nodes),
          FbxBinary{.version = 7500}.write(nodes)};
}

}  // namespace limber::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace limber;
  const auto curves = guarded<std::vector<FbxCurve>>([&]() -> Result<std::vector<FbxCurve>> {
    return read_fbx_curves(std::as_bytes(std::span(data, size)));
  });
  if (!curves) {
    fuzz::require_honest(curves.error());
    return 0;
  }
  for (const FbxCurve& curve : *curves) {
    fuzz::require(!curve.keys.empty() && curve.axis >= 0 && curve.axis < 3, "a curve of nothing");
    for (std::size_t k = 0; k + 1 < curve.keys.size(); ++k) {
      const FbxKey &from = curve.keys[k], &to = curve.keys[k + 1];
      fuzz::require(from.time_s < to.time_s, "keys out of order");
      fuzz::require(!std::isnan(fbx_value_at(from, to, from.time_s)), "a value that is no number");
    }
  }
  return 0;
}
