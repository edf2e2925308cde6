#include "importers/json_view.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>
#include <vector>

#include "importers/failure.h"

namespace limber {

using nlohmann::json;

namespace {

constexpr int kMaxDepth = 256;

/// The way out of a document that does not say what its format demands.
const char* hint_for(std::string_view code) {
  if (code == "rig-json") return "compare with assets/data/rigs/ikrig.schema.json";
  if (code == "targets-json") {
    return "compare with assets/data/schemas/targets.schema.json, or start from "
           "`limber pose RIG --example`";
  }
  return "the file breaks the rules of its format: run the Khronos glTF validator, export it again";
}

std::string escaped(std::string_view key) {
  std::string out;
  for (const char c : key) {
    if (c == '~') {
      out += "~0";
    } else if (c == '/') {
      out += "~1";
    } else {
      out += c;
    }
  }
  return out;
}

/// "line L, column C" of a byte offset.
std::string place_of(std::string_view text, std::size_t offset) {
  const std::string_view before = text.substr(0, std::min(offset, text.size()));
  const auto line = 1 + std::count(before.begin(), before.end(), '\n');
  const std::size_t line_begin = before.rfind('\n') + 1;  // npos + 1 = 0
  return fmt::format("line {}, column {}", line, before.size() - line_begin + 1);
}

void check_depth(std::string_view text, const char* code) {
  int depth = 0;
  bool in_string = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (in_string) {
      if (c == '\\') ++i;
      if (c == '"') in_string = false;
    } else if (c == '"') {
      in_string = true;
    } else if (c == '{' || c == '[') {
      if (++depth > kMaxDepth) {
        fail(code,
             fmt::format("JSON nested deeper than {} levels at {}", kMaxDepth, place_of(text, i)),
             hint_for(code));
      }
    } else if (c == '}' || c == ']') {
      --depth;
    }
  }
}

}  // namespace

bool JsonView::has(const char* key) const { return value_->is_object() && value_->contains(key); }

JsonView JsonView::at(const char* key) const {
  object();
  const auto it = value_->find(key);
  if (it == value_->end()) complain(fmt::format("'{}' is missing", key));
  return {*it, code_, pointer_ + "/" + escaped(key)};
}

std::optional<JsonView> JsonView::find(const char* key) const {
  object();
  const auto it = value_->find(key);
  if (it == value_->end()) return std::nullopt;
  return JsonView(*it, code_, pointer_ + "/" + escaped(key));
}

JsonView JsonView::operator[](std::size_t index) const {
  return {(*value_)[index], code_, pointer_ + "/" + std::to_string(index)};
}

const JsonView& JsonView::object() const {
  if (!value_->is_object()) complain("an object is expected");
  return *this;
}

const JsonView& JsonView::array() const {
  if (!value_->is_array()) complain("an array is expected");
  return *this;
}

const JsonView& JsonView::array_of(std::size_t count) const {
  array();
  if (size() != count) complain(fmt::format("{} entries are expected, not {}", count, size()));
  return *this;
}

bool JsonView::is_integer() const {
  if (value_->is_number_integer()) return true;
  return value_->is_number_float() && std::trunc(value_->get<double>()) == value_->get<double>();
}

double JsonView::number() const {
  if (!value_->is_number()) complain("a number is expected");
  const double v = value_->get<double>();
  if (!std::isfinite(v)) complain("the number is not finite");
  return v;
}

std::int64_t JsonView::integer(std::int64_t min, std::int64_t max) const {
  if (!value_->is_number() || !is_integer()) complain("an integer is expected");
  const double v = value_->get<double>();
  if (!(v >= double(min) && v <= double(max))) {
    complain(fmt::format("{} is outside [{}, {}]", v, min, max));
  }
  return static_cast<std::int64_t>(v);
}

bool JsonView::boolean() const {
  if (!value_->is_boolean()) complain("true or false is expected");
  return value_->get<bool>();
}

const std::string& JsonView::string() const {
  if (!value_->is_string()) complain("a string is expected");
  return value_->get_ref<const std::string&>();
}

Eigen::Vector3d JsonView::vector3() const {
  array_of(3);
  return {(*this)[0].number(), (*this)[1].number(), (*this)[2].number()};
}

void JsonView::only(std::initializer_list<std::string_view> keys) const {
  object();
  for (const auto& [key, unused] : value_->items()) {
    if (std::find(keys.begin(), keys.end(), key) == keys.end()) {
      complain(fmt::format("unknown key '{}'", key));
    }
  }
}

void JsonView::complain(const std::string& what) const {
  fail(code_, fmt::format("{}: {}", pointer_.empty() ? "/" : pointer_, what), hint_for(code_));
}

json parse_json(std::string_view text, const char* code, bool unique_keys) {
  check_depth(text, code);
  std::vector<std::set<std::string>> keys;
  const json::parser_callback_t note_keys = [&](int, json::parse_event_t event, json& parsed) {
    if (event == json::parse_event_t::object_start) keys.emplace_back();
    if (event == json::parse_event_t::object_end) keys.pop_back();
    if (event == json::parse_event_t::key &&
        !keys.back().insert(parsed.get_ref<const std::string&>()).second) {
      fail(code,
           fmt::format("the key '{}' is given twice in one object",
                       parsed.get_ref<const std::string&>()),
           hint_for(code));
    }
    return true;
  };
  try {
    return json::parse(text.begin(), text.end(), unique_keys ? note_keys : nullptr);
  } catch (const json::parse_error& e) {
    fail(code, fmt::format("not valid JSON at {}", place_of(text, e.byte == 0 ? 0 : e.byte - 1)),
         "the file is damaged or cut short");
  } catch (const json::out_of_range&) {
    fail(code, "a number is too large for a double", "repair it in the tool that wrote the file");
  }
}

}  // namespace limber
