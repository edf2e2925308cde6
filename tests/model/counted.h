#pragma once

#include <Eigen/Core>
#include <cmath>

namespace limber::test {

/// How many of each a piece of arithmetic took. Signs and comparisons are free; a multiplication by
/// a constant counts.
struct Operations {
  int multiplications = 0, additions = 0, divisions = 0, square_roots = 0;

  bool operator==(const Operations&) const = default;
};

/// A double that counts what is done to it. Not thread-safe.
class Counted {
 public:
  Counted(double value = 0.0) : value_(value) {}
  double value() const { return value_; }

  static Operations& count() {
    static Operations operations;
    return operations;
  }

  friend Counted operator+(Counted a, Counted b) { return add(a.value_ + b.value_); }
  friend Counted operator-(Counted a, Counted b) { return add(a.value_ - b.value_); }
  friend Counted operator*(Counted a, Counted b) {
    ++count().multiplications;
    return a.value_ * b.value_;
  }
  friend Counted operator/(Counted a, Counted b) {
    ++count().divisions;
    return a.value_ / b.value_;
  }
  friend Counted sqrt(Counted a) {
    ++count().square_roots;
    return std::sqrt(a.value_);
  }
  Counted operator-() const { return -value_; }
  Counted& operator+=(Counted b) { return *this = *this + b; }
  Counted& operator-=(Counted b) { return *this = *this - b; }
  Counted& operator*=(Counted b) { return *this = *this * b; }
  Counted& operator/=(Counted b) { return *this = *this / b; }
  friend bool operator==(Counted a, Counted b) { return a.value_ == b.value_; }
  friend bool operator<(Counted a, Counted b) { return a.value_ < b.value_; }
  friend bool operator>(Counted a, Counted b) { return a.value_ > b.value_; }

 private:
  static Counted add(double value) {
    ++count().additions;
    return value;
  }
  double value_;
};

/// What `work` takes; its result is not looked at.
template <class Work>
Operations operations_of(Work work) {
  Counted::count() = {};
  [[maybe_unused]] const auto result = work();
  return Counted::count();
}

}  // namespace limber::test

namespace Eigen {
template <>
struct NumTraits<limber::test::Counted> : NumTraits<double> {
  using Real = limber::test::Counted;
  using NonInteger = limber::test::Counted;
  using Nested = limber::test::Counted;
  using Literal = limber::test::Counted;
  enum { RequireInitialization = 1 };
};
}  // namespace Eigen
