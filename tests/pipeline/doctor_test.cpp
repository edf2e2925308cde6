// What `limber doctor` finds lacking, and the codes that `limber explain` knows.
#include "pipeline/doctor.h"

#include <dlfcn.h>
#include <gtest/gtest.h>

#include <cctype>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "pipeline/codes.h"
#include "tests/pipeline/program.h"

namespace {

using namespace limber;
using nlohmann::json;

Surroundings healthy() {
  Surroundings here;
  here.landlock_abi = 1;
  here.seccomp = true;
  here.disk_free_bytes = std::uint64_t(100) << 30;
  here.folder_writable = true;
  here.memory_bytes = std::uint64_t(16) << 30;
  here.cores = 8;
  return here;
}

TEST(Doctor, EveryLackIsToldAloneWithWhatMendsIt) {
  EXPECT_TRUE(lacks_of(healthy()).empty());
  using Spoil = std::function<void(Surroundings&)>;
  const std::vector<std::tuple<Spoil, std::string, bool>> cases = {
      {[](Surroundings& s) { s.landlock_abi = 0; }, "lsm=landlock", false},
      {[](Surroundings& s) { s.seccomp = false; }, "CONFIG_SECCOMP_FILTER", false},
      {[](Surroundings& s) { s.folder_writable = false; }, "-o", true},
      {[](Surroundings& s) { s.disk_free_bytes = 1 << 20; }, "--resume", false},
      {[](Surroundings& s) { s.memory_bytes = std::uint64_t(1) << 30; }, "-j 2", false},
      {[](Surroundings& s) { s.open_files = 32; }, "ulimit -n", true},
      {[](Surroundings& s) { s.processes = 8; }, "ulimit -u", true},
      {[](Surroundings& s) { s.file_bytes = 1 << 20; }, "ulimit -f", false},
      {[](Surroundings& s) { s.address_bytes = 1 << 30; }, "ulimit -v", false},
      {[](Surroundings& s) { s.cpu_seconds = 60; }, "ulimit -t", true}};
  for (const auto& [spoil, mend, stops] : cases) {
    Surroundings here = healthy();
    spoil(here);
    const auto lacks = lacks_of(here);
    ASSERT_EQ(lacks.size(), 1U) << mend;
    EXPECT_NE(lacks[0].mend.find(mend), std::string::npos) << lacks[0].mend;
    EXPECT_EQ(lacks[0].stops, stops) << mend;
    EXPECT_FALSE(lacks[0].what.empty());
  }
}

TEST(Doctor, LibrariesHaveTheVersionsTheySayThemselves) {
  std::map<std::string, std::string> versions;
  for (const auto& [name, version] : library_versions()) versions[name] = version;
  for (const char* name : {"assimp", "ceres", "eigen", "opencv_core", "png16", "seccomp", "z"}) {
    EXPECT_TRUE(std::isdigit(static_cast<unsigned char>(versions[name][0]))) << name;
  }
  using Version = const char* (*)();
  const auto zlib = reinterpret_cast<Version>(::dlsym(RTLD_DEFAULT, "zlibVersion"));
  ASSERT_NE(zlib, nullptr);
  EXPECT_EQ(versions["z"], zlib());
}

TEST(Doctor, TellsAllOfItAndEndsWithThreeWhereClipsWouldFail) {
  const limber_test::Folder folder;
  const auto doctor = [&](const std::string& limits) {
    const std::string command = "cd '" + folder.string() + "' && " + limits + " '" +
                                LIMBER_PROGRAM "' doctor --json > facts.json";
    const int code = std::system(command.c_str());
    const json facts = json::parse(limber_test::text_of(folder / "facts.json"));
    return std::pair(WEXITSTATUS(code), facts);
  };
  const auto [well, facts] = doctor("");
  EXPECT_EQ(well, 0) << facts["lacks"];
  for (const char* key : {"version", "libraries", "simd", "sandbox", "disk_free_bytes", "cores",
                          "limits", "readable", "rigs", "lacks"}) {
    EXPECT_TRUE(facts.contains(key)) << key;
  }
  const auto [ill, few] = doctor("ulimit -n 32 &&");
  EXPECT_EQ(ill, 3);
  EXPECT_EQ(few["limits"]["open_files"], 32);
  EXPECT_NE(few["lacks"].dump().find("ulimit -n"), std::string::npos);
}

TEST(Explain, ListsEveryCodeAndKnowsEachOfThem) {
  const auto list = limber_test::limber({"explain"});
  EXPECT_EQ(list.exit_code, 0);
  std::istringstream lines(list.out);
  std::size_t listed = 0;
  for (std::string line; std::getline(lines, line); ++listed) {
    ASSERT_LT(listed, all_codes().size());
    EXPECT_TRUE(line.starts_with(all_codes()[listed].code)) << line;
  }
  EXPECT_EQ(listed, all_codes().size());
  for (const CodeInfo& info : all_codes()) EXPECT_EQ(find_code(info.code), &info) << info.code;
  EXPECT_EQ(limber_test::limber({"explain", "bvh-syntax"}).exit_code, 0);
  EXPECT_EQ(limber_test::limber({"explain", "no-such-code"}).exit_code, 2);
}

}  // namespace
