#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <set>
#include <utility>

#include "importers/failure.h"
#include "importers/gltf_document.h"
#include "importers/memory_pages.h"

namespace limber::gltf {

namespace {

/// Joints times frames of one clip; a long clip with two keys must not ask for all memory.
constexpr double kMaxSamples = 2e7;
/// Key times are float32, and exporters round them: a key this near to a frame (in frames) is on
/// it.
constexpr double kOnFrame = 0.02;
/// Clips that were keyed sparsely are sampled at least this densely.
constexpr double kSparse_hz = 10.0;
constexpr double kDense_hz = 24.0;

enum class Interpolation : std::uint8_t { linear, step, cubicspline };
enum class Path : std::uint8_t { translation, rotation, scale };

struct Channel {
  std::int32_t joint = 0;
  Path path = Path::translation;
  Interpolation interpolation = Interpolation::linear;
  const std::vector<double>* times = nullptr;  ///< of the document; channels share them
  const Accessor* values = nullptr;

  /// Key k's value; of a cubic spline also its tangents (part 0 in, 1 value, 2 out).
  Eigen::Vector4d key(std::size_t k, std::size_t part = 1) const {
    const bool cubic = interpolation == Interpolation::cubicspline;
    const auto element = values->element(cubic ? 3 * k + part : k);
    Eigen::Vector4d v = Eigen::Vector4d::Zero();
    for (std::size_t c = 0; c < element.size(); ++c) v[static_cast<Eigen::Index>(c)] = element[c];
    return v;
  }
};

Eigen::Quaterniond as_quaternion(const Eigen::Vector4d& xyzw) {
  const Eigen::Quaterniond q(xyzw[3], xyzw[0], xyzw[1], xyzw[2]);
  return q.norm() > 1e-9 ? q.normalized() : Eigen::Quaterniond::Identity();
}

/// A channel, and the last key that was not after the time asked for; times rise.
struct Cursor {
  const Channel* channel = nullptr;
  std::size_t key = 0;
};

/// The value at time t (glTF 2.0, appendix C). Keys within `snap_s` of t count as being at t, so
/// that a step is taken on its frame although times are rounded.
Eigen::Vector4d evaluate(Cursor& cursor, double t, double snap_s) {
  const Channel& channel = *cursor.channel;
  const std::vector<double>& times = *channel.times;
  std::size_t& k = cursor.key;
  while (k + 1 < times.size() && times[k + 1] <= t + snap_s) ++k;
  if (k + 1 == times.size() || t <= times[k] + snap_s ||
      channel.interpolation == Interpolation::step) {
    return channel.key(k);
  }
  const double span = times[k + 1] - times[k];
  const double u = std::clamp((t - times[k]) / span, 0.0, 1.0);
  if (channel.interpolation == Interpolation::cubicspline) {
    const double u2 = u * u;
    const double u3 = u2 * u;
    return (2 * u3 - 3 * u2 + 1) * channel.key(k) + span * (u3 - 2 * u2 + u) * channel.key(k, 2) +
           (-2 * u3 + 3 * u2) * channel.key(k + 1) + span * (u3 - u2) * channel.key(k + 1, 0);
  }
  if (channel.path == Path::rotation) {
    return as_quaternion(channel.key(k)).slerp(u, as_quaternion(channel.key(k + 1))).coeffs();
  }
  return (1.0 - u) * channel.key(k) + u * channel.key(k + 1);
}

std::optional<Path> path_of(const std::string& name) {
  if (name == "translation") return Path::translation;
  if (name == "rotation") return Path::rotation;
  if (name == "scale") return Path::scale;
  return std::nullopt;
}

Interpolation interpolation_of(const JsonView& sampler) {
  const auto view = sampler.find("interpolation");
  if (!view || view->string() == "LINEAR") return Interpolation::linear;
  if (view->string() == "STEP") return Interpolation::step;
  if (view->string() == "CUBICSPLINE") return Interpolation::cubicspline;
  view->complain(fmt::format("'{}' is no interpolation", view->string()));
}

const std::vector<double>& read_times(Document& document, const JsonView& sampler) {
  const std::int64_t input = document.index_of(sampler, "input", "accessors");
  if (input < 0) sampler.complain("'input' is missing");
  const std::vector<double>& times = document.accessor(input, {"SCALAR"}).values;
  for (std::size_t k = 0; k < times.size(); ++k) {
    if (times[k] < 0.0 || (k > 0 && times[k] <= times[k - 1])) {
      fail("gltf-animation",
           fmt::format("{}: key time {} ({} s) is not after the one before", sampler.pointer(), k,
                       times[k]),
           "key times must rise: export the animation again");
    }
  }
  return times;
}

void read_sampler(Document& document, const JsonView& sampler, Channel& channel,
                  Warnings& warnings) {
  channel.interpolation = interpolation_of(sampler);
  channel.times = &read_times(document, sampler);
  const std::int64_t output = document.index_of(sampler, "output", "accessors");
  if (output < 0) sampler.complain("'output' is missing");
  channel.values = channel.path == Path::rotation ? &document.accessor(output, {"VEC4"})
                                                  : &document.accessor(output, {"VEC3"});
  const bool cubic = channel.interpolation == Interpolation::cubicspline;
  if (channel.values->count != channel.times->size() * (cubic ? 3 : 1)) {
    fail("gltf-animation",
         fmt::format("{}: {} keys but {} values", sampler.pointer(), channel.times->size(),
                     channel.values->count),
         "export the animation again");
  }
  if (cubic && channel.times->size() < 2) {
    warnings.push_back({"gltf-too-few-keys",
                        fmt::format("{}: a cubic spline needs two keys and has {}; its value holds",
                                    sampler.pointer(), channel.times->size())});
  }
  if (channel.values->integers) sampler.complain("integer values must be normalised");
}

/// The node and path of a channel that moves a node; nullopt for morph weights and extensions.
std::optional<std::pair<std::int32_t, Path>> target_of(const Document& document,
                                                       const JsonView& channel) {
  const JsonView target = channel.at("target");
  const std::int64_t node = document.index_of(target, "node", "nodes");
  const std::optional<Path> path = path_of(target.at("path").string());
  if (node < 0 || !path) return std::nullopt;
  return std::pair(static_cast<std::int32_t>(node), *path);
}

std::vector<Channel> read_channels(Document& document, const JsonView& animation,
                                   const Joints& joints, Warnings& warnings) {
  std::vector<Channel> channels;
  std::set<std::pair<std::int32_t, Path>> taken;
  const JsonView samplers = animation.at("samplers");
  const JsonView list = animation.at("channels");
  for (std::size_t c = 0; c < list.array().size(); ++c) {
    const auto target = target_of(document, list[c]);
    const auto sampler = static_cast<std::size_t>(
        list[c].at("sampler").integer(0, static_cast<std::int64_t>(samplers.array().size()) - 1));
    if (!target) continue;
    if (!taken.insert(*target).second) {
      warnings.push_back(
          {"gltf-repeated-target",
           fmt::format("{}: a second channel for one target was ignored", list[c].pointer())});
      continue;
    }
    Channel channel;
    channel.joint = joints.joint_of_node[target->first];
    channel.path = target->second;
    read_sampler(document, samplers[sampler], channel, warnings);
    channels.push_back(std::move(channel));
  }
  return channels;
}

/// Is every key time on a frame at this rate, and no two on one?
bool rate_fits(const std::vector<double>& times, double rate, double tolerance) {
  double before = -1.0;
  for (const double t : times) {
    const double frame = (t - times.front()) * rate;
    const double nearest = std::round(frame);
    // float32 key times are off by up to 6e-8 of their value
    if (std::abs(frame - nearest) > tolerance + 1.2e-7 * t * rate || nearest <= before)
      return false;
    before = nearest;
  }
  return true;
}

constexpr std::array kUsualRates = {24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 90.0, 100.0, 120.0, 240.0};

/// The lowest rate that has a frame at every key: whole ones, NTSC's, then whole ones that rounding
/// (to milliseconds, say) has hidden. 0 where there is none.
double common_rate(const std::vector<double>& times) {
  for (int rate = 1; rate <= 240; ++rate) {
    if (rate_fits(times, rate, 2e-3)) return rate;
  }
  for (const double base : {24000.0, 30000.0, 60000.0, 120000.0}) {
    if (rate_fits(times, base / 1001.0, 2e-3)) return base / 1001.0;
  }
  for (const double rate : kUsualRates) {
    if (rate_fits(times, rate, kOnFrame)) return rate;
  }
  return 0.0;
}

struct Sampling {
  double raw_hz = 0.0;   ///< the file's own
  double rate_hz = 0.0;  ///< what the clip is sampled at
  double snap_s = 0.0;
  std::int64_t frames = 1;
};

/// Where no rate fits, the usual one that is at least as dense as the file's median key spacing and
/// leaves the least of the end over.
double fallback_rate(const std::vector<double>& times) {
  std::vector<double> steps;
  for (std::size_t k = 1; k < times.size(); ++k) steps.push_back(times[k] - times[k - 1]);
  std::nth_element(steps.begin(), steps.begin() + steps.size() / 2, steps.end());
  const double wanted = std::clamp(1.0 / steps[steps.size() / 2], 30.0, 120.0);
  const double duration = times.back() - times.front();
  double best = 120.0;
  double least = 1.0;
  for (const double rate : {30.0, 60.0, 90.0, 120.0}) {
    const double left_over = duration * rate - std::floor(duration * rate + kOnFrame);
    if (rate < 0.9 * wanted || left_over >= least - kOnFrame) continue;
    best = rate;
    least = left_over;
  }
  return best;
}

Sampling choose_sampling(const std::vector<double>& times) {
  Sampling sampling;
  const double duration = times.back() - times.front();
  if (times.size() < 2) {
    sampling.raw_hz = sampling.rate_hz = 30.0;
  } else {
    sampling.raw_hz = sampling.rate_hz = common_rate(times);
    if (sampling.raw_hz == 0.0) {
      sampling.raw_hz = sampling.rate_hz = fallback_rate(times);
    } else {
      sampling.snap_s = 1.5 * kOnFrame / sampling.raw_hz;
      if (sampling.raw_hz < kSparse_hz) {
        sampling.rate_hz *= std::ceil(kDense_hz / sampling.raw_hz);
        sampling.snap_s = 1.5 * kOnFrame / sampling.rate_hz;
      }
    }
  }
  const double frames = std::floor(duration * sampling.rate_hz + 1.5 * kOnFrame) + 1.0;
  sampling.frames = frames < 9e15 ? static_cast<std::int64_t>(frames) : INT64_MAX;
  return sampling;
}

std::vector<double> union_of_times(const std::vector<Channel>& channels) {
  std::set<const std::vector<double>*> seen;
  std::vector<double> times;
  for (const Channel& channel : channels) {
    if (!seen.insert(channel.times).second) continue;
    times.insert(times.end(), channel.times->begin(), channel.times->end());
  }
  std::sort(times.begin(), times.end());
  times.erase(std::unique(times.begin(), times.end(),
                          [](double a, double b) { return b - a <= 1e-6 + 2.4e-7 * b; }),
              times.end());
  return times;
}

const char* interpolation_name(const std::vector<Channel>& channels) {
  constexpr std::array kNames = {"linear", "step", "cubicspline"};
  for (const Channel& channel : channels) {
    if (channel.interpolation != channels.front().interpolation) return "mixed";
  }
  return kNames[static_cast<std::size_t>(channels.front().interpolation)];
}

void warn_of_animated_scale(const Channel& channel, const Joints& joints, const Skeleton& skeleton,
                            const std::string& clip, Warnings& warnings) {
  const Eigen::Vector3d rest = joints.own_scale[channel.joint];
  for (std::size_t k = 0; k < channel.times->size(); ++k) {
    const Eigen::Vector3d scale = channel.key(k).head<3>();
    if ((scale - rest).cwiseAbs().maxCoeff() <= 1e-3 * rest.maxCoeff()) continue;
    warnings.push_back({"scale-animated",
                        fmt::format("clip '{}': the scale moves (to {:.4g}, {:.4g}, {:.4g}) and "
                                    "was left at rest",
                                    clip, scale.x(), scale.y(), scale.z()),
                        skeleton.names[channel.joint]});
    return;
  }
}

/// What moves a joint; without a channel it stays as its node has it.
struct Moved {
  Cursor translation, rotation;
};

/// Frame by frame, as the clip lies in memory.
void sample_frames(const Scene& scene, const Joints& joints, const Skeleton& skeleton,
                   const Sampling& sampling, std::vector<Moved> moved, Clip& clip) {
  for (std::int64_t f = 0; f < sampling.frames; ++f) {
    const double t = clip.start_s + double(f) / sampling.rate_hz;
    const std::span<DualQuaternion> pose = clip.frame(f);
    for (std::int32_t joint = 0; joint < clip.joints; ++joint) {
      const Node& node = scene.nodes[joints.node_of_joint[joint]];
      Moved& by = moved[joint];
      Eigen::Vector3d position = node.translation;
      Eigen::Quaterniond turn = node.rotation;
      if (by.translation.channel != nullptr) {
        position = evaluate(by.translation, t, sampling.snap_s).head<3>();
      }
      if (by.rotation.channel != nullptr) {
        turn = as_quaternion(evaluate(by.rotation, t, sampling.snap_s));
      }
      pose[joint] = joints.local(skeleton, joint, position, turn);
    }
  }
}

Clip sample_clip(const std::vector<Channel>& channels, const Scene& scene, const Joints& joints,
                 const Skeleton& skeleton, RawTiming& timing) {
  Clip clip;
  clip.joints = skeleton.size();
  clip.key_times_s = union_of_times(channels);
  clip.interpolation = interpolation_name(channels);
  clip.start_s = clip.key_times_s.front();
  const Sampling sampling = choose_sampling(clip.key_times_s);
  clip.rate_hz = sampling.rate_hz;
  if (double(sampling.frames) * clip.joints > kMaxSamples) {
    fail("gltf-size",
         fmt::format("an animation of {} s needs {} frames of {} joints",
                     clip.key_times_s.back() - clip.start_s, sampling.frames, clip.joints),
         "cut the animation into pieces");
  }
  timing.rate_hz = sampling.raw_hz;
  timing.frames =
      std::llround(
          std::floor((clip.key_times_s.back() - clip.start_s) * sampling.raw_hz + 1.5 * kOnFrame)) +
      1;
  std::vector<Moved> moved(skeleton.parents.size());
  for (const Channel& channel : channels) {
    if (channel.path == Path::translation) moved[channel.joint].translation.channel = &channel;
    if (channel.path == Path::rotation) moved[channel.joint].rotation.channel = &channel;
  }
  const auto samples = static_cast<std::size_t>(sampling.frames * clip.joints);
  clip.parent_from_joint.reserve(samples);
  prefer_large_pages(clip.parent_from_joint.data(), samples * sizeof(DualQuaternion));
  clip.parent_from_joint.resize(samples);
  sample_frames(scene, joints, skeleton, sampling, std::move(moved), clip);
  make_signs_continuous(clip);
  return clip;
}

}  // namespace

std::vector<std::int32_t> animated_nodes(Document& document) {
  std::vector<std::int32_t> nodes;
  for (std::size_t a = 0; a < document.count("animations"); ++a) {
    const JsonView channels =
        document.item("animations", static_cast<std::int64_t>(a)).at("channels");
    for (std::size_t c = 0; c < channels.array().size(); ++c) {
      if (const auto target = target_of(document, channels[c])) nodes.push_back(target->first);
    }
  }
  return nodes;
}

std::vector<Clip> build_clips(Document& document, const Scene& scene, const Joints& joints,
                              const Skeleton& skeleton, RawTiming& first, Warnings& warnings) {
  std::vector<Clip> clips;
  for (std::size_t a = 0; a < document.count("animations"); ++a) {
    const JsonView animation = document.item("animations", static_cast<std::int64_t>(a));
    const auto name = animation.find("name");
    const std::string clip_name = name ? name->string() : "";
    const std::vector<Channel> channels = read_channels(document, animation, joints, warnings);
    if (channels.empty()) {
      warnings.push_back(
          {"gltf-clip-without-motion",
           fmt::format("animation {} ('{}') moves no joint; left out", a, clip_name)});
      continue;
    }
    for (const Channel& channel : channels) {
      if (channel.path == Path::scale) {
        warn_of_animated_scale(channel, joints, skeleton, clip_name, warnings);
      }
    }
    RawTiming timing;
    Clip clip = sample_clip(channels, scene, joints, skeleton, timing);
    clip.name = clip_name;
    if (clips.empty()) first = timing;
    clips.push_back(std::move(clip));
  }
  return clips;
}

}  // namespace limber::gltf
