#include "assets/model/clip.h"

#include <algorithm>
#include <cmath>

namespace limber {

Result<void> validate(const Skeleton& skeleton, const Clip& clip) {
  constexpr double kSurelyFinite = 1e300;
  const auto invalid = [&](std::string message, std::int32_t joint = -1, std::int64_t frame = -1) {
    return Error{.code = "clip-invalid",
                 .message = std::move(message),
                 .joint = joint >= 0 ? skeleton.names[joint] : std::string(),
                 .frame = frame,
                 .hint = "re-export the clip, or cut the broken frames with --range"};
  };
  if (clip.joints != skeleton.size()) return invalid("the clip is not this skeleton's");
  if (!std::isfinite(clip.rate_hz) || clip.rate_hz <= 0.0)
    return invalid("the rate is not positive");
  if (clip.frames() < 1 || clip.parent_from_joint.size() % std::size_t(clip.joints) != 0) {
    return invalid("the clip has no whole frame");
  }
  for (std::int64_t f = 0; f < clip.frames(); ++f) {
    for (std::int32_t j = 0; j < clip.joints; ++j) {
      const DualQuaternion& q = clip.frame(f)[j];
      const double off_unit = std::abs(q.real.squaredNorm() - 1.0);
      if (off_unit <= 1e-9 && q.dual.squaredNorm() < kSurelyFinite) continue;  // nearly all
      if (!q.real.coeffs().allFinite() || !q.dual.coeffs().allFinite()) {
        return invalid("the motion is not finite", j, f);
      }
      if (off_unit > 1e-9) {
        return invalid("a rotation is not unit", j, f);
      }
    }
  }
  return {};
}

void make_signs_continuous(Clip& clip) {
  for (std::int64_t f = 1; f < clip.frames(); ++f) {
    const auto before = clip.frame(f - 1);
    auto now = clip.frame(f);
    for (std::int32_t j = 0; j < clip.joints; ++j) {
      if (before[j].real.coeffs().dot(now[j].real.coeffs()) < 0.0) now[j] = -now[j];
    }
  }
}

Clip resample(const Clip& clip, double rate_hz) {
  Clip out = clip;
  out.rate_hz = rate_hz;
  const auto frames = static_cast<std::int64_t>(std::floor(clip.duration_s() * rate_hz + 1e-6)) + 1;
  out.parent_from_joint.resize(static_cast<std::size_t>(frames) * clip.joints);
  for (std::int64_t f = 0; f < frames; ++f) {
    const double position = std::min(double(f) * clip.rate_hz / rate_hz, double(clip.frames() - 1));
    const auto before = std::min(static_cast<std::int64_t>(position + 1e-9), clip.frames() - 1);
    const auto after = std::min(before + 1, clip.frames() - 1);
    const double t = std::clamp(position - double(before), 0.0, 1.0);
    for (std::int32_t j = 0; j < clip.joints; ++j) {
      out.frame(f)[j] =
          t < 1e-9 ? clip.frame(before)[j] : sclerp(clip.frame(before)[j], clip.frame(after)[j], t);
    }
  }
  return out;
}

}  // namespace limber
