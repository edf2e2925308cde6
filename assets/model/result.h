#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <variant>
#include <vector>

namespace limber {

/// What went wrong, where, and what to do about it. Codes are stable: scripts may match on them,
/// `limber explain CODE` tells more, and `codes.h` lists them all.
struct Error {
  std::string code;
  std::string message;
  std::string file = {};
  std::string joint = {};
  std::int64_t frame = -1;  ///< -1: no single frame is to blame
  std::string hint = {};    ///< the way out
};

/// A repair or a loss that the user should know of; the work went on.
struct Warning {
  std::string code;
  std::string message;
  std::string joint = {};
  std::int64_t frame = -1;
};

using Warnings = std::vector<Warning>;

/// A value, or the reason why there is none. No exception leaves a module.
template <class T>
class [[nodiscard]] Result {
 public:
  Result(T value) : state_(std::in_place_index<0>, std::move(value)) {}
  Result(Error error) : state_(std::in_place_index<1>, std::move(error)) {}

  bool ok() const { return state_.index() == 0; }
  explicit operator bool() const { return ok(); }

  T& value() & { return std::get<0>(state_); }
  const T& value() const& { return std::get<0>(state_); }
  T&& value() && { return std::get<0>(std::move(state_)); }
  T& operator*() & { return value(); }
  const T& operator*() const& { return value(); }
  T&& operator*() && { return std::move(*this).value(); }
  T* operator->() { return &value(); }
  const T* operator->() const { return &value(); }

  const Error& error() const { return std::get<1>(state_); }
  Error& error() { return std::get<1>(state_); }

 private:
  std::variant<T, Error> state_;
};

template <>
class [[nodiscard]] Result<void> {
 public:
  Result() = default;
  Result(Error error) : error_(std::move(error)), ok_(false) {}

  bool ok() const { return ok_; }
  explicit operator bool() const { return ok_; }
  const Error& error() const { return error_; }
  Error& error() { return error_; }

 private:
  Error error_;
  bool ok_ = true;
};

}  // namespace limber
