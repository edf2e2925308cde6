#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "tests/data/data_files.h"

namespace limber::test {

/// A document and what it shows.
struct DocumentCase {
  std::string name;
  nlohmann::json document;
};

/// Adds `start` with a change.
inline void vary(std::vector<DocumentCase>& cases, nlohmann::json start, const std::string& name,
                 const std::function<void(nlohmann::json&)>& change) {
  change(start);
  cases.push_back({name, std::move(start)});
}

/// A JSON Schema, read by ajv (npm), and our parser judge every case alike; what we ship
/// (named *.json) is accepted, and at least `refused_at_least` others are not. `Case` has `name`
/// and `document`; `parse` gives a Result.
template <class Case, class Parse>
void expect_schema_and_parser_agree(const std::filesystem::path& schema_path,
                                    const std::vector<Case>& all, const Parse& parse,
                                    int refused_at_least) {
  const auto folder = std::filesystem::temp_directory_path() /
                      (schema_path.stem().string() + "-" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  nlohmann::json documents = nlohmann::json::array();
  for (const Case& c : all) documents.push_back(c.document);
  std::ofstream(folder / "documents.json") << documents;
  const std::string command = "node '" + (kSource / "tests/data/schema_verdicts.mjs").string() +
                              "' '" + schema_path.string() + "' '" +
                              (folder / "documents.json").string() + "' '" +
                              (folder / "verdicts.json").string() + "'";
  ASSERT_EQ(std::system(command.c_str()), 0);
  const nlohmann::json verdicts = read_json(folder / "verdicts.json");
  ASSERT_EQ(verdicts.size(), all.size());
  int refused = 0;
  for (std::size_t i = 0; i < all.size(); ++i) {
    const bool schema = verdicts[i]["valid"];
    const auto parsed = parse(all[i]);
    EXPECT_EQ(parsed.ok(), schema) << all[i].name << "\n  schema: " << verdicts[i]["errors"]
                                   << "\n  parser: " << (parsed.ok() ? "" : parsed.error().message);
    EXPECT_TRUE(schema || !all[i].name.ends_with(".json")) << all[i].name;
    refused += !schema;
  }
  EXPECT_GE(refused, refused_at_least);
  std::filesystem::remove_all(folder);
}

}  // namespace limber::test
