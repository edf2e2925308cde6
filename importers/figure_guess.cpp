#include "importers/figure_guess.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <initializer_list>

namespace limber {

namespace {

using Points = std::vector<Eigen::Vector3d>;

constexpr double kAdult_m = 1.70;
/// Sole to ankle and head joint to crown, added to the chain ankle - pelvis - head joint. The
/// segments sum to 0.83 of the stature (Drillis and Contini 1966); the chain's way round the hip
/// joint takes part of the rest.
constexpr double kStaturePerChain = 1.16;

std::string lower_case(std::string text) {
  for (char& c : text) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  return text;
}

/// Joints whose name holds one of the words, none below another.
std::vector<std::int32_t> named(const Skeleton& skeleton,
                                std::initializer_list<const char*> words) {
  std::vector<std::uint8_t> inside(skeleton.parents.size(), 0);
  std::vector<std::int32_t> found;
  for (std::int32_t i = 0; i < skeleton.size(); ++i) {
    const std::int32_t parent = skeleton.parents[i];
    if (parent != kNoJoint && inside[parent] != 0) {
      inside[i] = 1;
      continue;
    }
    const std::string name = lower_case(skeleton.names[i]);
    const bool hit = std::any_of(words.begin(), words.end(), [&](const char* word) {
      return name.find(word) != std::string::npos;
    });
    if (hit) {
      inside[i] = 1;
      found.push_back(i);
    }
  }
  return found;
}

struct Landmarks {
  std::int32_t head = kNoJoint;
  std::vector<std::int32_t> feet;
  bool complete() const { return head != kNoJoint && !feet.empty(); }
};

Landmarks find_landmarks(const Skeleton& skeleton) {
  Landmarks marks;
  const auto heads = named(skeleton, {"head"});
  if (!heads.empty()) marks.head = heads.front();
  for (const char* word : {"ankle", "foot", "toe", "shin", "leg"}) {
    marks.feet = named(skeleton, {word});
    if (!marks.feet.empty()) break;
  }
  return marks;
}

Points positions(const Skeleton& skeleton, std::span<const DualQuaternion> parent_from_joint) {
  std::vector<DualQuaternion> model(skeleton.parents.size());
  model_from_local(skeleton, parent_from_joint, model);
  Points points;
  for (const DualQuaternion& m : model) points.push_back(m.translation());
  return points;
}

/// Joint positions of up to 64 frames, evenly taken.
std::vector<Points> sample(const Skeleton& skeleton, const Clip* clip) {
  std::vector<Points> samples;
  if (clip == nullptr) return samples;
  const std::int64_t count = std::min<std::int64_t>(clip->frames(), 64);
  for (std::int64_t k = 0; k < count; ++k) {
    const std::int64_t f = count == 1 ? 0 : k * (clip->frames() - 1) / (count - 1);
    samples.push_back(positions(skeleton, clip->frame(f)));
  }
  return samples;
}

double chain_length(const Skeleton& skeleton, const Points& points, std::int32_t from,
                    std::int32_t to_ancestor) {
  double length = 0.0;
  for (std::int32_t i = from; i != to_ancestor && skeleton.parents[i] != kNoJoint;
       i = skeleton.parents[i]) {
    length += (points[i] - points[skeleton.parents[i]]).norm();
  }
  return length;
}

std::int32_t common_ancestor(const Skeleton& skeleton, std::int32_t a, std::int32_t b) {
  while (a != b && a != kNoJoint && b != kNoJoint) {
    (a > b ? a : b) = skeleton.parents[a > b ? a : b];
  }
  return a == b ? a : kNoJoint;
}

/// Ankle to pelvis (mean of the legs) and pelvis to head joint, along the bones.
double body_chain(const Skeleton& skeleton, const Landmarks& marks, const Points& points) {
  double sum = 0.0;
  for (const std::int32_t foot : marks.feet) {
    const std::int32_t pelvis = common_ancestor(skeleton, foot, marks.head);
    sum += chain_length(skeleton, points, foot, pelvis) +
           chain_length(skeleton, points, marks.head, pelvis);
  }
  return sum / double(marks.feet.size());
}

Eigen::Vector3d feet_to_head(const Landmarks& marks, const Points& points) {
  Eigen::Vector3d feet = Eigen::Vector3d::Zero();
  for (const std::int32_t foot : marks.feet) feet += points[foot];
  return points[marks.head] - feet / double(marks.feet.size());
}

/// Mean of the directions feet to head and pelvis to head: who sits on the floor has the latter.
Eigen::Vector3d upright(const Skeleton& skeleton, const Landmarks& marks, const Points& points) {
  const std::int32_t pelvis = common_ancestor(skeleton, marks.feet.front(), marks.head);
  Eigen::Vector3d line = feet_to_head(marks, points).stableNormalized();
  if (pelvis == kNoJoint) return line;
  line += (points[marks.head] - points[pelvis]).stableNormalized();
  return line.stableNormalized();
}

std::string axis_name(const Eigen::Vector3d& v) {
  int k = 0;
  v.cwiseAbs().maxCoeff(&k);
  return std::string(v[k] < 0 ? "-" : "+") + "XYZ"[k];
}

Eigen::Vector3d axis_vector(std::string_view name) {
  Eigen::Vector3d v = Eigen::Vector3d::Zero();
  v[name[1] - 'X'] = name[0] == '-' ? -1.0 : 1.0;
  return v;
}

/// Height of the lowest point of all frames along an axis.
double lowest(const std::vector<Points>& samples, const Eigen::Vector3d& axis) {
  double low = std::numeric_limits<double>::infinity();
  for (const Points& points : samples) {
    for (const Eigen::Vector3d& p : points) low = std::min(low, p.dot(axis));
  }
  return low;
}

bool usual(const std::string& up) { return up == "+Y" || up == "+Z"; }

/// Motion that contradicts an upright rest pose: either the offsets use another axis than the
/// motion, or the person lies or stands upside down. Someone who lies has the floor at height zero
/// along the rest pose's axis and nowhere special along the other.
bool motion_wins(const std::string& rest_up, const std::string& motion_up, double motion_share,
                 const std::vector<Points>& samples, double chain) {
  if (!usual(motion_up) || rest_up[1] == motion_up[1] || motion_share < 0.7) return false;
  const double rest_floor = std::abs(lowest(samples, axis_vector(rest_up)));
  const double motion_floor = std::abs(lowest(samples, axis_vector(motion_up)));
  return !(rest_floor < 0.15 * chain && motion_floor > 0.3 * chain);
}

}  // namespace

UpGuess guess_up(const Skeleton& skeleton, const Clip* clip) {
  UpGuess guess;
  const Landmarks marks = find_landmarks(skeleton);
  if (!marks.complete()) {
    guess.evidence = "no head and feet by name: +Y assumed";
    return guess;
  }
  const Points rest = positions(skeleton, skeleton.rest_parent_from_joint);
  const double chain = body_chain(skeleton, marks, rest);
  const Eigen::Vector3d rest_line = feet_to_head(marks, rest);
  const std::string rest_axis = axis_name(rest_line);
  const double rest_share =
      rest_line.norm() > 0 ? rest_line.cwiseAbs().maxCoeff() / rest_line.norm() : 0.0;
  const bool rest_stands =
      usual(rest_axis) && rest_share > 0.9 && rest_line.norm() > 0.7 * chain && chain > 0.0;

  const std::vector<Points> samples = sample(skeleton, clip);
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const Points& points : samples) {
    mean += upright(skeleton, marks, points) / double(samples.size());
  }
  const std::string motion_axis = axis_name(mean);
  const double motion_share = mean.cwiseAbs().maxCoeff();
  const bool motion_clear = motion_share > (usual(motion_axis) ? 0.6 : 0.9);

  if (rest_stands && (!motion_clear || motion_axis == rest_axis)) {
    guess.up = guess.rest_up = rest_axis;
    guess.evidence = fmt::format("the rest pose stands along {}", rest_axis);
  } else if (rest_stands && motion_wins(rest_axis, motion_axis, motion_share, samples, chain)) {
    guess.up = motion_axis;
    guess.rest_up = rest_axis;
    guess.evidence = fmt::format("the motion stands along {} (share {:.2f}), the offsets along {}",
                                 motion_axis, motion_share, rest_axis);
  } else if (rest_stands) {
    guess.up = guess.rest_up = rest_axis;
    guess.evidence = fmt::format("the rest pose stands along {}; the motion lies", rest_axis);
  } else if (motion_clear) {
    guess.up = guess.rest_up = motion_axis;
    guess.evidence =
        fmt::format("the motion stands along {} (share {:.2f}); the rest pose does not",
                    motion_axis, motion_share);
  } else {
    guess.evidence = "neither rest pose nor motion stands clearly: +Y assumed";
  }
  return guess;
}

namespace {

struct KnownUnit {
  const char* name;
  double unit_m;
};
constexpr std::array<KnownUnit, 6> kUnits = {{{"m", 1.0},
                                              {"cm", 0.01},
                                              {"mm", 0.001},
                                              {"CMU unit", 0.0254 / 0.45},
                                              {"inch", 0.0254},
                                              {"dm", 0.1}}};

/// Share of joints that are named after fingers.
double finger_share(const Skeleton& skeleton) {
  int fingers = 0;
  for (const std::string& name : skeleton.names) {
    const std::string low = lower_case(name);
    for (const char* word : {"thumb", "index", "middle", "ring", "pinky", "little", "finger"}) {
      if (low.find(word) != std::string::npos) {
        ++fingers;
        break;
      }
    }
  }
  return double(fingers) / double(std::max(1, skeleton.size()));
}

/// Largest extent along `axis` over the rest pose and the sampled frames.
double extent(const std::vector<Points>& poses, const Eigen::Vector3d& axis) {
  double largest = 0.0;
  for (const Points& points : poses) {
    double low = std::numeric_limits<double>::infinity();
    double high = -low;
    for (const Eigen::Vector3d& p : points) {
      low = std::min(low, p.dot(axis));
      high = std::max(high, p.dot(axis));
    }
    largest = std::max(largest, high - low);
  }
  return largest;
}

struct Size {
  double file_units = 0.0;
  double typical_m = kAdult_m, min_m = 1.2, max_m = 2.1;
  double fallback_m = 1.72;
  std::string what;
  bool certain = true;  ///< a known figure was measured
};

Size measure(const Skeleton& skeleton, const Clip* clip, std::string_view up) {
  std::vector<Points> poses = sample(skeleton, clip);
  const Points rest = positions(skeleton, skeleton.rest_parent_from_joint);
  const Landmarks marks = find_landmarks(skeleton);
  Size size;
  if (marks.complete()) {
    const Points& posed = poses.empty() ? rest : poses.front();
    const double chain = body_chain(skeleton, marks, posed);
    double tallest = 0.0;
    for (const Points& points : poses) {
      tallest = std::max(tallest, feet_to_head(marks, points).dot(axis_vector(up)));
    }
    size.file_units = kStaturePerChain * chain;
    size.what =
        fmt::format("standing height {:.4g} (legs and spine {:.4g}, feet to head {:.4g} in motion)",
                    size.file_units, chain, tallest);
    return size;
  }
  if (finger_share(skeleton) > 0.5) {
    for (std::int32_t i = 0; i < skeleton.size(); ++i) {
      size.file_units = std::max(size.file_units, chain_length(skeleton, rest, i, 0));
    }
    size.typical_m = size.fallback_m = 0.18;
    size.min_m = 0.10;
    size.max_m = 0.30;
    size.what = fmt::format("a hand of length {:.4g}", size.file_units);
    return size;
  }
  poses.push_back(rest);
  size.file_units = extent(poses, axis_vector(up));
  size.certain = false;
  size.what = fmt::format("no head and feet by name; extent along {} {:.4g}", up, size.file_units);
  return size;
}

}  // namespace

UnitGuess guess_unit(const Skeleton& skeleton, const Clip* clip, std::string_view up) {
  const Size size = measure(skeleton, clip, up);
  UnitGuess guess;
  guess.certain = size.certain;
  if (!(size.file_units > 1e-9 && size.file_units < 1e9)) {
    guess.plausible = false;
    guess.evidence = "the figure has no extent that can be measured: 1 unit taken as 1 m";
    return guess;
  }
  const KnownUnit* best = nullptr;
  const auto miss = [&](const KnownUnit& unit) {
    return std::abs(std::log(size.file_units * unit.unit_m / size.typical_m));
  };
  for (const KnownUnit& unit : kUnits) {
    const double metres = size.file_units * unit.unit_m;
    if (metres < size.min_m || metres > size.max_m) continue;
    if (best == nullptr || miss(unit) < miss(*best)) best = &unit;
  }
  if (best == nullptr) {
    guess.plausible = false;
    guess.unit_m = size.fallback_m / size.file_units;
    guess.evidence = fmt::format("{}: no known unit gives {:.4g} to {:.4g} m; scaled to {:.4g} m",
                                 size.what, size.min_m, size.max_m, size.fallback_m);
    return guess;
  }
  guess.unit_m = best->unit_m;
  guess.evidence =
      fmt::format("{} is {:.3g} m in {}", size.what, size.file_units * best->unit_m, best->name);
  return guess;
}

Eigen::Quaterniond canonical_from_up(std::string_view up) {
  const double h = std::sqrt(0.5);
  if (up == "+Z") return {h, -h, 0, 0};
  if (up == "-Z") return {h, h, 0, 0};
  if (up == "-Y") return {0, 1, 0, 0};
  if (up == "+X") return {h, 0, 0, h};
  if (up == "-X") return {h, 0, 0, -h};
  return {1, 0, 0, 0};
}

std::string unit_name(double unit_m) {
  for (const KnownUnit& unit : kUnits) {
    if (std::abs(unit.unit_m - unit_m) <= 1e-9 * unit_m) return unit.name;
  }
  return fmt::format("{:.6g} m", unit_m);
}

void make_canonical(const Skeleton& skeleton, std::span<DualQuaternion> parent_from_joint,
                    double unit_m, const Eigen::Quaterniond& canonical_from_file) {
  const DualQuaternion turn = DualQuaternion::from_rotation(canonical_from_file);
  const std::size_t joints = skeleton.parents.size();
  for (std::size_t begin = 0; begin < parent_from_joint.size(); begin += joints) {
    for (std::size_t j = 0; j < joints; ++j) {
      DualQuaternion& q = parent_from_joint[begin + j];
      q.dual.coeffs() *= unit_m;
      if (skeleton.parents[j] == kNoJoint) q = turn * q;
    }
  }
}

}  // namespace limber
