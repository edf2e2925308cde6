// An animation curve of FBX stores times, values, and for runs of keys flags and four numbers: for
// tangents set by hand the slope behind the key and that before the next, then the weights of both,
// packed; for TCB keys tension, continuity and bias (FBX SDK reference, FbxAnimCurveDef). A cubic
// piece is a Bezier curve in time and value: with P0 = (t0, v0) and P3 = (t1, v1), h = t1 - t0,
//   P1 = P0 + w0 h (1, s0),  P2 = P3 - w1 h (1, s1).
#include "importers/fbx_curves.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <map>
#include <optional>
#include <unordered_map>

#include "importers/fbx_nodes.h"

namespace limber {

namespace {

constexpr double kTicksPerSecond = 46186158000.0;

constexpr std::array<std::string_view, 13> kWanted = {"Objects",
                                                      "AnimationStack",
                                                      "AnimationLayer",
                                                      "AnimationCurveNode",
                                                      "AnimationCurve",
                                                      "Model",
                                                      "KeyTime",
                                                      "KeyValueFloat",
                                                      "KeyAttrFlags",
                                                      "KeyAttrDataFloat",
                                                      "KeyAttrRefCount",
                                                      "Connections",
                                                      "C"};

// Flags of a key.
constexpr std::uint32_t kHold = 0x2, kCubic = 0x8;
constexpr std::uint32_t kHoldNext = 0x100;  // of a key that holds
constexpr std::uint32_t kTcb = 0x200, kUser = 0x400, kClamped = 0x1000,
                        kClampedProgressive = 0x4000;
constexpr std::uint32_t kWeight = 0x01000000, kNextWeight = 0x02000000;

/// What a run of keys shares.
struct Attributes {
  std::uint32_t flags = 0x4;  // linear
  std::array<double, 4> data{};
};

/// The attributes of every key; empty where the counts do not fit.
std::vector<Attributes> attributes_of(const FbxNode& curve, std::size_t keys) {
  const auto flags = curve.numbers_of("KeyAttrFlags");
  const auto data = curve.numbers_of("KeyAttrDataFloat");
  const auto counts = curve.numbers_of("KeyAttrRefCount");
  std::vector<Attributes> all;
  if (flags.size() != counts.size() || data.size() < 4 * flags.size()) return all;
  for (std::size_t run = 0; run < flags.size() && all.size() < keys; ++run) {
    Attributes shared{.flags = static_cast<std::uint32_t>(static_cast<std::int64_t>(flags[run]))};
    std::copy_n(data.begin() + std::ptrdiff_t(4 * run), 4, shared.data.begin());
    const double left = static_cast<double>(keys - all.size());
    all.insert(all.end(), static_cast<std::size_t>(std::clamp(counts[run], 0.0, left)), shared);
  }
  if (all.size() != keys) all.clear();
  return all;
}

double secant(const FbxKey& a, const FbxKey& b) {
  return (b.value - a.value) / (b.time_s - a.time_s);
}

struct Slopes {
  double before = 0.0, behind = 0.0;
};

/// Kochanek and Bartels 1984 (tension, continuity, bias), per second.
Slopes tcb_slopes(double before, double behind, const std::array<double, 4>& data) {
  const double t = data[0], c = data[1], b = data[2];
  return {.before = 0.5 * (1 - t) * ((1 - c) * (1 + b) * before + (1 + c) * (1 - b) * behind),
          .behind = 0.5 * (1 - t) * ((1 + c) * (1 + b) * before + (1 - c) * (1 - b) * behind)};
}

/// A cardinal spline's slope; clamped ones pass no neighbour's value.
double automatic_slope(const FbxKey& before, const FbxKey& key, const FbxKey& behind,
                       bool clamped) {
  const double in = secant(before, key), out = secant(key, behind);
  const double slope = secant(before, behind);
  if (!clamped) return slope;
  if (in * out <= 0.0) return 0.0;
  const double steepest = 3.0 * std::min(std::abs(in), std::abs(out));
  return std::clamp(slope, -steepest, steepest);
}

/// Slopes on both sides of each key that are no stored ones; those at the ends are level.
Slopes computed_slopes(const std::vector<FbxKey>& keys, std::size_t k, const Attributes& own) {
  if (k == 0 || k + 1 == keys.size()) return {};
  if ((own.flags & kTcb) != 0) {
    return tcb_slopes(secant(keys[k - 1], keys[k]), secant(keys[k], keys[k + 1]), own.data);
  }
  const bool clamped = (own.flags & (kClamped | kClampedProgressive)) != 0;
  const double slope = automatic_slope(keys[k - 1], keys[k], keys[k + 1], clamped);
  return {slope, slope};
}

/// Two weights of four decimals in the bits of one float.
void unpack_weights(const Attributes& own, FbxKey& key) {
  const auto bits = std::bit_cast<std::uint32_t>(static_cast<float>(own.data[2]));
  const auto weight = [](std::uint32_t packed) { return std::clamp(packed * 1e-4, 1e-4, 1.0); };
  if ((own.flags & kWeight) != 0) key.weight = weight(bits & 0xFFFF);
  if ((own.flags & kNextWeight) != 0) key.next_weight = weight(bits >> 16);
}

void set_interpolation(const std::vector<Attributes>& attributes, std::vector<FbxKey>& keys) {
  for (std::size_t k = 0; k < keys.size(); ++k) {
    const Attributes& own = attributes[k];
    FbxKey& key = keys[k];
    if ((own.flags & kHold) != 0) {
      key.interpolation =
          (own.flags & kHoldNext) != 0 ? FbxInterpolation::hold_next : FbxInterpolation::hold;
    }
    if ((own.flags & kCubic) == 0 || k + 1 == keys.size()) continue;
    key.interpolation = FbxInterpolation::cubic;
    unpack_weights(own, key);
    const Attributes& next = attributes[k + 1];
    if ((own.flags & kUser) != 0) {
      key.slope = own.data[0];
      key.next_slope = own.data[1];
    } else {
      const bool next_stored = (next.flags & kUser) != 0;
      key.slope = computed_slopes(keys, k, own).behind;
      key.next_slope = next_stored ? next.data[0] : computed_slopes(keys, k + 1, next).before;
    }
  }
}

/// The keys of a curve; empty where they make no sense.
std::vector<FbxKey> keys_of(const FbxNode& curve) {
  const auto times = curve.numbers_of("KeyTime"), values = curve.numbers_of("KeyValueFloat");
  std::vector<FbxKey> keys;
  if (times.size() != values.size()) return keys;
  for (std::size_t k = 0; k < times.size(); ++k) {
    const double time_s = times[k] / kTicksPerSecond;
    const bool ascends = keys.empty() || time_s > keys.back().time_s;
    if (!ascends || !std::isfinite(time_s) || !std::isfinite(values[k])) return {};
    keys.push_back({.time_s = time_s, .value = values[k]});
  }
  const std::vector<Attributes> attributes = attributes_of(curve, keys.size());
  if (!attributes.empty()) set_interpolation(attributes, keys);
  const bool finite = std::all_of(keys.begin(), keys.end(), [](const FbxKey& key) {
    return std::isfinite(key.slope) && std::isfinite(key.next_slope);
  });
  return finite ? keys : std::vector<FbxKey>();
}

/// Binary files write "name, 0, 1, class", ASCII files "class::name".
std::string object_name(std::string_view text) {
  if (const auto zero = text.find('\0'); zero != std::string_view::npos) {
    return std::string(text.substr(0, zero));
  }
  const auto colons = text.find("::");
  return std::string(colons == std::string_view::npos ? text : text.substr(colons + 2));
}

// ---- who moves what

using Id = std::int64_t;

struct Object {
  const FbxNode* node = nullptr;
  std::string name;
};

struct Connection {
  Id to = 0;
  std::string property;
};

class Scene {
 public:
  explicit Scene(const std::vector<FbxNode>& nodes) {
    for (const FbxNode& section : nodes) {
      for (const FbxNode& child : section.children) {
        if (section.name == "Objects") {
          objects_[child.integer(0)] = {&child, object_name(child.text(1))};
        } else if (section.name == "Connections") {
          connections_.emplace(child.integer(1),
                               Connection{child.integer(2), std::string(child.text(3))});
        }
      }
    }
  }

  /// What an object is connected to and is of that kind.
  struct Owner {
    Id id = 0;
    const Object* object = nullptr;
    std::string property;
  };
  std::optional<Owner> owner(Id of, std::string_view kind) const {
    constexpr int kMostOwners = 64;  // a hostile file could have every object owned by all
    auto [it, end] = connections_.equal_range(of);
    for (int k = 0; it != end && k < kMostOwners; ++it, ++k) {
      const auto found = objects_.find(it->second.to);
      if (found == objects_.end() || found->second.node->name != kind) continue;
      return Owner{it->second.to, &found->second, it->second.property};
    }
    return std::nullopt;
  }

 private:
  std::unordered_map<Id, Object> objects_;
  std::multimap<Id, Connection> connections_;
};

std::optional<FbxProperty> property_of(std::string_view name) {
  if (name == "Lcl Translation") return FbxProperty::translation;
  if (name == "Lcl Rotation") return FbxProperty::rotation;
  if (name == "Lcl Scaling") return FbxProperty::scaling;
  return std::nullopt;
}

/// A curve moves an axis of a curve node, which moves a model's property within a layer of a stack.
std::optional<FbxCurve> place_curve(const Scene& scene, const FbxNode& node) {
  const auto group = scene.owner(node.integer(0), "AnimationCurveNode");
  if (!group || group->property.size() != 3 || !group->property.starts_with("d|")) return {};
  const int axis = group->property[2] - 'X';
  const auto model = scene.owner(group->id, "Model");
  const auto layer = scene.owner(group->id, "AnimationLayer");
  if (axis < 0 || axis > 2 || !model || !layer) return {};
  const auto property = property_of(model->property);
  const auto stack = scene.owner(layer->id, "AnimationStack");
  if (!property || !stack) return {};
  FbxCurve curve{.take = stack->object->name,
                 .layer = layer->object->name,
                 .joint = model->object->name,
                 .property = *property,
                 .axis = axis,
                 .keys = keys_of(node)};
  if (curve.keys.empty()) return {};
  return curve;
}

}  // namespace

double fbx_value_at(const FbxKey& from, const FbxKey& to, double time_s) {
  const double h = to.time_s - from.time_s;
  const double x = std::clamp((time_s - from.time_s) / h, 0.0, 1.0);
  switch (from.interpolation) {
    case FbxInterpolation::hold:
      return x < 1.0 ? from.value : to.value;
    case FbxInterpolation::hold_next:
      return x > 0.0 ? to.value : from.value;
    case FbxInterpolation::linear:
      return from.value + x * (to.value - from.value);
    case FbxInterpolation::cubic:
      break;
  }
  const auto bezier = [](double p1, double p2, double p3, double u) {  // with p0 = 0
    const double v = 1.0 - u;
    return 3.0 * v * v * u * p1 + 3.0 * v * u * u * p2 + u * u * u * p3;
  };
  const bool weighted = from.weight != FbxKey().weight || from.next_weight != FbxKey().weight;
  double u = x;  // with equal shares, time is linear in u
  if (weighted) {
    double low = 0.0, high = 1.0;  // time grows with u, since no weight is above one: halve
    for (int step = 0; step < 40; ++step) {
      u = 0.5 * (low + high);
      (bezier(from.weight, 1.0 - from.next_weight, 1.0, u) < x ? low : high) = u;
    }
  }
  const double rise = to.value - from.value;
  return from.value + bezier(from.weight * h * from.slope,
                             rise - from.next_weight * h * from.next_slope, rise, u);
}

std::vector<FbxCurve> read_fbx_curves(std::span<const std::byte> bytes) {
  const std::vector<FbxNode> nodes = read_fbx_nodes(bytes, kWanted);
  const Scene scene(nodes);
  std::vector<FbxCurve> curves;
  for (const FbxNode& section : nodes) {
    if (section.name != "Objects") continue;
    for (const FbxNode& node : section.children) {
      if (node.name != "AnimationCurve") continue;
      if (auto curve = place_curve(scene, node)) curves.push_back(std::move(*curve));
    }
  }
  return curves;
}

}  // namespace limber
