#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <cstdio>
#include <functional>
#include <string>
#include <vector>

/// A small figure that moves, and a BVH writer of many dialects: the tests' own, sharing nothing
/// with the reader but the format.
namespace limber::test {

struct FigureJoint {
  std::string name;
  int parent;
  Eigen::Vector3d offset;  ///< metres, Y up
};

inline const std::vector<FigureJoint>& figure() {
  static const std::vector<FigureJoint> joints = {
      {"Hips", -1, {0, 0.95, 0}},          {"Spine", 0, {0, 0.15, 0.01}},
      {"Chest", 1, {0, 0.2, 0}},           {"Neck", 2, {0, 0.18, 0}},
      {"Head", 3, {0, 0.1, 0.02}},         {"LeftArm", 2, {0.18, 0.14, 0}},
      {"LeftForeArm", 5, {0.28, 0, 0}},    {"LeftHand", 6, {0.25, 0, 0}},
      {"RightArm", 2, {-0.18, 0.14, 0}},   {"RightForeArm", 8, {-0.28, 0, 0}},
      {"RightHand", 9, {-0.25, 0, 0}},     {"LeftUpLeg", 0, {0.1, -0.05, 0}},
      {"LeftLeg", 11, {0, -0.43, 0}},      {"LeftFoot", 12, {0, -0.41, -0.01}},
      {"RightUpLeg", 0, {-0.1, -0.05, 0}}, {"RightLeg", 14, {0, -0.43, 0}},
      {"RightFoot", 15, {0, -0.41, -0.01}}};
  return joints;
}

/// Local rotation of a joint and position of the root, metres and Y up.
inline Eigen::Quaterniond figure_rotation(int joint, int frame) {
  const double a = 0.6 * std::sin(0.31 * frame + 1.7 * joint);
  const double b = 0.4 * std::cos(0.23 * frame + 0.9 * joint);
  const double c = 0.5 * std::sin(0.17 * frame - 0.4 * joint);
  const double scale = joint == 0 ? 0.3 : 1.0;
  return Eigen::AngleAxisd(scale * a, Eigen::Vector3d::UnitX()) *
         Eigen::AngleAxisd(scale * b, Eigen::Vector3d::UnitY()) *
         Eigen::AngleAxisd(scale * c, Eigen::Vector3d::UnitZ());
}
inline Eigen::Vector3d figure_root(int frame) {
  return {0.02 * frame, 0.95 + 0.03 * std::sin(0.5 * frame), -0.05 * frame};
}

/// Joint positions by plain 4 x 4 matrices.
inline std::vector<Eigen::Vector3d> figure_positions(int frame) {
  std::vector<Eigen::Matrix4d> world;
  std::vector<Eigen::Vector3d> points;
  for (std::size_t j = 0; j < figure().size(); ++j) {
    Eigen::Matrix4d local = Eigen::Matrix4d::Identity();
    local.topLeftCorner<3, 3>() = figure_rotation(int(j), frame).toRotationMatrix();
    local.topRightCorner<3, 1>() = j == 0 ? figure_root(frame) : figure()[j].offset;
    world.push_back(j == 0 ? local : Eigen::Matrix4d(world[figure()[j].parent] * local));
    points.push_back(world.back().topRightCorner<3, 1>());
  }
  return points;
}

/// What is written: joints (parents first, one root) and their motion, metres and Y up.
struct Performance {
  std::vector<FigureJoint> joints;
  std::function<Eigen::Quaterniond(int joint, int frame)> rotation;  ///< local
  std::function<Eigen::Vector3d(int frame)> root;
};
inline Performance figure_performance() { return {figure(), figure_rotation, figure_root}; }

struct Dialect {
  std::string order = "ZXY";
  bool mixed_orders = false;  ///< joint j uses the j-th of the six orders
  bool six_channels = false;  ///< positions on every joint: the offset, absolute
  bool zero_filled = false;   ///< positions on every joint, but zero below the root
  bool rotation_first = false;
  bool z_up = false;
  bool y_up_offsets = false;  ///< with z_up: the offsets stay Y up
  double unit_m = 0.01;
  std::string eol = "\n";
  bool bom = false;
  bool tabs = false;
  bool lower_case = false;
  bool brace_on_line = false;
  bool end_sites = true;
  bool exponents = false;
  std::string name_prefix;       ///< bytes in any encoding
  std::string name_prefix_utf8;  ///< what they mean
  bool reference_frame = false;  ///< frame 0 holds the offsets' own pose
  int frames = 20;
  std::string frame_time = "0.0333333";
};

class BvhWriter {
 public:
  explicit BvhWriter(Dialect dialect, Performance performance = figure_performance())
      : d_(std::move(dialect)), p_(std::move(performance)) {
    // canonical = turn * file
    if (d_.z_up) turn_ = Eigen::AngleAxisd(-M_PI / 2, Eigen::Vector3d::UnitX());
  }

  std::string write() {
    if (d_.bom) out_ += "\xEF\xBB\xBF";
    line("HIERARCHY");
    joint(0, 0);
    line("MOTION");
    line("Frames:" + gap() + std::to_string(d_.frames + (d_.reference_frame ? 1 : 0)));
    line("Frame Time:" + gap() + d_.frame_time);
    if (d_.reference_frame) row(-1);
    for (int f = 0; f < d_.frames; ++f) row(f);
    return out_;
  }

 private:
  std::string gap() const { return d_.tabs ? "\t" : " "; }
  std::string word(std::string text) const {
    if (d_.lower_case) {
      for (char& c : text) c = static_cast<char>(std::tolower(c));
    }
    return text;
  }
  void line(const std::string& text) { out_ += word(text) + d_.eol; }
  std::string number(double v) const {
    char text[64];
    std::snprintf(text, sizeof text, d_.exponents ? "%.9e" : "%.7f", v);
    return text;
  }
  std::string vector(const Eigen::Vector3d& v) const {
    return number(v.x()) + gap() + number(v.y()) + gap() + number(v.z());
  }
  std::string order_of(int joint) const {
    static const std::array<const char*, 6> kOrders = {"XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"};
    return d_.mixed_orders ? kOrders[joint % 6] : d_.order;
  }
  bool has_position(int joint) const { return joint == 0 || d_.six_channels || d_.zero_filled; }

  Eigen::Vector3d offset(int joint) const {
    const Eigen::Vector3d o = p_.joints[joint].offset / d_.unit_m;
    return d_.y_up_offsets ? o : turn_.conjugate() * o;
  }

  void joint(int j, int depth) {
    const std::string pad(depth, '\t');
    const std::string name = d_.name_prefix + p_.joints[j].name;
    const std::string head = pad + word(j == 0 ? "ROOT " : "JOINT ");
    out_ += head + name + (d_.brace_on_line ? " {" : d_.eol + pad + "{") + d_.eol;
    line(pad + "\tOFFSET" + gap() + vector(offset(j)));
    std::string channels;
    const std::string position = " Xposition Yposition Zposition";
    std::string rotation;
    for (const char axis : order_of(j)) rotation += std::string(" ") + axis + "rotation";
    if (has_position(j)) {
      channels = d_.rotation_first ? " 6" + rotation + position : " 6" + position + rotation;
    } else {
      channels = " 3" + rotation;
    }
    line(pad + "\tCHANNELS" + channels);
    bool leaf = true;
    for (int c = j + 1; c < int(p_.joints.size()); ++c) {
      if (p_.joints[c].parent != j) continue;
      joint(c, depth + 1);
      leaf = false;
    }
    if (leaf && d_.end_sites) {
      line(pad + "\tEnd Site");
      line(pad + "\t{");
      line(pad + "\t\tOFFSET" + gap() + vector(Eigen::Vector3d(0, 0.05, 0) / d_.unit_m));
      line(pad + "\t}");
    }
    line(pad + "}");
  }

  void row(int frame) {
    std::string text;
    for_each_depth_first(0, [&](int j) {
      Eigen::Vector3d p = frame < 0 ? p_.joints[j].offset
                          : j == 0  ? p_.root(frame)
                                    : p_.joints[j].offset;
      Eigen::Quaterniond r = frame < 0 ? Eigen::Quaterniond::Identity() : p_.rotation(j, frame);
      if (!d_.y_up_offsets) {
        p = turn_.conjugate() * p;
        r = turn_.conjugate() * r * turn_;
      } else if (j == 0) {
        p = turn_.conjugate() * p;
        r = turn_.conjugate() * r;
      }
      if (d_.zero_filled && j != 0) p.setZero();
      const std::string order = order_of(j);
      const Eigen::Vector3d angles =
          r.toRotationMatrix().eulerAngles(order[0] - 'X', order[1] - 'X', order[2] - 'X');
      const std::string rotation = vector(angles * 180.0 / M_PI);
      if (!text.empty()) text += gap();
      if (!has_position(j)) {
        text += rotation;
      } else if (d_.rotation_first) {
        text += rotation + gap() + vector(p / d_.unit_m);
      } else {
        text += vector(p / d_.unit_m) + gap() + rotation;
      }
    });
    out_ += text + d_.eol;
  }

  template <class Visit>
  void for_each_depth_first(int j, const Visit& visit) {
    visit(j);
    for (int c = j + 1; c < int(p_.joints.size()); ++c) {
      if (p_.joints[c].parent == j) for_each_depth_first(c, visit);
    }
  }

  Dialect d_;
  Performance p_;
  Eigen::Quaterniond turn_ = Eigen::Quaterniond::Identity();
  std::string out_;
};

}  // namespace limber::test
