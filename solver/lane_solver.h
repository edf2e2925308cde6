#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "solver/ik_solver.h"

namespace limber {

/// Eight clips, or eight runs of one, solved frame by frame in lock-step: each SIMD lane is a clip.
/// Floats inside; poses in doubles, within limits to 1e-5 degrees. A lane that a frame is too hard
/// for is solved by an IkSolver. A lane's answers depend on its own start and targets alone, bit
/// for bit, whatever the other lanes do and whatever the SIMD level. follow() allocates nothing.
///
/// World positions are floats: a metre away from the origin is good to a tenth of a micrometre, a
/// kilometre to a tenth of a millimetre.
///
/// For rigs whose effectors are poses and positions on joints that move; others are refused with
/// `solver-lanes`.
class LaneSolver {
 public:
  static constexpr int lanes = 8;

  static Result<LaneSolver> create(const Rig&, const IkOptions& = {});
  LaneSolver(LaneSolver&&) noexcept;
  LaneSolver& operator=(LaneSolver&&) noexcept;
  ~LaneSolver();

  /// The SIMD level in use, and those this machine can run, the fastest first.
  const char* level() const;
  static std::vector<std::string> levels();
  void use_level(const std::string&);

  /// The pose that a lane's next frame starts from, moved into limits; the rest pose if never
  /// called.
  void start(int lane, std::span<const DualQuaternion> parent_from_joint);
  /// The next frame of every lane; `targets`: [lane * effectors]. Returns how many lanes needed a
  /// solver of their own.
  int follow(std::span<const EffectorTarget> targets);
  /// A lane's answer.
  void pose(int lane, std::span<DualQuaternion> parent_from_joint) const;
  IkReport report(int lane) const;

 private:
  struct State;
  explicit LaneSolver(std::unique_ptr<State>);
  std::unique_ptr<State> state_;
};

}  // namespace limber
