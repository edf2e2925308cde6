// The JSON Schema of gates and our parser judge alike, as far as a schema can know: that what fails
// is worse than what warns, only the parser sees.

#include <gtest/gtest.h>

#include <functional>

#include "importers/gates_json.h"
#include "tests/data/schema_agreement.h"

namespace limber::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

std::vector<DocumentCase> cases() {
  std::vector<DocumentCase> out;
  for (const auto& entry : fs::directory_iterator(kData / "gates")) {
    out.push_back({entry.path().filename().string(), read_json(entry.path())});
  }
  const json start = {{"format", "limber/gates/1"},
                      {"gates", {{{"figure", "smoothness/pops"}, {"warn", 0}, {"fail", 20}}}}};
  const auto vary = [&](const std::string& name, const std::function<void(json&)>& change) {
    test::vary(out, start, name, change);
  };
  const auto gate = [](json& d) -> json& { return d["gates"][0]; };
  vary("as it is", [](json&) {});
  vary("no format", [](json& d) { d.erase("format"); });
  vary("other format", [](json& d) { d["format"] = "limber/gates/2"; });
  vary("unknown key", [](json& d) { d["colour"] = "red"; });
  vary("no gates", [](json& d) { d["gates"] = json::array(); });
  vary("gates of a word", [](json& d) { d["gates"] = "all"; });
  vary("too many gates", [](json& d) { d["gates"] = json(257, d["gates"][0]); });
  vary("no figure", [&](json& d) { gate(d).erase("figure"); });
  vary("empty figure", [&](json& d) { gate(d)["figure"] = ""; });
  vary("figure from the root", [&](json& d) { gate(d)["figure"] = "/smoothness/pops"; });
  vary("figure with a hole", [&](json& d) { gate(d)["figure"] = "smoothness//pops"; });
  vary("figure without an end", [&](json& d) { gate(d)["figure"] = "smoothness/"; });
  vary("long figure", [&](json& d) { gate(d)["figure"] = std::string(257, 'a'); });
  vary("no level", [&](json& d) { gate(d).erase("warn"), gate(d).erase("fail"); });
  vary("warn alone", [&](json& d) { gate(d).erase("fail"); });
  vary("fail alone", [&](json& d) { gate(d).erase("warn"); });
  vary("level of a word", [&](json& d) { gate(d)["warn"] = "0"; });
  vary("unknown gate key", [&](json& d) { gate(d)["colour"] = "red"; });
  vary("at_least of a number", [&](json& d) { gate(d)["at_least"] = 1; });
  vary("at_least", [&](json& d) { gate(d)["at_least"] = true, gate(d)["fail"] = -1; });
  return out;
}

TEST(GatesSchema, AndParserAgree) {
  const char* modules = std::getenv("LIMBER_NODE_MODULES");
  if (!modules) GTEST_SKIP() << "npm packages not installed (LIMBER_NODE_MODULES)";
  expect_schema_and_parser_agree(
      kData / "schemas/gates.schema.json", cases(),
      [](const DocumentCase& c) { return read_gates_json(c.document.dump()); }, 14);
}

TEST(Gates, WhatFailsIsWorseThanWhatWarns) {
  const auto gates = [](bool at_least, double warn, double fail) {
    return read_gates_json(json{
        {"format", "limber/gates/1"},
        {"gates", {{{"figure", "a/b"}, {"warn", warn}, {"fail", fail}, {"at_least", at_least}}}}}
                               .dump());
  };
  EXPECT_TRUE(gates(false, 1, 2).ok());
  EXPECT_FALSE(gates(false, 2, 1).ok());
  EXPECT_TRUE(gates(true, 2, 1).ok());
  EXPECT_FALSE(gates(true, 1, 2).ok());
  EXPECT_EQ(gates(true, 1, 2).error().code, "gates-json");
}

}  // namespace
}  // namespace limber::test
