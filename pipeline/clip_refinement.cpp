#include "pipeline/clip_refinement.h"

#include <algorithm>
#include <cmath>

#include "pipeline/measure.h"
#include "pipeline/smooth_cover.h"
#include "validation/contact_detection.h"

namespace limber {
namespace {

using Track = std::vector<Eigen::Vector3d>;

constexpr double kReferenceStature = 1.75;  // m, of the person that contacts are told for
constexpr double kReferenceS = 0.08;        // half window of what counts as how the clip moves

Track track_of(const SourceMotion& source, std::int32_t joint) {
  Track track;
  std::vector<DualQuaternion> model(source.character->skeleton.parents.size());
  for (std::int64_t f = 0; f < source.clip->frames(); ++f) {
    model_from_local(source.character->skeleton, source.clip->frame(f), model);
    track.push_back(model[joint].translation());
  }
  return track;
}

std::int32_t row_of(const Target& target, std::int32_t joint) {
  const auto row = std::ranges::find(target.joint_of_row, joint);
  return static_cast<std::int32_t>(row - target.joint_of_row.begin());
}

/// The points of one kind, ankles or toes, that both figures have, and when the source's stand: by
/// the measure that motion is judged by.
void add_standing(const SourceMotion& source, const Target& target, Role left,
                  std::vector<StandingPoint>& standing) {
  std::vector<Track> tracks;
  std::vector<std::int32_t> rows;
  for (const Side side : {Side::left, Side::right}) {
    const Role role = on_side(left, side);
    if (!source.figure->has(role) || !target.figure.has(role)) continue;
    tracks.push_back(track_of(source, source.figure->at(role)));
    rows.push_back(row_of(target, target.figure.at(role)));
  }
  if (tracks.empty()) return;
  ContactOptions options;
  options.scale = std::max(0.1, source.calibration->height) / kReferenceStature;
  const double floor = floor_level(tracks);
  for (std::size_t k = 0; k < tracks.size(); ++k) {
    auto contacts = detect_contacts(tracks[k], source.clip->rate_hz, floor, options);
    standing.push_back({rows[k], Eigen::Vector3d::Zero(), std::move(contacts)});
  }
}

/// The clip without what is faster than the window: how the refined one is to move, but for what
/// holds it.
Clip calmed(const Clip& clip) {
  Clip out = clip;
  make_signs_continuous(out);
  const std::vector<double> window =
      smooth_window(std::max<std::int64_t>(1, std::lround(kReferenceS * clip.rate_hz)));
  std::vector<Eigen::Vector4d> turn(std::size_t(clip.frames()));
  std::vector<Eigen::Vector3d> place(turn.size());
  for (std::int32_t i = 0; i < clip.joints; ++i) {
    for (std::int64_t f = 0; f < clip.frames(); ++f) {
      turn[f] = out.frame(f)[i].real.coeffs();
      place[f] = out.frame(f)[i].translation();
    }
    turn = smooth_mean<Eigen::Vector4d>(turn, window);
    place = smooth_mean<Eigen::Vector3d>(place, window);
    for (std::int64_t f = 0; f < clip.frames(); ++f) {
      out.frame(f)[i] = DualQuaternion::from_rotation_translation(
          Eigen::Quaterniond(turn[f]).normalized(), place[f]);
    }
  }
  return out;
}

}  // namespace

Clip clip_on_skeleton(const Target& target, const Clip& rig_clip) {
  Clip clip = rig_clip;
  clip.joints = target.character.skeleton.size();
  clip.parent_from_joint.resize(std::size_t(rig_clip.frames()) * std::size_t(clip.joints));
  for (std::int64_t f = 0; f < rig_clip.frames(); ++f) {
    skeleton_local_from_rig(target, rig_clip.frame(f), clip.frame(f));
  }
  make_signs_continuous(clip);
  return clip;
}

Result<ClipRefinement> refine_clip(const SourceMotion& source, const Target& target, const Rig& rig,
                                   const EffectorTrack& track, Clip& clip) {
  const Clip reference = calmed(clip);
  ClipGoals goals{.targets = track.targets,
                  .standing = {},
                  .reference = reference.parent_from_joint,
                  .rate_hz = clip.rate_hz};
  if (source.figure->is_body() && target.figure.is_body()) {
    add_standing(source, target, Role::leftFoot, goals.standing);
    add_standing(source, target, Role::leftToes, goals.standing);
  }
  const auto measured = [&] {
    const Clip on_skeleton = clip_on_skeleton(target, clip);
    const SourceMotion output{&target.character, &target.figure, &target.calibration, &on_skeleton};
    return measure_against({source, track.ground_offset}, {output, track.floor_y}, track.scale);
  };
  ClipRefinement out;
  out.before = measured();
  auto report = refine_clip_with_ceres(rig, goals, clip);
  if (!report) return report.error();
  out.report = *report;
  out.after = out.report.improved ? measured() : out.before;
  return out;
}

}  // namespace limber
