// limber_make_clips DIR: writes the clips of assets/data/clips.

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <string>

#include "assets/generate/bvh_clip.h"
#include "assets/generate/hand_gestures.h"
#include "assets/generate/range_of_motion.h"

namespace {

bool write(const std::filesystem::path& path, const std::string& text) {
  std::ofstream out(path, std::ios::binary);
  out << text;
  out.close();
  if (!out) {
    std::fprintf(stderr, "cannot write %s\n", path.c_str());
    return false;
  }
  std::printf("%s: %zu bytes\n", path.c_str(), text.size());
  return true;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: limber_make_clips DIR\n");
    return 2;
  }
  using namespace limber::generate;
  const std::filesystem::path folder = argv[1];
  const bool ok = write(folder / "gestures_right_hand.bvh", bvh_text(hand_gestures())) &&
                  write(folder / "body_range_of_motion.bvh", bvh_text(range_of_motion()));
  return ok ? 0 : 1;
}
