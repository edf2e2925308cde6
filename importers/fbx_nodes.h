#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace limber {

/// Numbers of arrays are doubles, whatever their type in the file.
using FbxValue = std::variant<std::int64_t, double, std::string, std::vector<double>>;

/// A node of an FBX 7 file: `Name: value, value { child child }`.
struct FbxNode {
  std::string name;
  std::vector<FbxValue> values;
  std::vector<FbxNode> children;

  // What is not there, or is of another type, reads as nothing.
  std::int64_t integer(std::size_t value) const;
  std::string_view text(std::size_t value) const;
  std::span<const double> numbers_of(std::string_view child) const;
};

/// The nodes of a binary or ASCII FBX 7 whose own names and all ancestors' names are `wanted`, in
/// the file's order; all others are passed over. No declared count or size is believed beyond the
/// bytes that remain. Fails (see failure.h) with `fbx-nodes`.
std::vector<FbxNode> read_fbx_nodes(std::span<const std::byte>,
                                    std::span<const std::string_view> wanted);

}  // namespace limber
