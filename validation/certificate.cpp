#include "validation/certificate.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace limber {
namespace {

constexpr double kDegrees = 180.0 / M_PI;
constexpr double kShortBone = 1e-4;  // m: relative lengths mean nothing below

struct JointPair {
  std::int32_t a = kNoJoint, b = kNoJoint;
  std::int32_t ancestor = kNoJoint;  // row in the list of pairs
};

std::vector<JointPair> pair_joints(const Skeleton& a, const Skeleton& b,
                                   std::vector<std::string>& missing) {
  std::vector<JointPair> pairs;
  std::vector<std::int32_t> pair_of(a.parents.size(), kNoJoint);
  for (std::int32_t i = 0; i < a.size(); ++i) {
    const std::int32_t above = a.parents[i] == kNoJoint ? kNoJoint : pair_of[a.parents[i]];
    const std::int32_t other = b.find(a.names[i]);
    if (other == kNoJoint) {
      missing.push_back(a.names[i]);
      pair_of[i] = above;
      continue;
    }
    pair_of[i] = static_cast<std::int32_t>(pairs.size());
    pairs.push_back({i, other, above});
  }
  return pairs;
}

void keep_larger(CertificateReport::Worst& worst, double value, const std::string& joint,
                 std::int64_t frame) {
  if (std::isnan(worst.value)) return;  // nothing is worse
  if (!(value <= worst.value)) worst = {value, joint, frame};
}

struct Spaces {
  std::vector<DualQuaternion> a, b;                // model_from_joint of this frame
  std::vector<Eigen::Quaterniond> b_from_a_joint;  // [pair] constant turn of the joint's space
};

void compare_frame(const Skeleton& a, const std::vector<JointPair>& pairs, const Spaces& spaces,
                   std::int64_t frame, CertificateReport& report) {
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    const JointPair& pair = pairs[k];
    const DualQuaternion &in_a = spaces.a[pair.a], &in_b = spaces.b[pair.b];
    const std::string& name = a.names[pair.a];
    keep_larger(report.position_m, (in_a.translation() - in_b.translation()).norm(), name, frame);
    const Eigen::Quaterniond b_rotation = in_b.rotation() * spaces.b_from_a_joint[k];
    keep_larger(report.rotation_rad, rotation_angle(in_a.rotation(), b_rotation), name, frame);
    if (pair.ancestor == kNoJoint) continue;
    const JointPair& above = pairs[pair.ancestor];
    const double length_a = (in_a.translation() - spaces.a[above.a].translation()).norm();
    const double length_b = (in_b.translation() - spaces.b[above.b].translation()).norm();
    if (length_a > kShortBone) {
      keep_larger(report.bone_relative, std::abs(length_b / length_a - 1.0), name, frame);
    }
  }
}

void judge(const CertificateOptions& options, CertificateReport& r) {
  if (!r.missing_joints.empty()) {
    r.faults.push_back(fmt::format("{} joints are missing, first '{}'", r.missing_joints.size(),
                                   r.missing_joints.front()));
  }
  if (r.frames_a != r.frames_b) {
    r.faults.push_back(fmt::format("{} frames became {}", r.frames_a, r.frames_b));
  }
  if (!(std::abs(r.rate_b_hz - r.rate_a_hz) <= options.rate_relative * r.rate_a_hz) &&
      std::min(r.frames_a, r.frames_b) > 1) {
    r.faults.push_back(fmt::format("{:.6g} Hz became {:.6g} Hz", r.rate_a_hz, r.rate_b_hz));
  }
  if (!(r.position_m.value <= options.position_m)) {
    r.faults.push_back(fmt::format("joint '{}' is {:.4g} mm off in frame {}", r.position_m.joint,
                                   1e3 * r.position_m.value, r.position_m.frame));
  }
  if (!(r.rotation_rad.value <= options.rotation_rad)) {
    r.faults.push_back(fmt::format("joint '{}' is turned by {:.4g} degrees in frame {}",
                                   r.rotation_rad.joint, kDegrees * r.rotation_rad.value,
                                   r.rotation_rad.frame));
  }
  if (!(r.bone_relative.value <= options.bone_relative)) {
    r.faults.push_back(fmt::format("the bone to joint '{}' changed by {:.4g} % in frame {}",
                                   r.bone_relative.joint, 100.0 * r.bone_relative.value,
                                   r.bone_relative.frame));
  }
  r.ok = r.faults.empty();
}

}  // namespace

Result<CertificateReport> compare_clips(const Skeleton& a, const Clip& a_clip, const Skeleton& b,
                                        const Clip& b_clip, const CertificateOptions& options) {
  CertificateReport report;
  const std::vector<JointPair> pairs = pair_joints(a, b, report.missing_joints);
  if (pairs.empty()) {
    return Error{
        .code = "certificate-no-joints",
        .message = "the file that was read back shares no joint name with what was written",
        .hint = "the reader renames joints; compare with another reader"};
  }
  report.joints = static_cast<std::int32_t>(pairs.size());
  report.frames_a = a_clip.frames();
  report.frames_b = b_clip.frames();
  report.rate_a_hz = a_clip.rate_hz;
  report.rate_b_hz = b_clip.rate_hz;
  Spaces spaces;
  spaces.a.resize(a.parents.size());
  spaces.b.resize(b.parents.size());
  spaces.b_from_a_joint.assign(pairs.size(), Eigen::Quaterniond::Identity());
  for (std::int64_t f = 0; f < std::min(report.frames_a, report.frames_b); ++f) {
    model_from_local(a, a_clip.frame(f), spaces.a);
    model_from_local(b, b_clip.frame(f), spaces.b);
    if (f == 0 && options.ignore_joint_spaces) {
      for (std::size_t k = 0; k < pairs.size(); ++k) {
        spaces.b_from_a_joint[k] =
            spaces.b[pairs[k].b].rotation().conjugate() * spaces.a[pairs[k].a].rotation();
      }
    }
    compare_frame(a, pairs, spaces, f, report);
  }
  judge(options, report);
  return report;
}

}  // namespace limber
