// Cycles solved as one.
#include "solver/ik_cycle.h"

#include <gtest/gtest.h>

namespace limber {
namespace {}  // namespace
}  // namespace limber
