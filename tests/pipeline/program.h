#pragma once

#include <sys/wait.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

namespace limber_test {

namespace fs = std::filesystem;

/// A folder of its own that goes when the test ends.
class Folder {
 public:
  Folder() {
    std::string name = (fs::temp_directory_path() / "limber-test-XXXXXX").string();
    path_ = ::mkdtemp(name.data());
  }
  ~Folder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  fs::path operator/(const std::string& name) const { return path_ / name; }
  std::string string() const { return path_.string(); }

 private:
  fs::path path_;
};

struct Run {
  int exit_code = -1;
  std::string out;
};

/// Runs the program as a user would; standard error goes to the test's log.
inline Run limber(const std::vector<std::string>& arguments) {
  std::string command = LIMBER_PROGRAM;
  for (const std::string& a : arguments) command += " '" + a + "'";
  Run run;
  FILE* pipe = ::popen(command.c_str(), "r");
  if (pipe == nullptr) return run;
  std::array<char, 4096> buffer;
  std::size_t n = 0;
  while ((n = std::fread(buffer.data(), 1, buffer.size(), pipe)) > 0) {
    run.out.append(buffer.data(), n);
  }
  const int status = ::pclose(pipe);
  run.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  return run;
}

inline std::string text_of(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

inline void write_text(const fs::path& path, const std::string& text) {
  std::ofstream(path, std::ios::binary) << text;
}

inline fs::path source_root() { return LIMBER_SOURCE_DIR; }

/// Real clips of Debian's assimp-testmodels; empty where the package is not there.
inline fs::path cmu_clip(const std::string& name) {
  const fs::path path = fs::path("/usr/share/assimp/models/BVH") / name;
  return fs::exists(path) ? path : fs::path();
}

/// More clips and characters, where they are at hand: LIMBER_SHARED, or ../shared.
inline fs::path shared(const std::string& name) {
  const char* set = std::getenv("LIMBER_SHARED");
  const fs::path root = set != nullptr ? fs::path(set) : source_root() / ".." / "shared";
  const fs::path path = root / "data" / name;
  return fs::exists(path) ? path : fs::path();
}

inline fs::path own_clip(const std::string& name) {
  return source_root() / "assets" / "data" / "clips" / name;
}

}  // namespace limber_test
