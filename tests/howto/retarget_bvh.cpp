// retarget_bvh FILE: a motion onto a shipped rig. The clip comes back on the rig's joints, within
// its limits, and can be exported as in check_and_write.cpp.

#include <cstdio>

#include "importers/importer.h"
#include "pipeline/retarget.h"

namespace {

limber::Result<limber::Retargeted> retarget(const char* file, const char* rig) {
  using namespace limber;
  auto source = import_file(file);
  if (!source) return source.error();
  auto figure = identify_figure(source->character);
  if (!figure) return figure.error();
  const Clip& clip = source->clips.front();
  auto t_pose = calibrate(source->character, *figure, {}, source->reference_pose, &clip);
  if (!t_pose) return t_pose.error();
  auto target = load_target(rig, {});
  if (!target) return target.error();
  return retarget_clip({&source->character, &*figure, &*t_pose, &clip}, *target, {});
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return std::fprintf(stderr, "usage: retarget_bvh FILE\n"), 2;
  const auto result = retarget(argv[1], "hand");
  if (!result) return std::fprintf(stderr, "%s\n", result.error().message.c_str()), 1;
  const limber::LimitReport limits = limber::check_joint_limits(result->rig, result->rig_clip);
  std::printf("%d frames, %d violations, %.6f degrees beyond the limits\n",
              static_cast<int>(result->clip.frames()), static_cast<int>(limits.violations),
              limits.max_violation_deg);
}
