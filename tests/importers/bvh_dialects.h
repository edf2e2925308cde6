#pragma once

#include <string>
#include <vector>

#include "tests/importers/bvh_writer.h"

/// The ways in which tools write one motion.
namespace limber::test {

struct NamedDialect {
  std::string name;
  Dialect dialect;
};

inline std::vector<NamedDialect> dialects() {
  std::vector<NamedDialect> all;
  const auto add = [&](const std::string& name, auto&& change) {
    Dialect dialect;
    change(dialect);
    all.push_back({name, dialect});
  };
  for (const char* order : {"XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"}) {
    add(order, [&](Dialect& d) { d.order = order; });
  }
  add("mixed_orders", [](Dialect& d) { d.mixed_orders = true; });
  add("six_channels", [](Dialect& d) { d.six_channels = true; });
  add("zero_filled", [](Dialect& d) { d.zero_filled = true; });
  add("rotation_first", [](Dialect& d) { d.rotation_first = true; });
  add("z_up", [](Dialect& d) { d.z_up = true; });
  add("z_up_motion_on_y_up_offsets", [](Dialect& d) { d.z_up = d.y_up_offsets = true; });
  add("metres", [](Dialect& d) { d.unit_m = 1.0; });
  add("millimetres", [](Dialect& d) { d.unit_m = 0.001; });
  add("decimetres", [](Dialect& d) { d.unit_m = 0.1; });
  add("inches", [](Dialect& d) { d.unit_m = 0.0254; });
  add("cmu", [](Dialect& d) { d.unit_m = 0.0254 / 0.45; });
  add("cr", [](Dialect& d) { d.eol = "\r"; });
  add("crlf", [](Dialect& d) { d.eol = "\r\n"; });
  add("bom", [](Dialect& d) { d.bom = true; });
  add("tabs", [](Dialect& d) { d.tabs = true; });
  add("lower_case", [](Dialect& d) { d.lower_case = true; });
  add("brace_on_line", [](Dialect& d) { d.brace_on_line = true; });
  add("no_end_sites", [](Dialect& d) { d.end_sites = false; });
  add("exponents", [](Dialect& d) { d.exponents = true; });
  add("shift_jis", [](Dialect& d) {  // some second bytes look like ASCII
    d.name_prefix = "\x83\x5A\x83\x93\x83\x5E\x81\x5B_";
    d.name_prefix_utf8 = "センター_";
  });
  add("everything", [](Dialect& d) {
    d.mixed_orders = d.six_channels = d.rotation_first = d.z_up = d.tabs = d.bom = d.lower_case =
        d.brace_on_line = d.exponents = true;
    d.eol = "\r";
    d.unit_m = 0.0254;
  });
  return all;
}

}  // namespace limber::test
