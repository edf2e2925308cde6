#include "importers/text_encoding.h"

#include <iconv.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdint>

namespace limber {

bool is_utf8(std::string_view text) {
  for (std::size_t i = 0; i < text.size();) {
    const auto lead = static_cast<std::uint8_t>(text[i]);
    const int length = lead < 0x80 ? 1 : lead < 0xC2 ? 0 : lead < 0xE0 ? 2 : lead < 0xF0 ? 3 : 4;
    if (length == 0 || lead > 0xF4 || i + length > text.size()) return false;
    std::uint32_t code = length == 1 ? lead : lead & (0x7Fu >> length);
    for (int k = 1; k < length; ++k) {
      const auto byte = static_cast<std::uint8_t>(text[i + k]);
      if ((byte & 0xC0) != 0x80) return false;
      code = code << 6 | (byte & 0x3Fu);
    }
    const bool overlong = (length == 3 && code < 0x800) || (length == 4 && code < 0x10000);
    if (overlong || code > 0x10FFFF || (code >= 0xD800 && code < 0xE000)) return false;
    i += length;
  }
  return true;
}

std::optional<std::string> to_utf8(std::string_view text, const char* encoding) {
  const iconv_t converter = iconv_open("UTF-8", encoding);
  if (converter == reinterpret_cast<iconv_t>(-1)) return std::nullopt;
  std::string out;
  std::array<char, 4096> chunk;
  char* in = const_cast<char*>(text.data());
  std::size_t in_left = text.size();
  bool ok = true;
  while (ok && in_left > 0) {
    char* to = chunk.data();
    std::size_t to_left = chunk.size();
    const std::size_t result = iconv(converter, &in, &in_left, &to, &to_left);
    out.append(chunk.data(), to);
    ok = result != static_cast<std::size_t>(-1) || (errno == E2BIG && to != chunk.data());
  }
  iconv_close(converter);
  if (!ok) return std::nullopt;
  return out;
}

const char* repair_names(std::span<std::string> names) {
  const auto broken = [](const std::string& name) { return !is_utf8(name); };
  if (std::none_of(names.begin(), names.end(), broken)) return nullptr;
  const auto fits = [&](const char* encoding) {
    return std::all_of(names.begin(), names.end(), [&](const std::string& name) {
      return is_utf8(name) || to_utf8(name, encoding).has_value();
    });
  };
  const char* encoding = fits("SHIFT_JIS") ? "SHIFT_JIS" : fits("CP1252") ? "CP1252" : "LATIN1";
  for (std::string& name : names) {
    if (broken(name)) name = to_utf8(name, encoding).value_or("name");
  }
  return encoding;
}

std::string_view cut_utf8(std::string_view text, std::size_t max_bytes) {
  if (text.size() <= max_bytes) return text;
  while (max_bytes > 0 && (static_cast<std::uint8_t>(text[max_bytes]) & 0xC0) == 0x80) --max_bytes;
  return text.substr(0, max_bytes);
}

}  // namespace limber
