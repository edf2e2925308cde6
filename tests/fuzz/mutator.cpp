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
#include <random>

#include "tests/fuzz/fuzz_target.h"

namespace {

namespace fs = std::filesystem;

std::string read(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

class Mutator {
 public:
  Mutator(std::vector<std::string> inputs, unsigned seed)
      : inputs_(std::move(inputs)), random_(seed) {}

  std::string next() {
    std::string text = pick();
    for (std::size_t n = 1 + below(8); n > 0; --n) mutate(text);
    constexpr std::size_t kLongest = 1 << 18;
    if (text.size() > kLongest) text.resize(kLongest);
    return text;
  }

 private:
  std::size_t below(std::size_t n) { return n == 0 ? 0 : random_() % n; }
  const std::string& pick() { return inputs_[below(inputs_.size())]; }

  void mutate(std::string& text) {
    if (text.empty()) text = " ";
    const std::size_t at = below(text.size());
    const std::size_t length = std::min(1 + below(1 + below(64)), text.size() - at);
    switch (below(8)) {
      case 0:
        text[at] = static_cast<char>(text[at] ^ (1 << below(8)));
        break;
      case 1:
        text[at] = static_cast<char>(below(256));
        break;
      case 2:
        text.erase(at, length);
        break;
      case 3:
        text.insert(at, text.substr(at, length));
        break;
      case 4: {
        const std::string& other = pick();
        const std::size_t from = below(other.size());
        text.insert(at, other.substr(from, 1 + below(256)));
        break;
      }
      case 5:
        text.resize(at);
        break;
      case 6: {
        const std::size_t to = below(text.size());
        text.insert(to, text.substr(at, length));
        break;
      }
      default:
        replace_number(text, at);
    }
  }

  /// The next number becomes one of those that readers stumble over.
  void replace_number(std::string& text, std::size_t at) {
    static const char* const kNumbers[] = {"0",           "-1",
                                           "1",           "2147483647",
                                           "2147483648",  "4294967295",
                                           "1e308",       "1e999",
                                           "-1e999",      "9223372036854775807",
                                           "0.5",         "nan",
                                           "-0.0",        "1e-320",
                                           "65535",       "65536",
                                           "1000000000",  "255",
                                           "[]",          "{}",
                                           "\"\"",        "null",
                                           "true",        "5120",
                                           "5126",        "1073741824",
                                           "-2147483648", "18446744073709551616"};
    const std::size_t begin = text.find_first_of("0123456789", at);
    if (begin == std::string::npos) return;
    const std::size_t end = text.find_first_not_of("0123456789.eE+-", begin);
    text.replace(begin, (end == std::string::npos ? text.size() : end) - begin,
                 kNumbers[below(std::size(kNumbers))]);
  }

  std::vector<std::string> inputs_;
  std::mt19937 random_;
};

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
  Mutator mutator(options.inputs, options.seed);
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
