// Drives a fuzz target where there is no libFuzzer: changes good inputs at random, many times.
// Understands the flags of libFuzzer that we use: -runs=N -max_total_time=SECONDS -seed=N, then
// folders or files with further inputs. Before each run the input is kept in a file, which is left
// behind when the target dies.

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "tests/fuzz/fuzz_target.h"
#include "tests/fuzz/mutation.h"

namespace {

namespace fs = std::filesystem;

std::string read(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

struct Options {
  long runs = -1;
  long seconds = 0;
  unsigned seed = 1;
  std::vector<std::string> inputs = limber::fuzz::seeds();
};

void add_inputs(const fs::path& path, std::vector<std::string>& inputs) {
  if (!fs::is_directory(path)) {
    inputs.push_back(read(path));
    return;
  }
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(path)) files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  for (const fs::path& file : files) inputs.push_back(read(file));
}

Options parse(int argc, char** argv) {
  Options options;
  for (int i = 1; i < argc; ++i) {
    const std::string argument = argv[i];
    const auto value = [&](const std::string& flag) {
      return argument.starts_with(flag) ? std::atol(argument.c_str() + flag.size()) : -1;
    };
    if (value("-runs=") >= 0) {
      options.runs = value("-runs=");
    } else if (value("-max_total_time=") >= 0) {
      options.seconds = value("-max_total_time=");
    } else if (value("-seed=") >= 0) {
      options.seed = static_cast<unsigned>(value("-seed="));
    } else if (!argument.starts_with("-")) {
      add_inputs(argument, options.inputs);
    }
  }
  return options;
}

void run(const std::string& input) {
  // A copy of its own size: AddressSanitizer sees a read beyond its end.
  const std::vector<std::uint8_t> bytes(input.begin(), input.end());
  LLVMFuzzerTestOneInput(bytes.data(), bytes.size());
}

}  // namespace

int main(int argc, char** argv) {
  const Options options = parse(argc, argv);
  for (const std::string& input : options.inputs) run(input);
  const fs::path kept = fs::temp_directory_path() /
                        (fs::path(argv[0]).filename().string() + "-" + std::to_string(::getpid()));
  limber::fuzz::Mutator mutator(options.inputs, options.seed);
  const auto start = std::chrono::steady_clock::now();
  const auto out_of_time = [&] {
    return options.seconds > 0 &&
           std::chrono::steady_clock::now() - start > std::chrono::seconds(options.seconds);
  };
  long done = 0;
  for (; done != options.runs && !out_of_time(); ++done) {
    const std::string input = mutator.next();
    std::ofstream(kept, std::ios::binary) << input;
    ::alarm(20);  // one input that takes longer hangs
    run(input);
  }
  ::alarm(0);
  fs::remove(kept);
  std::printf("%ld inputs survived\n", done);
  return 0;
}
