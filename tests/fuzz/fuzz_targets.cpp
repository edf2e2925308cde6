// Targets files, for a rig with every kind of joint.

#include <filesystem>
#include <fstream>
#include <iterator>

#include "importers/rig_json.h"
#include "importers/targets_json.h"
#include "tests/fuzz/fuzz_target.h"

namespace {

std::string shipped(const std::string& path) {
  std::ifstream in(std::filesystem::path(LIMBER_SOURCE_DIR) / "assets/data" / path);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

}  // namespace

namespace limber::fuzz {

std::vector<std::string> seeds() {
  return {shipped("poses/hand-poses.json"), shipped("poses/hand-out-of-reach.json"),
          shipped("poses/biped-foot-root-poses.json")};
}

}  // namespace limber::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace limber;
  static const Rig rig = *read_rig_json(shipped("rigs/hand.json"));
  const auto targets = read_targets_json(fuzz::text_of(data, size), rig);
  if (!targets) {
    fuzz::require_honest(targets.error());
    return 0;
  }
  fuzz::require(!targets->poses.empty(), "targets without a pose");
  for (const PoseTargets& pose : targets->poses) {
    for (const TargetRow& row : pose.rows) {
      fuzz::require(row.effector >= 0 && row.effector < std::int32_t(rig.effectors.size()),
                    "a target of no effector");
    }
  }
  return 0;
}
