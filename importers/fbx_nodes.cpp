// The layout of FBX 7 is not published; this follows what the Blender developers found ("FBX binary
// file format specification", code.blender.org, 2013), and files. A binary node is
//   end offset, number of values, their bytes, length of the name, name, values, children,
// with offsets of 64 bits from version 7500 on; an empty record ends a list of children.
#include "importers/fbx_nodes.h"

#include <fmt/format.h>
#include <zlib.h>

#include <algorithm>
#include <bit>
#include <charconv>
#include <cstring>

#include "importers/failure.h"

namespace limber {

namespace {

constexpr int kMaxDepth = 8;
constexpr std::size_t kMaxNumbers = std::size_t{1} << 23;  // of all arrays: 64 MB
constexpr std::size_t kMostInflation = 1032;               // of deflate: zlib's own bound

[[noreturn]] void damaged(const char* what) {
  fail("fbx-nodes", fmt::format("the FBX nodes cannot be read: {}", what), "export the file again");
}

/// Counts the numbers that arrays hold, in all.
class NumberBudget {
 public:
  void take(std::size_t count) {
    if (count > left_) damaged("too many numbers");
    left_ -= count;
  }

 private:
  std::size_t left_ = kMaxNumbers;
};

bool among(std::string_view name, std::span<const std::string_view> wanted) {
  return std::find(wanted.begin(), wanted.end(), name) != wanted.end();
}

// ---- binary

static_assert(std::endian::native == std::endian::little, "binary FBX is read in place");

template <class T>
T number_at(const std::byte* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof value);
  return value;
}

class BinaryReader {
 public:
  BinaryReader(std::span<const std::byte> bytes, std::span<const std::string_view> wanted)
      : bytes_(bytes), wanted_(wanted) {}

  std::vector<FbxNode> run() {
    constexpr std::size_t kHeader = 27;
    need(kHeader, bytes_.size());
    if (bytes_[22] != std::byte{0}) damaged("big-endian numbers");
    wide_ = number_at<std::uint32_t>(bytes_.data() + 23) >= 7500;
    at_ = kHeader;
    return list(bytes_.size(), 0);
  }

 private:
  struct Record {
    std::size_t end = 0, values = 0, values_end = 0;
    std::string_view name;
  };

  void need(std::size_t size, std::size_t end) const {
    if (end < at_ || end - at_ < size) damaged("it is cut short");
  }
  template <class T>
  T take(std::size_t end) {
    need(sizeof(T), end);
    at_ += sizeof(T);
    return number_at<T>(bytes_.data() + at_ - sizeof(T));
  }
  std::size_t take_offset(std::size_t end) {
    return wide_ ? take<std::uint64_t>(end) : take<std::uint32_t>(end);
  }
  std::string_view take_text(std::size_t size, std::size_t end) {
    need(size, end);
    at_ += size;
    return {reinterpret_cast<const char*>(bytes_.data()) + at_ - size, size};
  }

  Record take_record(std::size_t end) {
    Record record;
    record.end = take_offset(end);
    record.values = take_offset(end);
    const std::size_t bytes = take_offset(end);
    record.name = take_text(take<std::uint8_t>(end), end);
    if (record.end == 0) return record;
    if (record.end > end) damaged("a node extends beyond its parent");
    need(bytes, record.end);
    record.values_end = at_ + bytes;
    return record;
  }

  std::vector<FbxNode> list(std::size_t end, int depth) {
    std::vector<FbxNode> nodes;
    while (at_ < end) {
      const Record record = take_record(end);
      if (record.end == 0) break;
      if (depth < kMaxDepth && among(record.name, wanted_)) nodes.push_back(node(record, depth));
      at_ = record.end;
    }
    return nodes;
  }

  FbxNode node(const Record& record, int depth) {
    FbxNode node{.name = std::string(record.name), .values = {}, .children = {}};
    for (std::size_t k = 0; k < record.values; ++k) node.values.push_back(value(record.values_end));
    at_ = record.values_end;
    node.children = list(record.end, depth + 1);
    return node;
  }

  FbxValue value(std::size_t end) {
    switch (take<char>(end)) {
      case 'C':
      case 'B':
        return std::int64_t{take<std::uint8_t>(end)};
      case 'Y':
        return std::int64_t{take<std::int16_t>(end)};
      case 'I':
        return std::int64_t{take<std::int32_t>(end)};
      case 'L':
        return take<std::int64_t>(end);
      case 'F':
        return double{take<float>(end)};
      case 'D':
        return take<double>(end);
      case 'S':
      case 'R':
        return std::string(take_text(take<std::uint32_t>(end), end));
      case 'f':
        return array<float>(end);
      case 'd':
        return array<double>(end);
      case 'i':
        return array<std::int32_t>(end);
      case 'l':
        return array<std::int64_t>(end);
      case 'b':
      case 'c':
        return array<std::uint8_t>(end);
      default:
        damaged("a value is of unknown type");
    }
  }

  template <class T>
  std::vector<double> array(std::size_t end) {
    const std::size_t count = take<std::uint32_t>(end);
    const bool deflated = take<std::uint32_t>(end) == 1;
    const std::size_t stored = take<std::uint32_t>(end);
    numbers_.take(count);
    const std::size_t size = count * sizeof(T);
    const std::string_view raw = take_text(deflated ? stored : size, end);
    std::string inflated;
    if (deflated) {
      if (size > kMostInflation * stored) damaged("an array cannot be as large as it says");
      inflated.resize(size);
      uLongf made = size;
      const int status = ::uncompress(reinterpret_cast<Bytef*>(inflated.data()), &made,
                                      reinterpret_cast<const Bytef*>(raw.data()), raw.size());
      if (status != Z_OK || made != size) damaged("an array's compressed bytes are broken");
    }
    const char* const from = deflated ? inflated.data() : raw.data();
    std::vector<double> numbers(count);
    for (std::size_t k = 0; k < count; ++k) {
      numbers[k] = static_cast<double>(
          number_at<T>(reinterpret_cast<const std::byte*>(from) + k * sizeof(T)));
    }
    return numbers;
  }

  std::span<const std::byte> bytes_;
  std::span<const std::string_view> wanted_;
  NumberBudget numbers_;
  std::size_t at_ = 0;
  bool wide_ = false;
};

// ---- ASCII

class TextReader {
 public:
  TextReader(std::string_view text, std::span<const std::string_view> wanted)
      : text_(text), wanted_(wanted) {}

  std::vector<FbxNode> run() { return list(0); }

 private:
  bool ended() const { return at_ >= text_.size(); }
  char here() const { return ended() ? '\0' : text_[at_]; }

  static bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\r'; }

  void skip_line() {
    while (!ended() && text_[at_] != '\n') ++at_;
  }
  void skip_space() {
    for (; !ended(); ++at_) {
      if (text_[at_] == ';') skip_line();
      if (ended() || !(is_blank(text_[at_]) || text_[at_] == '\n')) return;
    }
  }
  void skip_blanks() {
    while (is_blank(here())) ++at_;
    if (here() == ';') skip_line();
  }
  std::string_view take_quoted() {
    const std::size_t begin = ++at_;
    while (!ended() && text_[at_] != '"') ++at_;
    if (ended()) damaged("a text has no end");
    return text_.substr(begin, at_++ - begin);
  }
  std::string_view take_word() {
    const std::size_t begin = at_;
    constexpr std::string_view kEnds = " \t\r\n,:;{}\"";
    while (!ended() && kEnds.find(text_[at_]) == std::string_view::npos) ++at_;
    return text_.substr(begin, at_ - begin);
  }

  /// Nodes up to the brace that closes their parent, or the end of the text.
  std::vector<FbxNode> list(int depth) {
    std::vector<FbxNode> nodes;
    while (true) {
      skip_space();
      if (ended()) return nodes;
      if (here() == '}') {
        ++at_;
        return nodes;
      }
      const std::string_view name = take_name();
      if (depth < kMaxDepth && among(name, wanted_)) {
        nodes.push_back(node(name, depth));
      } else {
        skip_node();
      }
    }
  }

  std::string_view take_name() {
    const std::string_view name = take_word();
    if (name.empty() || here() != ':') damaged("a node has no name");
    ++at_;
    return name;
  }

  /// The rest of a node: to the end of its line, or of its block.
  void skip_node() {
    int open = 0;
    for (; !ended(); ++at_) {
      const char c = text_[at_];
      if (c == '"') {
        take_quoted();
        --at_;
      } else if (c == ';') {
        skip_line();
        --at_;
      } else if (c == '{') {
        ++open;
      } else if (c == '}') {
        if (open <= 1) {
          at_ += static_cast<std::size_t>(open);  // where none is open, it is the parent's
          return;
        }
        --open;
      } else if (c == '\n' && open == 0 && !goes_on()) {
        return;
      }
    }
  }

  /// Whether the last character before the end of a line is a comma.
  bool goes_on() const {
    std::size_t k = at_;
    while (k > 0 && is_blank(text_[k - 1])) --k;
    return k > 0 && text_[k - 1] == ',';
  }

  FbxNode node(std::string_view name, int depth) {
    FbxNode node{.name = std::string(name), .values = {}, .children = {}};
    while (true) {
      skip_blanks();
      const char c = here();
      if (c == '{') {
        ++at_;
        if (!take_array(node)) node.children = list(depth + 1);
        return node;
      }
      if (c == ',') {
        ++at_;
        skip_space();
      } else if (c == '"') {
        node.values.emplace_back(std::string(take_quoted()));
      } else if (ended() || c == '\n' || c == '}') {
        return node;
      } else {
        const std::string_view word = take_word();
        if (word.empty()) damaged("a value is missing");
        node.values.push_back(value(word));
      }
    }
  }

  static FbxValue value(std::string_view word) {
    const char* const end = word.data() + word.size();
    std::int64_t integer = 0;
    if (std::from_chars(word.data(), end, integer).ptr == end) return integer;
    double real = 0.0;
    if (std::from_chars(word.data(), end, real).ptr == end) return real;
    return std::string(word);
  }

  /// `{ a: 1,2,3 }`, which makes one value of the node.
  bool take_array(FbxNode& node) {
    const std::size_t begin = at_;
    skip_space();
    if (!text_.substr(at_).starts_with("a:")) {
      at_ = begin;
      return false;
    }
    at_ += 2;
    std::vector<double> numbers;
    while (true) {
      skip_space();
      if (here() == ',') {
        ++at_;
      } else if (here() == '}') {
        break;
      } else {
        numbers_.take(1);
        numbers.push_back(array_number(node.name));
      }
    }
    ++at_;
    node.values.emplace_back(std::move(numbers));
    return true;
  }

  /// In KeyAttrDataFloat, which packs more than floats into floats, whole numbers are their bits.
  double array_number(std::string_view node_name) {
    const std::string_view word = take_word();
    if (word.empty()) damaged("an array has no end");
    const FbxValue number = value(word);
    if (const auto* real = std::get_if<double>(&number)) return *real;
    const auto* integer = std::get_if<std::int64_t>(&number);
    if (integer == nullptr) damaged("an array holds what is no number");
    if (node_name != "KeyAttrDataFloat") return static_cast<double>(*integer);
    return std::bit_cast<float>(static_cast<std::uint32_t>(*integer));
  }

  std::string_view text_;
  std::span<const std::string_view> wanted_;
  NumberBudget numbers_;
  std::size_t at_ = 0;
};

}  // namespace

std::int64_t FbxNode::integer(std::size_t value) const {
  const auto* found = value < values.size() ? std::get_if<std::int64_t>(&values[value]) : nullptr;
  return found != nullptr ? *found : 0;
}

std::string_view FbxNode::text(std::size_t value) const {
  const auto* found = value < values.size() ? std::get_if<std::string>(&values[value]) : nullptr;
  return found != nullptr ? std::string_view(*found) : std::string_view();
}

std::span<const double> FbxNode::numbers_of(std::string_view child) const {
  for (const FbxNode& node : children) {
    if (node.name != child) continue;
    for (const FbxValue& value : node.values) {
      if (const auto* numbers = std::get_if<std::vector<double>>(&value)) return *numbers;
    }
  }
  return {};
}

std::vector<FbxNode> read_fbx_nodes(std::span<const std::byte> bytes,
                                    std::span<const std::string_view> wanted) {
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  if (text.starts_with("Kaydara FBX Binary")) return BinaryReader(bytes, wanted).run();
  return TextReader(text, wanted).run();
}

}  // namespace limber
