// libFuzzer starts from files: with LIMBER_SEEDS set to a folder, the seeds are written there.

#include <filesystem>
#include <fstream>

#include "tests/fuzz/fuzz_target.h"

extern "C" int LLVMFuzzerInitialize(int*, char***) {
  const char* folder = std::getenv("LIMBER_SEEDS");
  if (folder == nullptr) return 0;
  int n = 0;
  for (const std::string& seed : limber::fuzz::seeds()) {
    std::ofstream(std::filesystem::path(folder) / ("seed" + std::to_string(n++)), std::ios::binary)
        << seed;
  }
  return 0;
}
