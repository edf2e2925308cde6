#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <string_view>
#include <vector>

#include "assets/model/result.h"

/// A fuzz target is a file that defines both functions below. Built with clang it is a libFuzzer
/// program; with other compilers `mutator.cpp` drives it.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace limber::fuzz {

/// Good inputs to start from, made here; no file is needed.
std::vector<std::string> seeds();

inline std::string_view text_of(const std::uint8_t* data, std::size_t size) {
  return {reinterpret_cast<const char*>(data), size};
}

/// What holds for every input, good or bad.
inline void require(bool holds, const char* what) {
  if (holds) return;
  std::fprintf(stderr, "fuzz: %s\n", what);
  std::abort();
}

/// A refusal names a code and a way out; an exception that nobody expected is a bug.
inline void require_honest(const Error& error) {
  require(!error.code.empty() && !error.message.empty(), "an error without a code or a message");
  require(error.code != "import-internal", error.message.c_str());
}

}  // namespace limber::fuzz
