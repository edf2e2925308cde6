#include <algorithm>
#include <charconv>
#include <cmath>
#include <set>
#include <string>

#include "exporters/exporter.h"

// R = Rz(z) Rx(x) Ry(y), the ZXY order of MotionBuilder:
//        | cz cy - sz sx sy   -sz cx   cz sy + sz sx cy |
//    R = | sz cy + cz sx sy    cz cx   sz sy - cz sx cy |
//        |     -cx sy            sx          cx cy      |

namespace limber {
namespace {

constexpr double kDegrees = 180.0 / M_PI;

struct EulerZxy {
  double z = 0.0, x = 0.0, y = 0.0;  ///< rad
};

/// With z chosen, Rz(-z) R = Rx Ry gives the other two.
EulerZxy complete(const Eigen::Matrix3d& r, double z) {
  const double c = std::cos(z), s = std::sin(z);
  const Eigen::RowVector3d row0 = c * r.row(0) + s * r.row(1);
  const Eigen::RowVector3d row1 = -s * r.row(0) + c * r.row(1);
  return {z, std::atan2(r(2, 1), row1[1]), std::atan2(row0[2], row0[0])};
}

double nearest_turn(double angle, double before) {
  return angle - 2.0 * M_PI * std::round((angle - before) / (2.0 * M_PI));
}

/// The angles of `rotation` nearest to those of the frame before. At x = +-90 degrees z and y turn
/// about one axis: z stays what it was.
EulerZxy euler_near(const Eigen::Quaterniond& rotation, const EulerZxy& before) {
  const Eigen::Matrix3d r = rotation.toRotationMatrix();
  const double cos_x = std::hypot(r(0, 1), r(1, 1));
  const double z = cos_x < 1e-7 ? before.z : std::atan2(-r(0, 1), r(1, 1));
  EulerZxy best;
  double best_distance = 1e300;
  for (const double turn : {0.0, M_PI}) {  // (z + 180, 180 - x, y + 180) is the same rotation
    if (cos_x < 1e-7 && turn > 0.0) break;
    EulerZxy e = complete(r, z + turn);
    e = {nearest_turn(e.z, before.z), nearest_turn(e.x, before.x), nearest_turn(e.y, before.y)};
    const double distance =
        std::abs(e.z - before.z) + std::abs(e.x - before.x) + std::abs(e.y - before.y);
    if (distance >= best_distance - 1e-9) continue;
    best = e;
    best_distance = distance;
  }
  return best;
}

struct Writer {
  std::string text;
  int decimals;

  void number(double value, int digits) {
    char buffer[64];
    const double least = 0.5 * std::pow(10.0, -digits);
    const auto [end, error] =
        std::to_chars(buffer, buffer + sizeof buffer, std::abs(value) < least ? 0.0 : value,
                      std::chars_format::fixed, digits);
    if (error == std::errc()) text.append(buffer, end);
  }
  void vector(const Eigen::Vector3d& v) {
    for (int k = 0; k < 3; ++k) {
      text += ' ';
      number(v[k], decimals);
    }
  }
  void line(int depth, std::string_view s) {
    text.append(depth, '\t');
    text += s;
    text += '\n';
  }
};

/// One joint of the written hierarchy.
struct BvhJoint {
  bool end_site = false;    ///< written as its parent's End Site, without channels
  bool translates = false;  ///< six channels
  std::string name;
};

/// BVH names hold no space and no brace and are unique.
std::string safe_name(const std::string& name, std::set<std::string>& taken) {
  std::string safe;
  for (const char c : name) {
    const bool plain = static_cast<unsigned char>(c) > ' ' && c != '{' && c != '}' && c != 127;
    safe += plain ? c : '_';
  }
  std::string unique = safe;
  for (int n = 2; !taken.insert(unique).second; ++n) unique = safe + "_" + std::to_string(n);
  return unique;
}

class Exporter {
 public:
  Exporter(const Skeleton& skeleton, const Clip& clip, const BvhOptions& options)
      : skeleton_(skeleton),
        clip_(clip),
        options_(options),
        children_(children_of(skeleton)),
        joints_(skeleton.parents.size()),
        out_{{}, options.decimals} {
    std::set<std::string> taken;
    for (std::int32_t j = 0; j < skeleton_.size(); ++j) {
      joints_[j].name = safe_name(skeleton_.names[j], taken);
      joints_[j].end_site = is_end_site(j);
      joints_[j].translates = translates(j);
      if (skeleton_.parents[j] == kNoJoint) roots_.push_back(j);
    }
    invented_root_ = roots_.size() > 1;
    if (invented_root_) root_name_ = safe_name("Root", taken);
    if (!invented_root_) joints_[roots_[0]].translates = true;
  }

  std::string run() {
    out_.line(0, "HIERARCHY");
    if (invented_root_) {
      open(0, "ROOT " + root_name_, Eigen::Vector3d::Zero(), true);
      for (const std::int32_t root : roots_) write_joint(root, 1, "JOINT ");
      out_.line(0, "}");
    } else {
      write_joint(roots_[0], 0, "ROOT ");
    }
    write_motion();
    return std::move(out_.text);
  }

 private:
  bool moves(std::int32_t j) const {
    const DualQuaternion& rest = skeleton_.rest_parent_from_joint[j];
    for (std::int64_t f = 0; f < clip_.frames(); ++f) {
      if (rotation_angle(rest.rotation(), clip_.frame(f)[j].rotation()) > 1e-9) return true;
    }
    return translates(j);
  }

  /// Position channels replace OFFSET, and some readers take all-zero channels for absent ones; so
  /// below the root OFFSET is where the joint starts, and the two agree wherever it stays.
  Eigen::Vector3d offset_of(std::int32_t j) const {
    const bool root = skeleton_.parents[j] == kNoJoint;
    return root ? skeleton_.rest_parent_from_joint[j].translation()
                : clip_.frame(0)[j].translation();
  }

  bool translates(std::int32_t j) const {
    const Eigen::Vector3d offset = offset_of(j);
    for (std::int64_t f = 0; f < clip_.frames(); ++f) {
      if ((clip_.frame(f)[j].translation() - offset).norm() > 1e-8) return true;
    }
    return false;
  }

  /// A still leaf 'PARENT_End' is what our reader makes of PARENT's End Site; it becomes one again.
  bool is_end_site(std::int32_t j) const {
    const std::int32_t parent = skeleton_.parents[j];
    if (parent == kNoJoint || skeleton_.names[j] != skeleton_.names[parent] + "_End") return false;
    const DualQuaternion& rest = skeleton_.rest_parent_from_joint[j];
    return children_[j].empty() && children_[parent].size() == 1 &&
           rotation_angle(rest.rotation(), Eigen::Quaterniond::Identity()) < 1e-9 && !moves(j);
  }

  void open(int depth, const std::string& head, const Eigen::Vector3d& offset, bool six) {
    out_.line(depth, head);
    out_.line(depth, "{");
    write_offset(depth + 1, offset);
    out_.line(depth + 1,
              six ? "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"
                  : "CHANNELS 3 Zrotation Xrotation Yrotation");
  }

  void write_offset(int depth, const Eigen::Vector3d& offset) {
    out_.text.append(depth, '\t');
    out_.text += "OFFSET";
    out_.vector(offset / options_.unit_m);
    out_.text += '\n';
  }

  void write_end_site(int depth, const Eigen::Vector3d& offset) {
    out_.line(depth, "End Site");
    out_.line(depth, "{");
    write_offset(depth + 1, offset);
    out_.line(depth, "}");
  }

  /// A tip for a joint that has none: its parent's bone, carried on for a short way.
  Eigen::Vector3d invented_tip(std::int32_t j) const {
    const DualQuaternion& rest = skeleton_.rest_parent_from_joint[j];
    const Eigen::Vector3d bone = rest.rotation().conjugate() * rest.translation();
    const double length = bone.norm();
    if (skeleton_.parents[j] == kNoJoint || length < 1e-6) return {0.0, 0.05, 0.0};
    return bone * (std::clamp(0.5 * length, 0.01, 0.15) / length);
  }

  void write_joint(std::int32_t j, int depth, const char* keyword) {
    open(depth, keyword + joints_[j].name, offset_of(j), joints_[j].translates);
    order_.push_back(j);
    for (const std::int32_t child : children_[j]) {
      if (joints_[child].end_site) {
        write_end_site(depth + 1, skeleton_.rest_parent_from_joint[child].translation());
      } else {
        write_joint(child, depth + 1, "JOINT ");
      }
    }
    if (children_[j].empty()) write_end_site(depth + 1, invented_tip(j));
    out_.line(depth, "}");
  }

  void write_motion() {
    out_.text += "MOTION\nFrames: " + std::to_string(clip_.frames()) + "\nFrame Time: ";
    out_.number(1.0 / clip_.rate_hz, 10);
    out_.text += '\n';
    std::vector<EulerZxy> angles(order_.size());
    for (std::int64_t f = 0; f < clip_.frames(); ++f) {
      const std::size_t begin = out_.text.size();
      if (invented_root_) {
        for (int k = 0; k < 2; ++k) out_.vector(Eigen::Vector3d::Zero());
      }
      for (std::size_t i = 0; i < order_.size(); ++i) {
        const DualQuaternion& local = clip_.frame(f)[order_[i]];
        angles[i] = euler_near(local.rotation(), angles[i]);
        if (joints_[order_[i]].translates) out_.vector(local.translation() / options_.unit_m);
        out_.vector(kDegrees * Eigen::Vector3d(angles[i].z, angles[i].x, angles[i].y));
      }
      out_.text.erase(begin, 1);  // the leading space
      out_.text += '\n';
    }
  }

  const Skeleton& skeleton_;
  const Clip& clip_;
  const BvhOptions& options_;
  std::vector<std::vector<std::int32_t>> children_;
  std::vector<BvhJoint> joints_;
  std::vector<std::int32_t> roots_;
  std::vector<std::int32_t> order_;  ///< joints in the order of their channels
  bool invented_root_ = false;
  std::string root_name_;
  Writer out_;
};

}  // namespace

Result<std::string> export_bvh(const Character& character, const Clip& clip,
                               const BvhOptions& options) {
  if (auto r = validate(character.skeleton); !r) return r.error();
  if (auto r = validate(character.skeleton, clip); !r) return r.error();
  if (!(options.unit_m > 0.0) || !std::isfinite(options.unit_m) || options.decimals < 0 ||
      options.decimals > 15) {
    return Error{.code = "export-option",
                 .message = "BvhOptions: the unit must be positive, decimals within 0 to 15",
                 .hint = "0.01 (centimetres) and 6 suit most programs"};
  }
  return Exporter(character.skeleton, clip, options).run();
}

}  // namespace limber
