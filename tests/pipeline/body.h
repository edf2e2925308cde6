// A shipped body for tests to bend.
#pragma once

#include <gtest/gtest.h>

#include "assets/model/mannequin.h"
#include "pipeline/calibration.h"
#include "pipeline/target.h"

namespace limber_test {

/// A shipped body whose rest pose is its T-pose, to be bent by a test.
struct Body {
  limber::Character character;
  limber::Figure figure;

  Body() : character(limber::mannequin(*limber::shipped_rig("biped-full"))) {
    auto found = limber::identify_figure(character);
    EXPECT_TRUE(found);
    figure = std::move(*found);
  }

  /// Turns the rest pose of a role's joint by `turn`, given in the world.
  void turn_rest(limber::Role role, const Eigen::Quaterniond& turn) {
    limber::Skeleton& skeleton = character.skeleton;
    std::vector<limber::DualQuaternion> model(skeleton.parents.size());
    limber::model_from_local(skeleton, skeleton.rest_parent_from_joint, model);
    const std::int32_t j = figure.at(role);
    const Eigen::Quaterniond world = model[j].rotation();
    limber::DualQuaternion& local = skeleton.rest_parent_from_joint[j];
    local = limber::DualQuaternion::from_rotation_translation(
        (local.rotation() * world.conjugate() * turn * world).normalized(), local.translation());
  }

  limber::Calibration calibrated(const limber::Clip* clip = nullptr) const {
    auto out = limber::calibrate(character, figure, {limber::ReferenceChoice::rest, 0}, {}, clip);
    EXPECT_TRUE(out);
    return std::move(*out);
  }
};

}  // namespace limber_test
