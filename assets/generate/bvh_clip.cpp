#include "assets/generate/bvh_clip.h"

#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>

namespace limber::generate {
namespace {

using Euler = std::array<double, 3>;  // degrees about Z, X, Y; R = Rz Rx Ry
constexpr double kDegrees = 180.0 / EIGEN_PI;

/// Fixed decimals without trailing zeros or a negative zero: small files, the same bytes always.
std::string number(double value, int decimals) {
  std::array<char, 64> buffer{};
  std::snprintf(buffer.data(), buffer.size(), "%.*f", decimals, value);
  std::string s = buffer.data();
  s.erase(s.find_last_not_of('0') + 1);
  if (s.back() == '.') s.pop_back();
  return s == "-0" ? "0" : s;
}

std::string numbers(const Eigen::Vector3d& v) {
  return number(v.x(), 4) + " " + number(v.y(), 4) + " " + number(v.z(), 4);
}

double nearest_turn(double angle, double to) {
  return angle + 360.0 * std::round((to - angle) / 360.0);
}

double distance(const Euler& a, const Euler& b) {
  return std::abs(a[0] - b[0]) + std::abs(a[1] - b[1]) + std::abs(a[2] - b[2]);
}

/// Of the two triples that give one rotation, and all their turns, the one nearest to `previous`.
Euler euler_zxy(const Eigen::Quaterniond& q, const Euler& previous) {
  const Eigen::Matrix3d m = q.toRotationMatrix();
  Euler first{}, second{};
  const double cos_x = std::hypot(m(0, 1), m(1, 1));
  const double x = std::atan2(m(2, 1), cos_x) * kDegrees;
  if (cos_x < 1e-6) {  // Z and Y turn about one line: keep Z
    const double z = previous[0] / kDegrees;
    const double sum = std::atan2(m(1, 0), m(0, 0));
    const double y = m(2, 1) > 0.0 ? sum - z : z - sum;
    first = second = {previous[0], x, y * kDegrees};
  } else {
    first = {std::atan2(-m(0, 1), m(1, 1)) * kDegrees, x, std::atan2(-m(2, 0), m(2, 2)) * kDegrees};
    second = {first[0] + 180.0, 180.0 - x, first[2] + 180.0};
  }
  for (Euler* e : {&first, &second}) {
    for (int k = 0; k < 3; ++k) (*e)[k] = nearest_turn((*e)[k], previous[k]);
  }
  return distance(first, previous) <= distance(second, previous) ? first : second;
}

void write_joint(const MadeClip& clip, int joint, int depth, std::string& out) {
  const MadeJoint& made = clip.joints[joint];
  const std::string indent(2 * depth, ' ');
  const bool root = made.parent < 0;
  out += indent + (root ? "ROOT " : "JOINT ") + made.name + "\n" + indent + "{\n";
  out += indent + "  OFFSET " + numbers(root ? Eigen::Vector3d::Zero() : made.offset) + "\n";
  out += indent + (root ? "  CHANNELS 6 Xposition Yposition Zposition " : "  CHANNELS 3 ") +
         "Zrotation Xrotation Yrotation\n";
  bool leaf = true;
  for (int child = joint + 1; child < int(clip.joints.size()); ++child) {
    if (clip.joints[child].parent != joint) continue;
    write_joint(clip, child, depth + 1, out);
    leaf = false;
  }
  if (leaf) {
    out += indent + "  End Site\n" + indent + "  {\n";
    out += indent + "    OFFSET " + numbers(made.tip) + "\n" + indent + "  }\n";
  }
  out += indent + "}\n";
}

}  // namespace

int MadeClip::find(const std::string& name) const {
  for (int i = 0; i < int(joints.size()); ++i) {
    if (joints[i].name == name) return i;
  }
  std::fprintf(stderr, "no joint is named %s\n", name.c_str());
  std::abort();
}

std::string bvh_text(const MadeClip& clip) {
  std::string out = "HIERARCHY\n";
  write_joint(clip, 0, 0, out);
  out += "MOTION\nFrames: " + std::to_string(clip.frames.size()) + "\n";
  out += "Frame Time: " + number(1.0 / clip.rate_hz, 7) + "\n";
  std::vector<Euler> previous(clip.joints.size(), Euler{0.0, 0.0, 0.0});
  for (const MadeFrame& frame : clip.frames) {
    out += numbers(frame.root);
    for (std::size_t j = 0; j < clip.joints.size(); ++j) {
      previous[j] = euler_zxy(frame.local[j], previous[j]);
      for (const double angle : previous[j]) out += " " + number(angle, 3);
    }
    out += "\n";
  }
  return out;
}

}  // namespace limber::generate
