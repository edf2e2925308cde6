#pragma once

#include <memory>
#include <random>
#include <string>
#include <vector>

#include "tests/model/rigid_forms.h"

namespace limber::test {

/// never: products alone. at_the_end: mended once, before it is looked at. each: after every one.
enum class Mending { never, at_the_end, each };

inline const char* to_string(Mending mending) {
  switch (mending) {
    case Mending::never:
      return "never";
    case Mending::at_the_end:
      return "at the end";
    default:
      return "each product";
  }
}

/// How a long product differs from the exact one.
struct Drift {
  double not_rigid = 0.0;  ///< largest entry of A'A - 1
  double angle_rad = 0.0;  ///< between the rotations, skew and scale taken off
  double position_m = 0.0;
};

inline Drift drift_of(const Seen& seen, const ExactMotion& exact) {
  const Seen truth = exact.matrix().topRows<3>().cast<double>();
  const Eigen::Matrix3d off = truth.leftCols<3>().transpose() * seen.leftCols<3>();
  // The vector 2 sin(angle) axis of the turn that is left over; exact to first order.
  const Eigen::Vector3d turn(off(2, 1) - off(1, 2), off(0, 2) - off(2, 0), off(1, 0) - off(0, 1));
  return {not_rigid(seen), 0.5 * turn.norm(), (seen.col(3) - truth.col(3)).norm()};
}

/// One form on its way along a chain.
class Traveller {
 public:
  virtual ~Traveller() = default;
  virtual void step(const ExactMotion& before_from_after) = 0;
  virtual Drift drift(const ExactMotion& exact) const = 0;
  std::string form, scalar;
  Mending mending = Mending::never;
};

template <class Form>
class FormTraveller : public Traveller {
 public:
  explicit FormTraveller(Mending when) {
    form = Form::name;
    scalar = sizeof(typename Form::Scalar) == 4 ? "float" : "double";
    mending = when;
  }
  void step(const ExactMotion& before_from_after) override {
    pose_ = pose_ * Form::from(before_from_after);
    if (mending == Mending::each) pose_ = pose_.mended();
  }
  Drift drift(const ExactMotion& exact) const override {
    return drift_of((mending == Mending::at_the_end ? pose_.mended() : pose_).seen(), exact);
  }
  const Form& pose() const { return pose_; }

 private:
  Form pose_;
};

/// Steps between poses strewn over a room. The product of the first n is the n-th pose, in closed
/// form, and no pose leaves the room however long the chain.
class Wander {
 public:
  static constexpr double kRoom = 2.0;  ///< half its width (m); positions differ by 2 sqrt(3) of it

  explicit Wander(unsigned seed) : engine_(seed) {}

  ExactMotion step() {
    const ExactMotion before = pose_;
    Eigen::Quaternion<long double> rotation(normal_(engine_), normal_(engine_), normal_(engine_),
                                            normal_(engine_));
    rotation.normalize();
    const Eigen::Matrix<long double, 3, 1> place(uniform_(engine_), uniform_(engine_),
                                                 uniform_(engine_));
    pose_ = ExactMotion::from_rotation_translation(rotation, place);
    return before.conjugate() * pose_;
  }
  const ExactMotion& pose() const { return pose_; }

 private:
  std::mt19937_64 engine_;
  std::normal_distribution<long double> normal_;
  std::uniform_real_distribution<long double> uniform_{-kRoom, kRoom};
  ExactMotion pose_;
};

/// One and the same step, a turn by 1/n about an axis that misses the origin. Its powers are known
/// in closed form: after whole turns and a half they are turntable_step(2). The rounding of the
/// step is the same each time and adds up.
inline ExactMotion turntable_step(int n) {
  using Vector3 = Eigen::Matrix<long double, 3, 1>;
  const Vector3 axis = Vector3(1, 2, 3).normalized(), point(0.5L, -1.0L, 0.25L);
  const long double angle = 2.0L * std::acos(-1.0L) / n;
  return ExactMotion::exp({angle * axis, point.cross(angle * axis)});
}

using Travellers = std::vector<std::unique_ptr<Traveller>>;

/// Every form in float and double with that mending, but for the 3x4 matrix: it errs as the 4x4
/// does, bit for bit.
inline void add_travellers(Mending mending, Travellers& all) {
  all.push_back(std::make_unique<FormTraveller<DualQuaternionForm<double>>>(mending));
  all.push_back(std::make_unique<FormTraveller<QuaternionVectorForm<double>>>(mending));
  all.push_back(std::make_unique<FormTraveller<Matrix4x4Form<double>>>(mending));
  all.push_back(std::make_unique<FormTraveller<DualQuaternionForm<float>>>(mending));
  all.push_back(std::make_unique<FormTraveller<QuaternionVectorForm<float>>>(mending));
  all.push_back(std::make_unique<FormTraveller<Matrix4x4Form<float>>>(mending));
}

}  // namespace limber::test
