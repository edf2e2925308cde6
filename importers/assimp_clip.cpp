#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "importers/assimp_scene.h"
#include "importers/failure.h"
#include "importers/frame_rate.h"

namespace limber {
namespace {

constexpr double kMaxSamples = 1e8;  ///< frames x joints: some 6 GB

/// The two keys around a time and the share of the second.
template <class Key>
struct Between {
  const Key* before;
  const Key* after;
  double share;
};

template <class Key>
Between<Key> between(const Key* keys, unsigned count, double time) {
  const Key* end = keys + count;
  const Key* after =
      std::upper_bound(keys, end, time, [](double t, const Key& key) { return t < key.mTime; });
  if (after == keys) return {keys, keys, 0.0};
  if (after == end) return {end - 1, end - 1, 0.0};
  const Key* before = after - 1;
  return {before, after, (time - before->mTime) / (after->mTime - before->mTime)};
}

Eigen::Vector3d vector_at(const aiVectorKey* keys, unsigned count, double time) {
  const auto k = between(keys, count, time);
  const auto v = [](const aiVectorKey* key) {
    return Eigen::Vector3d(key->mValue.x, key->mValue.y, key->mValue.z);
  };
  return (1.0 - k.share) * v(k.before) + k.share * v(k.after);
}

Eigen::Quaterniond rotation_at(const aiQuatKey* keys, unsigned count, double time) {
  const auto k = between(keys, count, time);
  const auto q = [](const aiQuatKey* key) {
    return Eigen::Quaterniond(key->mValue.w, key->mValue.x, key->mValue.y, key->mValue.z)
        .normalized();
  };
  return q(k.before).slerp(k.share, q(k.after)).normalized();
}

/// T R `inner` S at a time in ticks; what has no keys stays as the node has it.
Eigen::Matrix4d channel_at(const aiNodeAnim& channel, const Eigen::Matrix4d& rest,
                           const Eigen::Matrix3d& inner, double time) {
  Eigen::Matrix4d local = rest;
  Eigen::Matrix3d linear = rest.topLeftCorner<3, 3>();
  Eigen::RowVector3d scale = linear.colwise().norm();
  if (channel.mNumRotationKeys > 0) {
    linear = rotation_at(channel.mRotationKeys, channel.mNumRotationKeys, time).toRotationMatrix() *
             inner;
  } else {
    for (int k = 0; k < 3; ++k) linear.col(k) /= scale[k] > 0.0 ? scale[k] : 1.0;
  }
  if (channel.mNumScalingKeys > 0) {
    scale = vector_at(channel.mScalingKeys, channel.mNumScalingKeys, time).transpose();
  }
  local.topLeftCorner<3, 3>() = linear * scale.asDiagonal();
  if (channel.mNumPositionKeys > 0) {
    local.topRightCorner<3, 1>() = vector_at(channel.mPositionKeys, channel.mNumPositionKeys, time);
  }
  return local;
}

/// All key times of an animation, sorted, in ticks. Errors: `assimp-keys` for times out of order.
std::vector<double> key_ticks(const aiAnimation& animation) {
  std::set<double> ticks;
  const auto add = [&](const auto* keys, unsigned count) {
    for (unsigned k = 0; k < count; ++k) {
      const double time = keys[k].mTime;
      if (!std::isfinite(time) || (k > 0 && time < keys[k - 1].mTime)) {
        fail("assimp-keys",
             fmt::format("animation '{}' has key times out of order", to_text(animation.mName)),
             "export the animation again");
      }
      ticks.insert(time);
    }
  };
  for (unsigned c = 0; c < animation.mNumChannels; ++c) {
    const aiNodeAnim& channel = *animation.mChannels[c];
    add(channel.mPositionKeys, channel.mNumPositionKeys);
    add(channel.mRotationKeys, channel.mNumRotationKeys);
    add(channel.mScalingKeys, channel.mNumScalingKeys);
  }
  return {ticks.begin(), ticks.end()};
}

struct Timing {
  double ticks_per_second = 1.0;
  double rate_hz = 30.0;
  double first_tick = 0.0, ticks_per_frame = 1.0;
  std::int64_t frames = 1;

  /// Frame f's tick: the key that stands there, where float32 key times are slightly off.
  double tick(std::int64_t f, const std::vector<double>& ticks) const {
    const double exact = first_tick + double(f) * ticks_per_frame;
    const auto after = std::lower_bound(ticks.begin(), ticks.end(), exact);
    double nearest = after == ticks.end() ? exact : *after;
    if (after != ticks.begin() && exact - *(after - 1) < std::abs(nearest - exact)) {
      nearest = *(after - 1);
    }
    return std::abs(nearest - exact) < 5e-3 * ticks_per_frame ? nearest : exact;
  }
};

/// The distance of neighbouring keys; 0 where it varies.
double even_spacing(const std::vector<double>& times) {
  if (times.size() < 2) return 0.0;
  const double mean = (times.back() - times.front()) / double(times.size() - 1);
  for (std::size_t i = 1; i < times.size(); ++i) {
    if (std::abs(times[i] - times[i - 1] - mean) > 0.02 * mean) return 0.0;
  }
  return mean;
}

double snapped_rate(double frame_s) {
  return snap_rate_hz(frame_s, fmt::format("{:.6g}", frame_s));
}

/// Where a format states no rate: the lowest whole one with a frame at every key, not below 24 (a
/// multiple, so that keys stay on frames); else that of evenly spaced keys; else 30 or 60.
double rate_of_keys(const std::vector<double>& times) {
  if (times.size() < 2) return 30.0;
  for (int rate = 1; rate <= 240; ++rate) {
    const bool fits = std::all_of(times.begin(), times.end(), [&](double t) {
      const double frame = (t - times.front()) * rate;
      return std::abs(frame - std::round(frame)) < 2e-3 + 1.2e-7 * std::abs(t) * rate;
    });
    const double closest = (times.back() - times.front()) * rate / double(times.size() - 1);
    if (fits && closest > 0.99) return rate < 20 ? rate * std::ceil(24.0 / rate) : rate;
  }
  if (const double spacing = even_spacing(times); spacing > 1e-3) {
    const double rate = snapped_rate(spacing);
    return rate < 20.0 ? rate * std::ceil(24.0 / rate) : rate;
  }
  const double mean = (times.back() - times.front()) / double(times.size() - 1);
  return mean < 1.0 / 45.0 ? 60.0 : 30.0;
}

/// FBX and BVH tick in frames; evenly spaced keys of an FBX may be denser than its frame rate.
Timing timing_of(const aiAnimation& animation, const std::vector<double>& ticks,
                 std::string_view format) {
  Timing timing;
  const double stated = animation.mTicksPerSecond;
  const bool framed = format == "fbx" || format == "bvh";
  if (format == "bvh" && !(stated > 0.0 && std::isfinite(stated))) {
    fail("assimp-keys", "the frame time is not a positive number", "correct the line Frame Time");
  }
  // Where none are stated: Direct3D has 4,800, and assimp's glTF milliseconds.
  const double usual = framed ? 30.0 : format == "x" ? 4800.0 : 1000.0;
  timing.ticks_per_second = stated > 0.0 && std::isfinite(stated) ? stated : usual;
  if (framed) {
    const double spacing = format == "fbx" ? even_spacing(ticks) : 0.0;
    if (spacing > 1e-3 && spacing < 0.9) timing.ticks_per_frame = spacing;
    timing.rate_hz = snapped_rate(timing.ticks_per_frame / timing.ticks_per_second);
  } else {
    std::vector<double> times;
    for (const double tick : ticks) times.push_back(tick / timing.ticks_per_second);
    timing.rate_hz = rate_of_keys(times);
    timing.ticks_per_frame = timing.ticks_per_second / timing.rate_hz;
  }
  if (ticks.empty()) return timing;
  timing.first_tick = ticks.front();
  const double frames = (ticks.back() - ticks.front()) / timing.ticks_per_frame;
  timing.frames = frames < 1e12 ? static_cast<std::int64_t>(frames + 5e-3) + 1 : INT64_MAX;
  return timing;
}

/// The channel of each node, and whether the node's helpers are replaced by it: a channel on the
/// plain name of an FBX node holds the whole local transform, helpers included.
struct Channels {
  std::vector<const aiNodeAnim*> of_node;
  std::vector<std::uint8_t> replaced;
  std::vector<std::uint8_t> stays;  ///< position keys are place-holders: the node's own place holds
};

/// A BVH joint with an offset whose position channels are all zero, give or take rounding, means
/// its offset, not the origin.
bool holds_place(const aiNodeAnim& channel, const Eigen::Matrix4d& local) {
  const double offset = local.topRightCorner<3, 1>().norm();
  for (unsigned k = 0; k < channel.mNumPositionKeys; ++k) {
    if (double(channel.mPositionKeys[k].mValue.Length()) > 1e-2 * offset) return false;
  }
  return offset > 0.0;
}

Channels channels_of(const aiAnimation& animation, const NodeTree& tree, std::string_view format) {
  Channels channels;
  channels.of_node.assign(tree.nodes.size(), nullptr);
  channels.stays.assign(tree.nodes.size(), 0);
  channels.replaced.assign(tree.nodes.size(), 0);
  for (unsigned c = 0; c < animation.mNumChannels; ++c) {
    const std::int32_t node = tree.find(to_text(animation.mChannels[c]->mNodeName));
    if (node < 0) continue;
    channels.of_node[node] = animation.mChannels[c];
    channels.stays[node] = format == "bvh" && tree.parents[node] >= 0 &&
                           holds_place(*animation.mChannels[c], tree.local[node]);
  }
  for (std::int32_t i = 0; i < tree.size(); ++i) {
    const std::int32_t carrier = tree.carrier[i];
    const bool helper = tree.kinds[i] != NodeKind::real;
    channels.replaced[i] = helper && carrier >= 0 && channels.of_node[carrier] != nullptr;
  }
  return channels;
}

bool moves_a_joint(const Channels& channels, const NodeTree& tree, const JointTree& joints) {
  for (std::int32_t i = 0; i < tree.size(); ++i) {
    if (channels.of_node[i] != nullptr && tree.carrier[i] >= 0 &&
        joints.joint_of_node[tree.carrier[i]] >= 0) {
      return true;
    }
  }
  return false;
}

void pose_nodes(const NodeTree& tree, const Channels& channels, double tick,
                std::vector<Eigen::Matrix4d>& local) {
  for (std::int32_t i = 0; i < tree.size(); ++i) {
    if (channels.replaced[i]) {
      local[i].setIdentity();
    } else if (channels.of_node[i] != nullptr && tree.kinds[i] != NodeKind::geometric) {
      local[i] = channel_at(*channels.of_node[i], tree.local[i], tree.post_inverse[i], tick);
      if (channels.stays[i]) local[i].topRightCorner<3, 1>() = tree.local[i].topRightCorner<3, 1>();
      if (tree.kinds[i] == NodeKind::pivot) local[i] = tree.prefix[i] * local[i];
    }
  }
}

/// Largest relative change of any joint's world scale against the first frame.
double scale_change(const JointTree& joints, const std::vector<Eigen::Matrix4d>& world,
                    std::vector<double>& first) {
  double change = 0.0;
  const bool begin = first.empty();
  for (std::int32_t j = 0; j < joints.size(); ++j) {
    const double scale =
        std::cbrt(std::abs(world[joints.node_of_joint[j]].topLeftCorner<3, 3>().determinant()));
    if (begin) first.push_back(scale);
    change = std::max(change, std::abs(scale - first[j]) / std::max(first[j], 1e-12));
  }
  return change;
}

Clip sample_clip(const aiAnimation& animation, const Channels& channels, const NodeTree& tree,
                 const JointTree& joints, const CanonicalSpace& space, std::string_view format,
                 Warnings& warnings) {
  const std::vector<double> ticks = key_ticks(animation);
  const Timing timing = timing_of(animation, ticks, format);
  Clip clip;
  clip.name = to_text(animation.mName);
  clip.rate_hz = timing.rate_hz;
  clip.joints = joints.size();
  if (!(double(timing.frames) * clip.joints <= kMaxSamples) || !std::isfinite(clip.rate_hz)) {
    fail("clip-too-long", fmt::format("animation '{}' has {} frames", clip.name, timing.frames),
         "check the animation's key times");
  }
  clip.start_s = timing.first_tick / timing.ticks_per_second;
  for (const double tick : ticks) clip.key_times_s.push_back(tick / timing.ticks_per_second);
  std::vector<Eigen::Matrix4d> local = tree.local;
  std::vector<double> first_scale;
  double change = 0.0;
  for (std::int64_t f = 0; f < timing.frames; ++f) {
    pose_nodes(tree, channels, timing.tick(f, ticks), local);
    const std::vector<Eigen::Matrix4d> world = tree.world(local);
    change = std::max(change, scale_change(joints, world, first_scale));
    const std::vector<DualQuaternion> pose = fold_pose(joints, world, space);
    clip.parent_from_joint.insert(clip.parent_from_joint.end(), pose.begin(), pose.end());
  }
  make_signs_continuous(clip);
  if (change > 0.01) {
    warnings.push_back(
        {.code = "scale-animated",
         .message = fmt::format("'{}' scales joints by up to {:.0f} %; only where they stand is "
                                "kept, not how large they are",
                                clip.name, 100.0 * change)});
  }
  return clip;
}

}  // namespace

std::vector<Clip> read_assimp_clips(const aiScene& scene, const NodeTree& tree,
                                    const JointTree& joints, const CanonicalSpace& space,
                                    std::string_view format, Warnings& warnings) {
  std::vector<Clip> clips;
  for (unsigned a = 0; a < scene.mNumAnimations; ++a) {
    const aiAnimation& animation = *scene.mAnimations[a];
    const Channels channels = channels_of(animation, tree, format);
    if (!moves_a_joint(channels, tree, joints)) continue;
    clips.push_back(sample_clip(animation, channels, tree, joints, space, format, warnings));
  }
  return clips;
}

}  // namespace limber
