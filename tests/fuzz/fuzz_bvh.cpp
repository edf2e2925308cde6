// BVH: reads or refuses; what is read keeps every invariant (import_bytes checks them all).

#include "importers/importer.h"
#include "tests/fuzz/fuzz_target.h"
#include "tests/importers/bvh_dialects.h"

namespace limber::fuzz {

std::vector<std::string> seeds() {
  std::vector<std::string> out;
  for (test::NamedDialect& named : test::dialects()) {
    named.dialect.frames = 2;
    out.push_back(test::BvhWriter(named.dialect).write());
  }
  return out;
}

}  // namespace limber::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace limber;
  const auto imported = import_bytes(std::as_bytes(std::span(data, size)), "bvh", nullptr);
  if (!imported) {
    fuzz::require_honest(imported.error());
    return 0;
  }
  fuzz::require(imported->facts.unit_m > 0.0, "a unit that is not positive");
  fuzz::require(imported->clips.size() <= 1, "a BVH with several clips");
  return 0;
}
