// Numbers as exporters write them, eight digits at a time.
//
// Up to seven digits, a point and up to seven decimals are an integer of at most fourteen digits
// over a power of ten of at most 1e7. Both are exact doubles, so their quotient is the double
// nearest to what is written (Clinger 1990, section 2): the result is that of std::from_chars.
// That one is the fast_float library inside libstdc++; it is left what is not plain, since looping
// over digits whose number varies costs more in mispredicted branches than in work.
//
// Digits are told apart, aligned and summed inside one 64-bit word (Lemire 2022, "Number parsing
// at a gigabyte per second", section 5).
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <cstring>

namespace limber {

namespace detail {

/// Eight characters, the first in the lowest byte.
inline std::uint64_t load_eight(const char* text) {
  std::uint64_t word = 0;
  std::memcpy(&word, text, sizeof word);
  if constexpr (std::endian::native == std::endian::big) word = __builtin_bswap64(word);
  return word;
}

/// Digits at the start of a word: each as its value in its byte, moved to the word's end, so that
/// zeros lead.
struct Digits {
  std::uint64_t values;
  int count;  ///< 8 where every character is a digit, and `values` is then of no use
};

inline Digits leading_digits(std::uint64_t characters) {
  constexpr std::uint64_t kEach = 0x0101010101010101;
  const std::uint64_t values = characters ^ (kEach * '0');
  // A byte's high bit is set where its value is above nine.
  const std::uint64_t others =
      (((values & (kEach * 0x7F)) + kEach * (0x7F - 9)) | values) & (kEach * 0x80);
  const int count = std::countr_zero(others) / 8;
  return {count == 8 ? 0 : values << (56 - 8 * count) << 8, count};
}

/// The number that eight digit values write: pairs, then fours, then all.
inline std::int64_t sum_digits(std::uint64_t values) {
  values = (values * 10 + (values >> 8)) & 0x00FF00FF00FF00FF;
  values = (values * 100 + (values >> 16)) & 0x0000FFFF0000FFFF;
  return static_cast<std::int64_t>((values * 10000 + (values >> 32)) & 0x00000000FFFFFFFF);
}

}  // namespace detail

/// Reads [-]digits[.digits] at `text` into `value` and returns the first character behind it;
/// nullptr where the text is not of this kind or has more than seven digits on a side. The caller
/// checks what follows.
inline const char* read_plain_number(const char* text, const char* end, double& value) {
  constexpr std::ptrdiff_t kMostRead = 1 + 8 + 8;
  static constexpr std::array<std::int64_t, 8> kPowers = {1,      10,      100,       1'000,
                                                          10'000, 100'000, 1'000'000, 10'000'000};
  static constexpr std::array kDivisors = {1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7};
  if (end - text < kMostRead) return nullptr;
  const bool negative = *text == '-';
  text += negative;
  const detail::Digits whole = detail::leading_digits(detail::load_eight(text));
  if (whole.count == 8) return nullptr;
  text += whole.count;
  double magnitude = 0.0;
  if (*text == '.') {
    const detail::Digits part = detail::leading_digits(detail::load_eight(++text));
    if (part.count == 8 || whole.count + part.count == 0) return nullptr;
    text += part.count;
    const bool one_word = whole.count + part.count <= 8;
    const std::int64_t digits =
        one_word ? detail::sum_digits(whole.values >> (8 * part.count) | part.values)
                 : detail::sum_digits(whole.values) * kPowers[part.count] +
                       detail::sum_digits(part.values);
    magnitude = static_cast<double>(digits) / kDivisors[part.count];
  } else {
    if (whole.count == 0) return nullptr;
    magnitude = static_cast<double>(detail::sum_digits(whole.values));
  }
  // The sign as a bit: nobody can predict a branch on it.
  value = std::bit_cast<double>(std::bit_cast<std::uint64_t>(magnitude) |
                                static_cast<std::uint64_t>(negative) << 63);
  return text;
}

}  // namespace limber
