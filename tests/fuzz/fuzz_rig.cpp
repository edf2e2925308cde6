// Rigs: what is read is written and read again unchanged.

#include <filesystem>
#include <fstream>
#include <iterator>

#include "importers/rig_json.h"
#include "tests/fuzz/fuzz_target.h"

namespace limber::fuzz {

std::vector<std::string> seeds() {
  std::vector<std::string> out;
  for (const char* name : {"arm2", "arm3", "biped", "hand"}) {
    std::ifstream in(std::filesystem::path(LIMBER_SOURCE_DIR) / "assets/data/rigs" /
                     (std::string(name) + ".json"));
    out.emplace_back(std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>());
  }
  return out;
}

}  // namespace limber::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace limber;
  const auto rig = read_rig_json(fuzz::text_of(data, size));
  if (!rig) {
    fuzz::require_honest(rig.error());
    return 0;
  }
  fuzz::require(validate(*rig).ok(), "a rig was read that breaks an invariant");
  return 0;
}
