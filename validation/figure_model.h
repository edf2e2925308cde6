#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "assets/model/character.h"
#include "validation/rasteriser.h"

namespace limber {

enum class BodySide : std::uint8_t { centre, left, right };

/// What is known about a character's body, from roles, names and, at last, the rest pose.
struct BodyPlan {
  std::vector<std::string> roles;  ///< [joint] VRM 1.0 name or ""
  std::vector<BodySide> sides;     ///< [joint]
  /// Left joint and its mirror image, where the two chains leave the middle.
  std::vector<std::pair<std::int32_t, std::int32_t>> pairs;
  std::int32_t pelvis = 0;  ///< the joint that a camera follows
  std::int32_t head = kNoJoint;
  bool hand_only = false;            ///< a hand without a body
  bool stands = false;               ///< a body that has a floor under it, no hand, arm or tool
  std::vector<std::int8_t> fingers;  ///< [joint] 0 thumb ... 4 little; -1: none
  std::int32_t crop = kNoJoint;      ///< if any: only this joint and what hangs on it is drawn
};
BodyPlan plan_of(const Character&);

/// One hand of a body as a hand alone; the whole figure's plan where it has no fingers there.
BodyPlan hand_plan_of(const Character&, BodySide);

/// [joint] 1: `top` or below it; every joint for kNoJoint.
std::vector<std::uint8_t> joints_below(const Skeleton&, std::int32_t top);

/// model_from_joint at binding, else at rest.
std::vector<DualQuaternion> rest_model(const Character&);

/// The chain's first joint beyond the palm (a proximal phalanx, where names tell); kNoJoint if the
/// hand lacks that finger.
std::int32_t knuckle_of(const Skeleton&, const BodyPlan&, std::int8_t finger);
std::int32_t wrist_of(const Skeleton&, const BodyPlan&);

/// sRGB 0-255 to linear light.
Eigen::Vector3f linear_color(int r, int g, int b);

/// Colours of the two sides: cool left, warm right.
struct SideColors {
  Eigen::Vector3f left = linear_color(66, 135, 200);
  Eigen::Vector3f right = linear_color(236, 144, 58);
  Eigen::Vector3f centre = linear_color(150, 156, 166);
  Eigen::Vector3f tint = linear_color(150, 60, 220);  ///< joints on a limit
  /// Of a hand alone: thumb, index, middle, ring, little.
  std::array<Eigen::Vector3f, 5> fingers{linear_color(236, 144, 58), linear_color(66, 135, 200),
                                         linear_color(60, 172, 156), linear_color(176, 172, 70),
                                         linear_color(214, 106, 158)};
  const Eigen::Vector3f& of(const BodyPlan&, std::int32_t joint) const;
};

/// A character that can be posed and drawn: its skinned meshes, or bones with volume where it has
/// none.
class FigureModel {
 public:
  FigureModel(const Character&, BodyPlan, std::span<const std::int32_t> tinted_joints);
  ~FigureModel();
  FigureModel(FigureModel&&) noexcept;

  const BodyPlan& plan() const { return plan_; }

  /// World-space surfaces; world = scale * model + offset. Valid until the next call.
  std::span<const Surface> pose(std::span<const DualQuaternion> model_from_joint, double scale,
                                const Eigen::Vector3d& offset);

 private:
  struct SkinnedPart;
  using Tinted = std::span<const std::uint8_t>;  // [joint] 1: on a limit somewhere
  void load_textures();
  void add_meshes(Tinted);
  void add_part(const Mesh&, const Material&, bool plain, Tinted);
  void add_bones(Tinted);
  void add_bones_of(std::int32_t joint, std::span<const std::int32_t> children, double longest,
                    Tinted);
  bool inside_head(std::int32_t joint) const;
  Eigen::Vector3d onwards(std::int32_t joint) const;
  void pose_bones(std::span<const DualQuaternion> model_from_joint);

  struct Bone {
    std::int32_t from = 0, to = kNoJoint;             // to: kNoJoint for a stub along `along`
    Eigen::Vector3d along = Eigen::Vector3d::Zero();  // stub, in the joint's space, m
    double radius = 0.0, end_radius = 0.0;
    bool ball = false;  // a ball at the stub's end instead of a bone
    Eigen::Vector3f color, joint_color;
  };

  const Character& character_;
  BodyPlan plan_;
  std::vector<std::uint8_t> in_body_;  // [joint] drawn as a bone
  std::vector<Bone> bones_;
  std::vector<SkinnedPart> parts_;
  std::vector<std::unique_ptr<TexturePyramid>> textures_;  // [texture], null: unreadable
  std::vector<Surface> surfaces_;
};

}  // namespace limber
