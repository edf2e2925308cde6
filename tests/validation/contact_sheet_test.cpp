#include "validation/contact_sheet.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "tests/validation/walker.h"
#include "validation/image_io.h"
#include "validation/rasteriser.h"
#include "validation/sheet_view.h"

namespace limber {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

// ---------------------------------------------------------------------------- rasteriser

Camera straight_camera(int size) {
  Camera camera;
  camera.eye = {0, 0, 2};
  camera.view_from_world = look_at(camera.eye, Vector3d::Zero(), Vector3d(0, 1, 0));
  camera.focal_px = size;
  camera.centre_px = {0.5 * size, 0.5 * size};
  return camera;
}

Surface square(double half, double z, const Vector3f& color) {
  Surface s;
  for (const auto& [x, y] : {std::pair{-1, -1}, {1, -1}, {1, 1}, {-1, 1}}) {
    s.positions.emplace_back(float(x * half), float(y * half), float(z));
    s.normals.emplace_back(0, 0, 1);
    s.colors.push_back(color);
    s.uvs.emplace_back(0.5F * float(x + 1), 0.5F * float(1 - y));
  }
  s.triangles = {0, 1, 2, 0, 2, 3};
  return s;
}

Lighting front_light() { return Lighting::for_camera(straight_camera(64), Vector3d(0, 1, 0)); }

TEST(Rasteriser, CoversTheAreaThatPerspectiveGives) {
  Rasteriser raster(64, 64, front_light());
  const Surface s = square(0.5, 0.0, Vector3f(0.5F, 0.5F, 0.5F));
  raster.draw(s, straight_camera(64));  // half a metre at 2 m with focal 64: 16 px either side
  double covered = 0.0;
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) covered += raster.pixel(x, y)[3];
  }
  EXPECT_NEAR(covered, 32.0 * 32.0, 1e-3);
  EXPECT_EQ(raster.covered(), Eigen::Vector4i(16, 16, 49, 49));
}

TEST(Rasteriser, TheNearerSurfaceHidesTheOtherInAnyOrder) {
  const Surface near = square(0.3, 0.5, Vector3f(0.9F, 0.1F, 0.1F));
  const Surface far = square(0.6, -0.5, Vector3f(0.1F, 0.1F, 0.9F));
  for (const bool near_first : {true, false}) {
    Rasteriser raster(64, 64, front_light());
    raster.draw(near_first ? near : far, straight_camera(64));
    raster.draw(near_first ? far : near, straight_camera(64));
    const Eigen::Vector4f middle = raster.pixel(32, 32), corner = raster.pixel(18, 32);
    EXPECT_GT(middle[0], middle[2]);
    EXPECT_GT(corner[2], corner[0]);
  }
}

TEST(Rasteriser, TextureIsSampledWithPerspective) {
  // Eight bands, dark and light in turn, on a square that tilts away: each band's centre in the
  // world shows its own shade where it projects to.
  TextureImage image;
  image.width = image.height = 64;
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) {
      const std::uint8_t shade = y / 8 % 2 == 0 ? 255 : 40;
      image.rgba.insert(image.rgba.end(), {shade, shade, shade, 255});
    }
  }
  const TexturePyramid pyramid = pyramid_of(image);
  const auto on_square = [](double y) { return Vector3d(0, 0.4 * y, -1.2 * y); };
  Surface s = square(1.0, 0.0, Vector3f(1, 1, 1));
  for (Vector3f& p : s.positions) p = Vector3f(p.x(), 0.4F * p.y(), -1.2F * p.y());
  s.texture = &pyramid;
  const Camera camera = straight_camera(400);
  Rasteriser raster(400, 400, front_light());
  raster.draw(s, camera);
  const double bottom = camera.project(on_square(-1)).y(), top = camera.project(on_square(1)).y();
  double shift = 0.0;
  float light = 0.0F;
  for (int band = 0; band < 8; ++band) {
    const double y = 1.0 - 2.0 * (band + 0.5) / 8.0;  // v runs down
    const double seen = camera.project(on_square(y)).y();
    const float shade = raster.pixel(200, static_cast<int>(seen))[0];
    if (band == 0) light = shade;
    if (band % 2 == 0) {
      EXPECT_NEAR(shade, light, 2.0F) << band;
    } else {
      EXPECT_LT(shade, 0.4F * light) << band;
    }
    shift = std::max(shift, std::abs(seen - (top + (bottom - top) * (band + 0.5) / 8.0)));
  }
  EXPECT_GT(shift, 30.0) << "without perspective the bands would lie elsewhere";
}

TEST(Rasteriser, NothingBehindTheEyeIsDrawn) {
  Rasteriser raster(32, 32, front_light());
  const Surface behind = square(0.5, 3.0, Vector3f(1, 1, 1));
  raster.draw(behind, straight_camera(32));
  EXPECT_EQ(raster.covered(), Eigen::Vector4i::Zero());
}

TEST(ShadowMask, LiesOnTheFloorUnderTheFigure) {
  Camera camera;
  camera.eye = {0, 3, 0.001};
  camera.view_from_world = look_at(camera.eye, Vector3d::Zero(), Vector3d(0, 0, -1));
  camera.focal_px = 90;
  camera.centre_px = {30, 30};
  ShadowMask mask(60, 60);
  Surface s = square(0.2, 0.0, Vector3f(1, 1, 1));
  for (Vector3f& p : s.positions) p = Vector3f(p.x() + 0.3F, 1.0F, p.y());
  mask.draw(s, camera, Vector3d(0, 1, 0));
  EXPECT_EQ(mask.at(39, 30), 1.0F);  // x = 0.3 m: 9 px from the centre
  EXPECT_EQ(mask.at(30, 30), 0.0F);
}

// ---------------------------------------------------------------------------- pictures

TEST(Png, WhatIsEncodedComesBack) {
  Image image;
  image.width = 7;
  image.height = 5;
  for (int i = 0; i < 7 * 5 * 3; ++i) image.rgb.push_back(static_cast<std::uint8_t>(i * 37));
  const auto png = encode_png(image);
  ASSERT_TRUE(png.ok());
  const auto back = decode_image(*png);
  ASSERT_TRUE(back.ok());
  ASSERT_EQ(back->width, 7);
  ASSERT_EQ(back->height, 5);
  for (int p = 0; p < 35; ++p) {
    for (int c = 0; c < 3; ++c) EXPECT_EQ(back->rgba[4 * p + c], image.rgb[3 * p + c]);
    EXPECT_EQ(back->rgba[4 * p + 3], 255);
  }
}

TEST(Png, BrokenPicturesAreErrors) {
  Image image;
  image.width = image.height = 64;
  for (int i = 0; i < 64 * 64 * 3; ++i) image.rgb.push_back(static_cast<std::uint8_t>(i * i));
  auto png = *encode_png(image);
  png.resize(png.size() / 2);
  EXPECT_EQ(decode_image(png).error().code, "image-broken");
  const std::vector<std::byte> jpeg = {std::byte{0xFF}, std::byte{0xD8}, std::byte{0xFF},
                                       std::byte{0x00}};
  EXPECT_EQ(decode_image(jpeg).error().code, "image-broken");
  EXPECT_EQ(decode_image({}).error().code, "image-unsupported");
  image.rgb.pop_back();
  EXPECT_EQ(encode_png(image).error().code, "png-encode");
}

// ---------------------------------------------------------------------------- view

TEST(BodyPlan, SidesAreReadFromManyWaysOfNaming) {
  for (const auto& [left, right, hips] : {std::tuple{"LeftUpLeg", "RightUpLeg", "Hips"},
                                          {"mixamorig:LeftArm", "mixamorig:RightArm", "x"},
                                          {"thigh.L", "thigh.R", "hips"},
                                          {"lThigh", "rThigh", "hip"},
                                          {"L_Hip", "R_Hip", "root"},
                                          {"Bip01 L Thigh", "Bip01 R Thigh", "Bip01 Pelvis"},
                                          {"b_l_upleg", "b_r_upleg", "b_root"}}) {
    Character c;
    c.skeleton.names = {hips, left, right};
    c.skeleton.parents = {kNoJoint, 0, 0};
    c.skeleton.rest_parent_from_joint = {DualQuaternion(),
                                         DualQuaternion::from_translation(Vector3d(0.1, 0, 0)),
                                         DualQuaternion::from_translation(Vector3d(-0.1, 0, 0))};
    const BodyPlan plan = plan_of(c);
    EXPECT_EQ(plan.sides[0], BodySide::centre) << hips;
    EXPECT_EQ(plan.sides[1], BodySide::left) << left;
    EXPECT_EQ(plan.sides[2], BodySide::right) << right;
    ASSERT_EQ(plan.pairs.size(), 1u) << left;
    EXPECT_EQ(plan.pairs[0], std::pair(1, 2));
  }
}

TEST(BodyPlan, NamelessFiguresAreReadFromTheirShape) {
  Character c = test::walker_skeleton();
  for (std::size_t i = 0; i < c.roles.size(); ++i) {
    c.roles[i].clear();
    c.skeleton.names[i] = "node" + std::to_string(i);
  }
  const BodyPlan named = plan_of(test::walker_skeleton());
  BodyPlan plan = plan_of(c);
  EXPECT_EQ(plan.sides, named.sides);
  // The same figure that looks along -Z: its left is where its feet say.
  const DualQuaternion about =
      DualQuaternion::from_rotation(Eigen::Quaterniond(Eigen::AngleAxisd(M_PI, Vector3d(0, 1, 0))));
  c.skeleton.rest_parent_from_joint[0] = about * c.skeleton.rest_parent_from_joint[0];
  EXPECT_EQ(plan_of(c).sides, named.sides);
}

TEST(BodyPlan, FingersAreToldApart) {
  Character c;
  c.skeleton.names = {"LeftHand",       "LeftHandRing1",     "LeftHandRingPinky1",
                      "LeftHandThumb1", "LeftHandThumb1End", "LeftHandIndex1"};
  c.skeleton.parents = {kNoJoint, 0, 0, 0, 3, 0};
  c.skeleton.rest_parent_from_joint.resize(6);
  const BodyPlan plan = plan_of(c);
  EXPECT_EQ(plan.fingers, (std::vector<std::int8_t>{-1, 3, 4, 0, 0, 1}));
  EXPECT_TRUE(plan.hand_only);
}

TEST(BodyPlan, OneHandOfABodyCanBeShownAlone) {
  Character c = test::walker_skeleton();
  for (const std::string side : {"left", "right"}) {
    const std::int32_t hand = c.skeleton.find(side + "Hand");
    for (const char* finger : {"ThumbProximal", "IndexProximal", "LittleProximal"}) {
      c.skeleton.names.push_back(side + finger);
      c.roles.push_back(side + finger);
      c.skeleton.parents.push_back(hand);
      c.skeleton.rest_parent_from_joint.push_back(
          DualQuaternion::from_translation(Vector3d(side == "left" ? 0.1 : -0.1, 0, 0.02)));
    }
  }
  EXPECT_FALSE(plan_of(c).hand_only);
  const BodyPlan hand = hand_plan_of(c, BodySide::right);
  EXPECT_TRUE(hand.hand_only);
  EXPECT_EQ(c.skeleton.names[hand.crop], "rightHand");
  EXPECT_EQ(std::count(hand.fingers.begin(), hand.fingers.end(), -1),
            static_cast<std::ptrdiff_t>(hand.fingers.size()) - 3);
  const std::vector<std::uint8_t> drawn = joints_below(c.skeleton, hand.crop);
  EXPECT_EQ(std::count(drawn.begin(), drawn.end(), 1), 4);
}

TEST(SheetView, FacingFollowsTheFigure) {
  const Character c = test::walker_skeleton();
  const BodyPlan plan = plan_of(c);
  std::vector<DualQuaternion> model(c.skeleton.parents.size());
  for (const double angle : {0.0, 1.0, 2.5, -2.0}) {
    std::vector<DualQuaternion> pose = c.skeleton.rest_parent_from_joint;
    pose[0] = pose[0] * DualQuaternion::from_rotation(
                            Eigen::Quaterniond(Eigen::AngleAxisd(angle, Vector3d(0, 1, 0))));
    model_from_local(c.skeleton, pose, model);
    const Vector3d facing = facing_of(plan, model);
    EXPECT_LT((facing - Vector3d(std::sin(angle), 0, std::cos(angle))).norm(), 1e-12);
  }
}

/// A flat hand of the T-pose: palm down, fingers along +X (left) or -X, thumb towards +Z.
Character flat_hand(const std::string& side, bool named) {
  Character c;
  const double s = side == "left" ? 1.0 : -1.0;
  const auto joint = [&](const std::string& name, std::int32_t parent, const Vector3d& at) {
    c.skeleton.names.push_back((named ? side : std::string()) + name);
    c.skeleton.parents.push_back(parent);
    c.skeleton.rest_parent_from_joint.push_back(DualQuaternion::from_translation(at));
  };
  joint("Hand", kNoJoint, Vector3d(0.7 * s, 1.4, 0));
  int n = 0;
  for (const char* finger : {"Thumb", "Index", "Middle", "Ring", "Little"}) {
    const std::string f = finger;
    joint(f + "Proximal", 0, Vector3d((n == 0 ? 0.03 : 0.09) * s, 0, 0.045 - 0.02 * n));
    const auto base = c.skeleton.size() - 1;
    joint(f + "Intermediate", base, Vector3d(0.04 * s, -0.004, 0));  // a little curled
    joint(f + "Distal", base + 1, Vector3d(0.03 * s, -0.008, 0));
    ++n;
  }
  return c;
}

TEST(SheetView, AHandIsSeenFromItsBackWithTheFingersUp) {
  for (const char* side : {"left", "right"}) {
    for (const bool named : {true, false}) {
      const Character c = flat_hand(side, named);
      const BodyPlan plan = plan_of(c);
      EXPECT_TRUE(plan.hand_only);
      EXPECT_FALSE(plan.stands);
      std::vector<DualQuaternion> model(c.skeleton.parents.size());
      model_from_local(c.skeleton, c.skeleton.rest_parent_from_joint, model);
      const ViewDirection view = front_view(c.skeleton, plan, model);
      EXPECT_GT(view.towards_eye.y(), 0.7) << side << named << ": the back of the hand is up";
      EXPECT_GT(view.towards_eye.z(), 0.1) << "a little from the thumb's side";
      EXPECT_GT(view.up.x() * (side[0] == 'l' ? 1.0 : -1.0), 0.9);
      EXPECT_GT(side_view(c.skeleton, plan, model).towards_eye.z(), 0.7);
    }
  }
}

struct Fixture {
  Character source = test::walker_skeleton(), target = test::walker_with_mesh();
  Clip clip = test::walk_clip(source.skeleton, 150, 50.0);
  ContactSheet sheet;

  Fixture() {
    sheet.title = "walk@hero \xC3\xA4";
    sheet.verdict = "pass";
    sheet.key_figures = {"limits 0", "slide 1.0 cm/s"};
    sheet.source = {&source, &clip, "walk.bvh", 1.0, Vector3d::Zero()};
    sheet.target = {&target, &clip, "hero.glb", 1.0, Vector3d::Zero()};
    for (int f = 0; f < 150; ++f) {
      sheet.error_mm.push_back(f == 77 ? 9.0 : 1.0 + 0.5 * std::sin(f * 0.2));
      sheet.left_contact.push_back(f % 50 < 25);
      sheet.right_contact.push_back(f % 50 >= 22);
    }
  }
};

TEST(SheetView, FramesAreTheEndsTheWorstAndTheExtremes) {
  const Fixture f;
  const auto frames = choose_frames(f.sheet, plan_of(f.target), 10);
  ASSERT_EQ(frames.size(), 10u);
  EXPECT_TRUE(std::is_sorted(frames.begin(), frames.end()));
  EXPECT_EQ(frames.front(), 0);
  EXPECT_EQ(frames.back(), 149);
  EXPECT_TRUE(std::count(frames.begin(), frames.end(), 77));
  EXPECT_TRUE(std::adjacent_find(frames.begin(), frames.end()) == frames.end());
}

TEST(SheetView, APoseUnlikeAllOthersIsDrawn) {
  Fixture f;
  f.sheet.error_mm.clear();
  for (const std::int64_t frame : {31, 32, 33}) {  // arms thrown up for three frames
    for (const char* arm : {"leftUpperArm", "rightUpperArm"}) {
      DualQuaternion& q = f.clip.frame(frame)[f.source.skeleton.find(arm)];
      q = DualQuaternion::from_rotation_translation(
          rotation_exp(Vector3d(0, 0, arm[0] == 'l' ? 1.4 : -1.4)), q.translation());
    }
  }
  const auto frames = choose_frames(f.sheet, plan_of(f.target), 10);
  EXPECT_TRUE(
      std::any_of(frames.begin(), frames.end(), [](std::int64_t k) { return k >= 31 && k <= 33; }));
}

TEST(SheetView, ShortClipsShowEveryFrameOnce) {
  Fixture f;
  f.clip.parent_from_joint.resize(static_cast<std::size_t>(f.clip.joints) * 4);
  f.sheet.error_mm.resize(4);
  EXPECT_EQ(choose_frames(f.sheet, plan_of(f.target), 10), (std::vector<std::int64_t>{0, 1, 2, 3}));
  f.clip.parent_from_joint.resize(static_cast<std::size_t>(f.clip.joints));
  EXPECT_EQ(choose_frames(f.sheet, plan_of(f.target), 10), (std::vector<std::int64_t>{0}));
}

TEST(SheetView, FramesArePairedByTime) {
  Clip target, source;
  target.joints = source.joints = 1;
  target.parent_from_joint.resize(61);
  target.rate_hz = 30.0;
  source.parent_from_joint.resize(241);
  source.rate_hz = 120.0;
  EXPECT_EQ(frame_at_same_time(target, 30, source), 120);
  source.start_s = target.start_s = 1.0 / 120.0;
  EXPECT_EQ(frame_at_same_time(target, 30, source), 120);
  target.start_s = 0.5 + 1.0 / 120.0;  // a range cut out of the source keeps its time stamps
  target.parent_from_joint.resize(31);
  EXPECT_EQ(frame_at_same_time(target, 0, source), 60);
}

TEST(RowCamera, EverythingIncludedFits) {
  const ViewDirection view{Vector3d(0.5, 0.25, 0.8).normalized(), Vector3d(0, 1, 0), true};
  RowCamera row(view, 200, 300);
  const Vector3d anchor(5, 0.9, -3);
  const std::vector<Vector3d> points = {
      {4.4, 0, -3}, {5.7, 1.7, -3}, {5, 1.9, -2.2}, {5, 0.1, -3.9}};
  row.include(points, anchor);
  const std::int32_t height = row.fit();
  EXPECT_LE(height, 300);
  for (const Vector3d& p : points) {
    const Vector3d seen = row.at(anchor).project(p);
    EXPECT_GT(seen.x(), 5.0);
    EXPECT_LT(seen.x(), 195.0);
    EXPECT_GT(seen.y(), 5.0);
    EXPECT_LT(seen.y(), height - 5.0);
  }
  // The camera follows along the floor, not up and down.
  const Vector3d moved = row.at(anchor + Vector3d(2, 0.3, 1)).project(Vector3d(7, 0, -2));
  EXPECT_LT((moved - row.at(anchor).project(Vector3d(5, 0, -3))).norm(), 1e-9);
}

// ---------------------------------------------------------------------------- the sheet

TEST(ContactSheet, IsTheSameEveryTime) {
  const Fixture f;
  const auto a = render_contact_sheet(f.sheet), b = render_contact_sheet(f.sheet);
  ASSERT_TRUE(a.ok() && b.ok());
  EXPECT_EQ(a->rgb, b->rgb);
  EXPECT_GE(a->width, 1800);
  EXPECT_LE(a->width, 2400);
}

/// Pixels near a colour.
std::int64_t count_of(const Image& image, int r, int g, int b, int tolerance) {
  std::int64_t n = 0;
  for (std::size_t i = 0; i < image.rgb.size(); i += 3) {
    n += std::abs(image.rgb[i] - r) < tolerance && std::abs(image.rgb[i + 1] - g) < tolerance &&
         std::abs(image.rgb[i + 2] - b) < tolerance;
  }
  return n;
}

TEST(ContactSheet, MarksAndContactsShowOnlyWhereGiven) {
  Fixture f;
  f.sheet.error_mm.clear();
  const auto without = render_contact_sheet(f.sheet);
  f.sheet.marks.assign(150, {{Vector3d(0.5, 1.0, 0), Vector3d(0.4, 1.0, 0)}});
  const auto with = render_contact_sheet(f.sheet);
  ASSERT_TRUE(without.ok() && with.ok());
  EXPECT_GT(count_of(*with, 214, 40, 40, 12), count_of(*without, 214, 40, 40, 12) + 200);
  EXPECT_GT(count_of(*with, 28, 160, 80, 12), count_of(*without, 28, 160, 80, 12) + 50);
  f.sheet.left_contact.clear();
  f.sheet.right_contact.clear();
  const auto bare = render_contact_sheet(f.sheet);
  ASSERT_TRUE(bare.ok());
  EXPECT_LT(bare->height, with->height);
}

TEST(ContactSheet, LimitBarsAreAsLongAsTheShare) {
  Fixture f;
  const auto tinted = [&](double share) {
    f.sheet.at_limit = {{"leftUpperArm", share}};
    const auto image = render_contact_sheet(f.sheet);
    EXPECT_TRUE(image.ok());
    return double(count_of(*image, 150, 60, 220, 12));
  };
  const double full = tinted(1.0);
  EXPECT_GT(full, 1000.0);
  EXPECT_NEAR(tinted(0.5) / full, 0.5, 0.02);
}

TEST(ContactSheet, TheSourcesBonesLieOverTheTarget) {
  Fixture f;
  const auto ghost_pixels = [&](double scale) {
    f.sheet.ghost_scale = scale;
    const auto image = render_contact_sheet(f.sheet);
    EXPECT_TRUE(image.ok());
    return count_of(*image, 24, 52, 110, 14);
  };
  const auto none = ghost_pixels(0.0), small = ghost_pixels(0.5), full = ghost_pixels(1.0);
  EXPECT_GT(small, none + 200);
  EXPECT_GT(full, small + 200);
}

TEST(ContactSheet, SwappedSidesLookDifferent) {
  const Fixture f;
  Fixture swapped;
  for (std::string* names : {swapped.source.skeleton.names.data(), swapped.source.roles.data()}) {
    for (int k = 0; k < 7; ++k) std::swap(names[5 + k], names[12 + k]);
  }
  const auto a = render_contact_sheet(f.sheet), b = render_contact_sheet(swapped.sheet);
  ASSERT_TRUE(a.ok() && b.ok());
  EXPECT_NE(a->rgb, b->rgb);
}

TEST(ContactSheet, TargetAloneAndBadInput) {
  Fixture f;
  f.sheet.source = {};
  EXPECT_TRUE(render_contact_sheet(f.sheet).ok());
  f.clip.joints = 3;
  EXPECT_EQ(render_contact_sheet(f.sheet).error().code, "sheet-input");
  f.sheet.target.clip = nullptr;
  EXPECT_EQ(render_contact_sheet(f.sheet).error().code, "sheet-input");
}

TEST(ContactSheet, BrokenPosesDoNotBreakTheSheet) {
  Fixture f;
  for (DualQuaternion& q : f.clip.frame(40)) q.dual.x() = std::nan("");
  f.sheet.frames = {0, 40, 149};
  EXPECT_TRUE(render_contact_sheet(f.sheet).ok());
}

}  // namespace
}  // namespace limber
