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

/// T R S at a time in ticks; what has no keys stays as the node has it.
Eigen::Matrix4d channel_at(const aiNodeAnim& channel, const Eigen::Matrix4d& rest, double time) {
  Eigen::Matrix4d local = rest;
  Eigen::Matrix3d linear = rest.topLeftCorner<3, 3>();
  Eigen::RowVector3d scale = linear.colwise().norm();
  if (channel.mNumRotationKeys > 0) {
    linear = rotation_at(channel.mRotationKeys, channel.mNumRotationKeys, time).toRotationMatrix();
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

/// The usual distance of neighbouring keys in ticks; 0 where there are fewer than two, or where
/// `only_even` is set and they are not evenly spaced.
double usual_spacing(const std::vector<double>& ticks, bool only_even) {
  std::vector<double> gaps;
  for (std::size_t i = 1; i < ticks.size(); ++i) gaps.push_back(ticks[i] - ticks[i - 1]);
  if (gaps.empty()) return 0.0;
  std::sort(gaps.begin(), gaps.end());
  const double median = gaps[gaps.size() / 2];
  // Evenly spaced keys tell their rate best over their whole span.
  const bool even = gaps.back() - gaps.front() < 0.02 * median;
  if (only_even && !even) return 0.0;
  return even ? (ticks.back() - ticks.front()) / double(gaps.size()) : median;
}

struct Timing {
  double ticks_per_second = 1.0;
  double rate_hz = 30.0;
};

/// FBX and BVH tick in frames; an FBX may still hold denser keys than its frame rate. Elsewhere the
/// keys' spacing is the rate.
Timing timing_of(const aiAnimation& animation, const std::vector<double>& ticks,
                 std::string_view format) {
  Timing timing;
  const double stated = animation.mTicksPerSecond;
  const bool framed = format == "fbx" || format == "bvh";
  timing.ticks_per_second = stated > 0.0 && std::isfinite(stated) ? stated : framed ? 30.0 : 1000.0;
  const double spacing = usual_spacing(ticks, framed);
  double frame_s = framed ? 1.0 / timing.ticks_per_second : 1.0 / 30.0;
  const bool by_keys = !framed || (format == "fbx" && spacing < 0.9);
  if (by_keys && spacing > 0.0) frame_s = spacing / timing.ticks_per_second;
  frame_s = std::clamp(frame_s, 1e-3, 1.0);
  timing.rate_hz = snap_rate_hz(frame_s, fmt::format("{:.7f}", frame_s));
  return timing;
}

/// The channel of each node, and whether the node's helpers are replaced by it: a channel on the
/// plain name of an FBX node holds the whole local transform, helpers included.
struct Channels {
  std::vector<const aiNodeAnim*> of_node;
  std::vector<std::uint8_t> replaced;
};

Channels channels_of(const aiAnimation& animation, const NodeTree& tree) {
  Channels channels;
  channels.of_node.assign(tree.nodes.size(), nullptr);
  channels.replaced.assign(tree.nodes.size(), 0);
  for (unsigned c = 0; c < animation.mNumChannels; ++c) {
    const std::int32_t node = tree.find(to_text(animation.mChannels[c]->mNodeName));
    if (node >= 0) channels.of_node[node] = animation.mChannels[c];
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
      local[i] = channel_at(*channels.of_node[i], tree.local[i], tick);
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
  const double first = ticks.empty() ? 0.0 : ticks.front();
  const double span = ticks.empty() ? 0.0 : (ticks.back() - first) / timing.ticks_per_second;
  const double frames = std::floor(span * clip.rate_hz + 1e-3) + 1.0;
  if (!(frames * clip.joints <= kMaxSamples)) {
    fail("clip-too-long", fmt::format("animation '{}' lasts {:.6g} s", clip.name, span),
         "check the animation's key times");
  }
  clip.start_s = first / timing.ticks_per_second;
  for (const double tick : ticks) clip.key_times_s.push_back(tick / timing.ticks_per_second);
  std::vector<Eigen::Matrix4d> local = tree.local;
  std::vector<double> first_scale;
  double change = 0.0;
  for (std::int64_t f = 0; f < static_cast<std::int64_t>(frames); ++f) {
    pose_nodes(tree, channels, first + double(f) / clip.rate_hz * timing.ticks_per_second, local);
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
    const Channels channels = channels_of(animation, tree);
    if (!moves_a_joint(channels, tree, joints)) continue;
    clips.push_back(sample_clip(animation, channels, tree, joints, space, format, warnings));
  }
  return clips;
}

}  // namespace limber
