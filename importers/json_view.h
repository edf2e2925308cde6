#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <initializer_list>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>

namespace limber {

/// A place in a JSON document that knows its JSON pointer, so that every complaint names it.
/// Internal to this module. The accessors `fail` with the code that the document was opened with.
class JsonView {
 public:
  JsonView(const nlohmann::json& value, const char* code) : value_(&value), code_(code) {}

  bool has(const char* key) const;
  JsonView at(const char* key) const;                   ///< required member
  std::optional<JsonView> find(const char* key) const;  ///< absent: nullopt
  JsonView operator[](std::size_t index) const;
  std::size_t size() const { return value_->size(); }

  const JsonView& object() const;  ///< itself, once it is known to be an object
  const JsonView& array() const;
  const JsonView& array_of(std::size_t count) const;
  bool is_null() const { return value_->is_null(); }
  bool is_string() const { return value_->is_string(); }
  bool is_array() const { return value_->is_array(); }
  bool is_object() const { return value_->is_object(); }
  bool is_integer() const;

  double number() const;  ///< finite
  std::int64_t integer(std::int64_t min, std::int64_t max) const;
  bool boolean() const;
  const std::string& string() const;
  Eigen::Vector3d vector3() const;

  /// Unknown members are errors: a misspelt key must not be silently without effect.
  void only(std::initializer_list<std::string_view> keys) const;
  [[noreturn]] void complain(const std::string& what) const;

  const std::string& pointer() const { return pointer_; }
  const nlohmann::json& value() const { return *value_; }

 private:
  JsonView(const nlohmann::json& value, const char* code, std::string pointer)
      : value_(&value), code_(code), pointer_(std::move(pointer)) {}

  const nlohmann::json* value_;
  const char* code_;
  std::string pointer_;
};

/// Parses RFC 8259 JSON, at most 256 levels deep; `unique_keys` refuses a key given twice.
/// Fails with `code`, naming line and column.
nlohmann::json parse_json(std::string_view text, const char* code, bool unique_keys = false);

}  // namespace limber
