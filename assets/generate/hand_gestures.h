#pragma once

#include <Eigen/Core>
#include <array>
#include <string>

#include "assets/generate/bvh_clip.h"

namespace limber::generate {

/// Fingers from the thumb to the little finger.
inline constexpr int kFingers = 5;

/// Angles of one hand in degrees; zero is the flat hand of the T-pose.
struct HandPose {
  // thumb: away from the palm, across the palm, turn about its bone, bend of the two end joints
  double thumb_palmar = 0, thumb_across = 0, thumb_turn = 0, thumb_bend = 0, thumb_end = 0;
  // index, middle, ring, little: towards the thumb, bend at the knuckle, middle and end joint
  std::array<double, 4> spread{}, knuckle{}, middle{}, end{};
  double cup =
      0;  ///< of the palm: the little finger's metacarpal bends so far, the ring finger's half
};

/// The right hand's skeleton below its wrist (rightHand), with metacarpals or without.
std::vector<MadeJoint> right_hand_joints(bool metacarpals);

/// Local rotations of the joints that right_hand_joints lists, in its order, the wrist first.
std::vector<Eigen::Quaterniond> right_hand_rotations(const std::vector<MadeJoint>&, const HandPose&,
                                                     double wrist_extension);

HandPose fist();

/// Fist, spread, a pinch with each finger, counting from one to five: the right hand alone.
MadeClip hand_gestures();

}  // namespace limber::generate
