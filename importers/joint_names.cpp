#include "importers/joint_names.h"

#include <fmt/format.h>

#include <unordered_map>
#include <unordered_set>

namespace limber {

namespace {

constexpr std::size_t kMaxToldOf = 8;

void replace_control_characters(std::string& name) {
  for (char& c : name) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7F) c = '_';
  }
}

}  // namespace

void make_names_valid(std::span<std::string> names, std::span<const std::uint8_t> generated,
                      const char* stem, Warnings& warnings) {
  std::unordered_set<std::string> all;
  std::size_t unnamed = 0;
  for (std::size_t i = 0; i < names.size(); ++i) {
    replace_control_characters(names[i]);
    if (names[i].empty()) {
      names[i] = stem + std::to_string(i);
      ++unnamed;
    }
    all.insert(names[i]);
  }
  if (unnamed > 0) {
    warnings.push_back(
        {"joint-unnamed",
         fmt::format("{} joints have no name; they are called '{}N'", unnamed, stem)});
  }
  std::unordered_set<std::string> taken;
  std::unordered_map<std::string, int> next;
  std::size_t renamed = 0;
  const auto take = [&](std::size_t i) {
    if (taken.insert(names[i]).second) return;
    const std::string wanted = names[i];
    int& number = next.try_emplace(wanted, 2).first->second;
    do {
      names[i] = fmt::format("{}_{}", wanted, number++);
    } while (all.contains(names[i]) || taken.contains(names[i]));
    taken.insert(names[i]);
    if (generated[i] == 0 && ++renamed <= kMaxToldOf) {
      warnings.push_back({"joint-renamed",
                          fmt::format("the name '{}' was taken; now '{}'", wanted, names[i]),
                          names[i]});
    }
  };
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (generated[i] == 0) take(i);
  }
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (generated[i] != 0) take(i);
  }
  if (renamed > kMaxToldOf) {
    warnings.push_back({"joint-renamed", fmt::format("{} names in all were taken", renamed)});
  }
}

}  // namespace limber
