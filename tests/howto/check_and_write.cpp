// check_and_write FILE.glb: a clip that bends an elbow the wrong way is checked against its rig,
// mended, written, read back and checked again.

#include <cmath>
#include <cstdio>
#include <fstream>

#include "assets/model/mannequin.h"
#include "exporters/exporter.h"
#include "importers/importer.h"
#include "pipeline/target.h"
#include "solver/swing_twist.h"
#include "validation/limit_check.h"

namespace {

/// Every hinge of the rig swings to and fro by a radian, whatever its range.
limber::Clip swinging(const limber::Rig& rig) {
  using namespace limber;
  Clip clip;
  clip.name = "swing";
  clip.joints = rig.size();
  Pose pose(rig.joints.size());
  std::vector<double> q(dof_count(rig), 0.0);
  const auto begin = dof_begin(rig);
  for (int frame = 0; frame < 60; ++frame) {
    for (int j = 0; j < rig.size(); ++j) {
      if (rig.joints[j].type == JointType::hinge) q[begin[j]] = std::sin(M_PI * frame / 15.0);
    }
    pose_from_coordinates(rig, q, pose);
    clip.parent_from_joint.insert(clip.parent_from_joint.end(), pose.begin(), pose.end());
  }
  return clip;
}

}  // namespace

int main(int argc, char** argv) {
  using namespace limber;
  if (argc != 2) return std::fprintf(stderr, "usage: check_and_write FILE.glb\n"), 2;
  const Rig rig = *shipped_rig("biped-full");
  Clip clip = swinging(rig);
  const LimitReport before = check_joint_limits(rig, clip);
  for (int f = 0; f < clip.frames(); ++f) project_into_limits(rig, clip.frame(f));

  const auto glb = export_glb(mannequin(rig), clip);
  if (!glb) return std::fprintf(stderr, "%s\n", glb.error().message.c_str()), 1;
  std::ofstream(argv[1], std::ios::binary)
      .write(reinterpret_cast<const char*>(glb->data()), std::streamsize(glb->size()));

  const auto again = import_file(argv[1]);  // our mannequin keeps the rig's joints, in order
  if (!again) return std::fprintf(stderr, "%s\n", again.error().message.c_str()), 1;
  const LimitReport after = check_joint_limits(rig, again->clips.front());
  std::printf("%d violations mended; in the file %d of %d frames, %d violations\n",
              static_cast<int>(before.violations), static_cast<int>(again->clips.front().frames()),
              static_cast<int>(clip.frames()), static_cast<int>(after.violations));
}
