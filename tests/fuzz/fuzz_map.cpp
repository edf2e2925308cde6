// Map files.

#include "pipeline/map_file.h"
#include "tests/fuzz/fuzz_target.h"

namespace limber::fuzz {

std::vector<std::string> seeds() {
  return {R"({"format": "limber-map/1",
 "source": {"file": "walk.bvh", "joints": ["Hips", "Spine"], "roles": {"hips": "Hips"}},
 "target": {"roles": {"hips": "pelvis", "spine": "spine_01"}}})"};
}

}  // namespace limber::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace limber;
  const auto map = read_map_json(fuzz::text_of(data, size));
  if (!map) fuzz::require_honest(map.error());
  return 0;
}
