#pragma once

#include <map>
#include <string>
#include <utility>
#include <vector>

#include "pipeline/humanoid.h"

namespace limber {

/// How one family of files names the joints of a figure (assets/data/conventions).
struct Convention {
  std::string name;
  std::vector<std::pair<Role, std::string>> names;
  /// One list for both hands: the right hand's roles stand for either; geometry tells which.
  bool either_hand = false;
};

/// Every shipped convention, in the data's order.
const std::vector<Convention>& conventions();

}  // namespace limber
