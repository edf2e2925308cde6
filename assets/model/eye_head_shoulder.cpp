// The eye sees p = depth n, |n| = 1. So p' = depth' n + depth n', where n' is across n:
//   depth' = n . p',   n' = (p' - depth' n) / depth.
#include "assets/model/eye_head_shoulder.h"

namespace limber {

using Eigen::Vector3d;

namespace {

/// parent_from_part of a part that turns about a point fixed in its parent.
MovingTransform turning_about(const Vector3d& centre, const Eigen::Quaterniond& rotation,
                              const Vector3d& turn) {
  return {DualQuaternion::from_rotation_translation(rotation, centre),
          {turn, centre.cross(turn)}};  // the twist that keeps `centre` in place
}

}  // namespace

MovingTransform shoulder_from_eye(const EyeHeadShoulder& body) {
  return turning_about(body.head_in_shoulder, body.shoulder_from_head, body.head_turn) *
         turning_about(body.eye_in_head, body.head_from_eye, body.eye_turn);
}

Result<RetinalImage> retinal_image(const EyeHeadShoulder& body, const MovingPoint& target) {
  const MovingPoint p = transform(shoulder_from_eye(body).inverse(), target);
  RetinalImage image;
  image.depth = p.position.norm();
  if (!(image.depth > kNearestGaze)) {
    return Error{.code = "target-at-eye",
                 .message = "the target is at the eye's centre, from where it has no direction",
                 .hint = "keep targets away from the eye"};
  }
  image.direction = p.position / image.depth;
  image.depth_rate = image.direction.dot(p.velocity);
  image.velocity = (p.velocity - image.depth_rate * image.direction) / image.depth;
  return image;
}

MovingPoint target_from_image(const EyeHeadShoulder& body, const RetinalImage& image) {
  const MovingPoint in_eye{image.depth * image.direction,
                           image.depth_rate * image.direction + image.depth * image.velocity};
  return transform(shoulder_from_eye(body), in_eye);
}

}  // namespace limber
