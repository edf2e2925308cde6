#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "assets/model/result.h"

namespace limber {

/// Makes names non-empty ('<stem><row>'), free of control characters and unique ('name_2').
/// Authored names win over generated ones (same length, 1: generated); what happens to an authored
/// name is told in a warning: `joint-unnamed` or `joint-renamed`.
void make_names_valid(std::span<std::string> names, std::span<const std::uint8_t> generated,
                      const char* stem, Warnings&);

}  // namespace limber
