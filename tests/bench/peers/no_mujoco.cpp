#include "tests/bench/peers/kinematics.h"

namespace limber::peers {

std::unique_ptr<Kinematics> mujoco_kinematics(const Coordinates&) { return nullptr; }

bool has_mujoco() { return false; }

}  // namespace limber::peers
