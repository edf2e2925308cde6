#pragma once

#include <algorithm>
#include <cstddef>
#include <iterator>
#include <random>
#include <string>
#include <utility>
#include <vector>

namespace limber::fuzz {

/// Good inputs, changed at random: bits, bytes, runs of bytes, pieces of other inputs, and numbers.
/// The same seed gives the same changes.
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

}  // namespace limber::fuzz
