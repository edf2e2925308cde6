// Batch jobs: what is read is a job that can be run.

#include "pipeline/batch_job.h"
#include "tests/fuzz/fuzz_target.h"

namespace limber::fuzz {

std::vector<std::string> seeds() {
  return {R"({"sources": ["clips/**/*.bvh", "@list.txt"],
 "targets": ["hand", {"path": "hero.glb", "map": "hero.map.json"}], "output": "out"})",
          R"({"$schema": "job.schema.json", "description": "all", "sources": ["a"],
 "targets": ["b"], "output": "o", "map": "m.json", "gates": "strict",
 "options": {"rate": 30, "formats": ["glb", "bvh"], "limits": true, "range": "0:5"},
 "caps": {"memory_mb": 2048, "output_mb": 64, "cpu_s": 60, "wall_s": 120}} // all of it)"};
}

namespace {

void require_runnable(const BatchJob& job) {
  require(!job.sources.empty() && !job.targets.empty() && !job.output.empty(),
          "a job without sources, targets or output");
  for (const BatchTarget& target : job.targets) require(!target.path.empty(), "a nameless target");
  for (const auto& [pointer, words] : job.flags) {
    require(pointer.starts_with("/options/"), "a flag from elsewhere");
    require(words.size() == 1 && words[0].starts_with("--"), "a flag that is none");
  }
}

}  // namespace
}  // namespace limber::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace limber;
  const auto job = job_from_json(fuzz::text_of(data, size));
  if (!job) {
    fuzz::require_honest(job.error());
    return 0;
  }
  fuzz::require_runnable(*job);
  return 0;
}
