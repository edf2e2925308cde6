// limber pose: what it reaches, recomputed with kinematics and limits of this file's own; what it
// draws, projected by this file's own pinhole.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <span>

#include "tests/pipeline/program.h"
#include "tests/pipeline/rig_kinematics.h"
#include "validation/image_io.h"

namespace {

using Eigen::Vector2d;
using limber_test::Folder;
using limber_test::limber;
using limber_test::text_of;
using limber_test::write_text;
using nlohmann::json;
using namespace limber_test::kinematics;

// ---- poses as the program tells them

json shipped_targets(const std::string& name) {
  return json::parse(text_of(limber_test::source_root() / "assets/data/poses" / (name + ".json")));
}

Coordinates coordinates_of(const json& pose) {
  Coordinates q;
  for (const json& joint : pose["joints"]) q.push_back(joint["q"].get<std::vector<double>>());
  return q;
}

json solved(const std::string& rig, const json& targets, const std::vector<std::string>& more = {},
            int exit_code = 0) {
  const Folder folder;
  write_text(folder / "targets.json", targets.dump());
  std::vector<std::string> words = {"pose", rig, "--targets", (folder / "targets.json").string(),
                                    "--json"};
  words.insert(words.end(), more.begin(), more.end());
  const auto run = limber(words);
  EXPECT_EQ(run.exit_code, exit_code) << run.out;
  return json::parse(run.out, nullptr, false);
}

json targets_of(const json& poses) { return {{"format", "limber/targets/1"}, {"poses", poses}}; }

json hand_pose(const json& rows) {
  return targets_of(json::array({{{"name", "p"}, {"targets", rows}}}));
}

/// Limits kept and errors as stated, by this file's own kinematics.
void expect_honest(const json& rig, const json& pose) {
  const Coordinates q = coordinates_of(pose);
  for (std::size_t j = 0; j < q.size(); ++j) {
    EXPECT_LT(excess_of(rig["joints"][j], q[j]), 1e-6) << rig["joints"][j]["name"];
  }
  const std::vector<Eigen::Isometry3d> world = world_of(rig, q);
  for (const json& effector : pose["effectors"]) {
    const auto row = std::find_if(rig["effectors"].begin(), rig["effectors"].end(),
                                  [&](const json& e) { return e["name"] == effector["name"]; });
    ASSERT_NE(row, rig["effectors"].end());
    const Eigen::Isometry3d& joint = world[(*row)["joint"].get<std::size_t>()];
    const Vector3d reached = joint * vector_of((*row)["offset"]);
    EXPECT_LT((reached - vector_of(effector["reached"]["position"])).norm(), 1e-9);
    if (effector["target"].contains("position")) {
      const double miss = (reached - vector_of(effector["target"]["position"])).norm();
      EXPECT_NEAR(effector["position_error_mm"].get<double>(), 1e3 * miss, 1e-6);
    }
    if (effector["target"].contains("rotation")) {
      const double angle = Quaterniond(joint.rotation())
                               .angularDistance(quaternion_of(effector["target"]["rotation"]));
      EXPECT_NEAR(effector["orientation_error_deg"].get<double>(), angle / kRadians, 1e-4);
    }
  }
  EXPECT_EQ(pose["limits"]["violations"], 0);
}

/// A fixed sequence in [0, 1), the same everywhere.
class Sequence {
 public:
  double next() {
    state_ = state_ * 6364136223846793005ULL + 1442695040888963407ULL;
    return static_cast<double>(state_ >> 11) * 0x1p-53;
  }
  double between(double low, double high) { return low + next() * (high - low); }

 private:
  std::uint64_t state_ = 20130612;
};

/// Well inside the limits: a share of every range, balls by swing alone.
Coordinates inside_limits(const json& rig, Sequence& sequence, double share) {
  Coordinates q;
  for (const json& joint : rig["joints"]) {
    std::vector<double> values(dof_of(joint), 0.0);
    const auto pick = [&](const json& range) {
      const double low = range[0], high = range[1], middle = 0.5 * (low + high);
      return middle + sequence.between(-share, share) * 0.5 * (high - low);
    };
    if (joint["type"] == "hinge" || joint["type"] == "universal") {
      for (std::size_t k = 0; k < values.size(); ++k) values[k] = pick(joint["limits"][k]);
    } else if (joint["type"] == "ball") {
      Vector3d v = Vector3d::Zero();
      for (int k = 0; k < 2; ++k) {
        const json& range = joint["twist_swing"][k == 0 ? "swing0" : "swing1"];
        const double half = 0.6 * share;  // both together stay within the ellipse
        const double bound = sequence.next() < 0.5 ? range[0] : range[1];
        v += sequence.between(0.0, half) * bound * vector_of(joint["axes"][k]);
      }
      values = {v.x(), v.y(), v.z()};
    }
    q.push_back(values);
  }
  return q;
}

json frames_at(const json& rig, const Coordinates& q) {
  const std::vector<Eigen::Isometry3d> world = world_of(rig, q);
  json rows = json::array();
  for (const json& effector : rig["effectors"]) {
    const Eigen::Isometry3d& joint = world[effector["joint"].get<std::size_t>()];
    rows.push_back({{"effector", effector["name"]},
                    {"position", json_of(Vector3d(joint * vector_of(effector["offset"])))},
                    {"rotation", json_of(Quaterniond(joint.rotation()))}});
  }
  return rows;
}

TEST(Pose, ReachesWhatForwardKinematicsGives) {
  for (const auto& [name, share] : {std::pair{"hand", 0.8}, std::pair{"biped-foot-root", 0.5}}) {
    const json rig = rig_file(name);
    Sequence sequence;
    json poses = json::array();
    for (int i = 0; i < 4; ++i) {
      const Coordinates q = inside_limits(rig, sequence, share);
      for (std::size_t j = 0; j < q.size(); ++j) ASSERT_LE(excess_of(rig["joints"][j], q[j]), 0.0);
      poses.push_back({{"name", std::to_string(i)}, {"targets", frames_at(rig, q)}});
    }
    const json out = solved(name, targets_of(poses));
    ASSERT_EQ(out["poses"].size(), poses.size());
    for (const json& pose : out["poses"]) {
      EXPECT_EQ(pose["status"], "reached") << name << " " << pose["name"];
      expect_honest(rig, pose);
      for (const json& effector : pose["effectors"]) {
        EXPECT_LT(effector["position_error_mm"].get<double>(), 0.1) << effector["name"];
        EXPECT_LT(effector["orientation_error_deg"].get<double>(), 0.05) << effector["name"];
        EXPECT_EQ(effector["reachable"], true);
      }
    }
  }
}

TEST(Pose, OutOfReachStretchesTowardsTheTargetAndIsNoFailure) {
  // A two-link arm: from the shoulder it reaches its length and no further, so the best it can do
  // is to point at the target; what is missing is the rest of the distance.
  const json rig = rig_file("arm2");
  const Vector3d shoulder = vector_of(rig["joints"][0]["offset"]);
  const double length = vector_of(rig["joints"][1]["offset"]).norm() +
                        vector_of(rig["effectors"][0]["offset"]).norm();
  const Vector3d target = shoulder + 1.4 * length * Vector3d(0.9, -0.2, 0.3).normalized();
  const json out =
      solved("arm2", hand_pose({{{"effector", "hand"}, {"position", json_of(target)}}}));
  const json& pose = out["poses"][0];
  EXPECT_EQ(pose["status"], "best reach");
  EXPECT_EQ(pose["effectors"][0]["reachable"], false);
  EXPECT_NEAR(pose["effectors"][0]["position_error_mm"].get<double>(), 400.0 * length, 0.01);
  expect_honest(rig, pose);
  ASSERT_EQ(pose["limits"]["at_border"].size(), 1U);  // the elbow is straight
  EXPECT_EQ(pose["limits"]["at_border"][0]["coordinate"], "angle");
  EXPECT_EQ(pose["limits"]["at_border"][0]["side"], "min");
}

TEST(Pose, ShippedTargetsAreWhatTheirDescriptionsSay) {
  const json hand = rig_file("hand"), biped = rig_file("biped-foot-root");
  const auto judge = [](const json& rig, const std::string& rig_name, const std::string& targets,
                        std::size_t out_of_reach_from) {
    const auto run = limber({"pose", rig_name, "--targets", targets, "--json"});
    ASSERT_EQ(run.exit_code, 0);
    const json out = json::parse(run.out);
    for (std::size_t i = 0; i < out["poses"].size(); ++i) {
      const json& pose = out["poses"][i];
      expect_honest(rig, pose);
      EXPECT_EQ(pose["status"], i < out_of_reach_from ? "reached" : "best reach") << pose["name"];
      double worst = 0.0;
      bool reachable = true;
      for (const json& e : pose["effectors"]) {
        worst = std::max(worst, e["position_error_mm"].get<double>());
        reachable = reachable && e["reachable"].get<bool>();
      }
      EXPECT_EQ(reachable, i < out_of_reach_from) << pose["name"];
      if (i >= out_of_reach_from) {
        EXPECT_GT(worst, 10.0) << pose["name"];
      }
    }
  };
  judge(hand, "hand", "hand-poses", 6);
  judge(hand, "hand", "hand-out-of-reach", 0);
  judge(biped, "biped-foot-root", "biped-foot-root-poses", 4);
}

TEST(Pose, ShippedPosturesAreWithinTheLimits) {
  for (const auto& [targets, rig_name] :
       {std::pair{"hand-poses", "hand"}, std::pair{"biped-foot-root-poses", "biped-foot-root"}}) {
    const json rig = rig_file(rig_name), file = shipped_targets(targets);
    for (const json& pose : file["poses"]) {
      for (const json& joint : rig["joints"]) {
        const std::string name = joint["name"];
        if (!pose.contains("posture") || !pose["posture"].contains(name)) continue;
        std::vector<double> q;
        for (const double degrees : pose["posture"][name]) q.push_back(kRadians * degrees);
        EXPECT_LE(excess_of(joint, q), 1e-9) << pose["name"] << " " << name;
      }
    }
  }
}

TEST(Pose, PostureOffsetAndTurnMeanWhatTheySay) {
  const json rig = rig_file("hand");
  Coordinates q;
  for (const json& joint : rig["joints"]) q.emplace_back(dof_of(joint), 0.0);
  q[4] = {10 * kRadians, 30 * kRadians};  // rightIndexProximal
  const json at = frames_at(rig, q);
  const json relative = {
      {"name", "relative"},
      {"posture", {{"rightIndexProximal", {10, 30}}}},
      {"targets",
       {{{"effector", "index_tip"}, {"offset", {0.01, -0.02, 0.005}}, {"turn_deg", {0, 0, -20}}}}}};
  const json out = solved("hand", targets_of(json::array({relative})));
  const json& target = out["poses"][0]["effectors"][0]["target"];
  const Vector3d expected = vector_of(at[1]["position"]) + Vector3d(0.01, -0.02, 0.005);
  const Quaterniond turned =
      Eigen::AngleAxisd(-20 * kRadians, Vector3d::UnitZ()) * quaternion_of(at[1]["rotation"]);
  EXPECT_LT((vector_of(target["position"]) - expected).norm(), 1e-12);
  EXPECT_LT(quaternion_of(target["rotation"]).angularDistance(turned), 1e-9);
  EXPECT_EQ(out["poses"][0]["effectors"].size(), 1U) << "who is not named has no say";
}

TEST(Pose, HeldEffectorsStayAtRest) {
  json targets = targets_of(json::array({{{"name", "held"}, {"targets", json::array()}}}));
  targets["hold"] = {"thumb_tip", "index_tip", "middle_tip", "ring_tip", "little_tip"};
  const json out = solved("hand", targets);
  const json& pose = out["poses"][0];
  EXPECT_EQ(pose["effectors"].size(), 5U);
  EXPECT_EQ(pose["solver"]["relinearisations"], 0);
  for (const auto& joint : coordinates_of(pose)) {
    for (const double value : joint) EXPECT_NEAR(value, 0.0, 1e-12);
  }
}

TEST(Pose, WeightZeroHasNoSay) {
  const json pull = {{"effector", "index_tip"}, {"offset", {-0.03, -0.04, 0}}};
  const json idle = {{"effector", "thumb_tip"}, {"position", {9, 9, 9}}, {"weight", 0}};
  const json out =
      solved("hand",
             targets_of(json::array({{{"name", "alone"}, {"targets", json::array({pull})}},
                                     {{"name", "idle"}, {"targets", json::array({pull, idle})}}})));
  EXPECT_GT(out["poses"][0]["solver"]["relinearisations"], 0);
  EXPECT_EQ(out["poses"][0]["joints"], out["poses"][1]["joints"]);
  EXPECT_EQ(out["poses"][1]["status"], "reached");
}

TEST(Pose, StartPreviousGoesOnFromTheLastAnswer) {
  const json row = {{"effector", "index_tip"}, {"offset", {-0.03, -0.04, 0}}};
  const auto pose = [&](const char* start) {
    return json{{"name", start}, {"start", start}, {"targets", {row}}};
  };
  const json out = solved("hand", targets_of({pose("rest"), pose("previous"), pose("rest")}));
  const auto iterations = [&](int i) { return out["poses"][i]["solver"]["relinearisations"]; };
  EXPECT_GT(iterations(0), 0);
  EXPECT_EQ(iterations(1), 0);
  EXPECT_EQ(iterations(2), iterations(0));
  EXPECT_EQ(out["poses"][0]["joints"], out["poses"][2]["joints"]);
}

TEST(Pose, ReachableDoesNotDependOnTheSolver) {
  // The fist lies far from rest: plain Gauss-Seidel may end in a corner, and says so; the targets
  // can be reached all the same.
  for (const char* solver : {"pgs", "pgs-paper", "ceres"}) {
    const auto run =
        limber({"pose", "hand", "--targets", "hand-poses", "--solver", solver, "--json"});
    ASSERT_EQ(run.exit_code, 0);
    const json out = json::parse(run.out);
    EXPECT_EQ(out["solver"], solver);
    for (const json& pose : out["poses"]) {
      expect_honest(rig_file("hand"), pose);
      for (const json& e : pose["effectors"]) {
        EXPECT_EQ(e["reachable"], true) << solver << " " << pose["name"] << " " << e["name"];
      }
    }
  }
}

TEST(Pose, ExamplesOfEveryRigAreAccepted) {
  for (const char* rig :
       {"arm2", "arm3", "biped", "biped-foot-root", "biped-full", "biped-hands", "hand"}) {
    const auto example = limber({"pose", rig, "--example"});
    ASSERT_EQ(example.exit_code, 0) << rig;
    const json out = solved(rig, json::parse(example.out));
    ASSERT_EQ(out["poses"].size(), 4U) << rig;
    EXPECT_EQ(out["poses"][0]["status"], "reached") << rig;
    EXPECT_EQ(out["poses"][1]["status"], "reached") << rig << ": a posture within the limits";
    EXPECT_EQ(out["poses"][3]["status"], "best reach") << rig;
  }
}

TEST(Pose, CharactersGetEffectorsOfTheirRoles) {
  const std::string clip = limber_test::own_clip("body_range_of_motion.bvh").string();
  const auto example = limber({"pose", clip, "--example"});
  ASSERT_EQ(example.exit_code, 0);
  const json targets = json::parse(example.out);
  const auto held = targets["hold"].get<std::vector<std::string>>();
  for (const char* name : {"pelvis", "head", "l_hand", "r_foot", "l_thumb_tip", "r_little_tip"}) {
    EXPECT_NE(std::find(held.begin(), held.end(), name), held.end()) << name;
  }
  const Folder folder;
  const std::string sheet = (folder / "sheet.png").string();
  EXPECT_EQ(solved(clip, targets, {"-o", sheet})["poses"][0]["status"], "reached");
  EXPECT_TRUE(std::filesystem::exists(sheet));
}

// ---- the sheet

struct Picture {
  limber::TextureImage image;
  std::array<int, 3> at(const Vector2d& p) const {
    const auto x = static_cast<int>(p.x()), y = static_cast<int>(p.y());
    if (x < 0 || y < 0 || x >= image.width || y >= image.height) return {0, 0, 0};
    const std::uint8_t* c = &image.rgba[4 * (std::size_t(y) * image.width + x)];
    return {c[0], c[1], c[2]};
  }
  bool red(const Vector2d& p) const {
    const auto c = at(p);
    return c[0] > 170 && c[1] < 90 && c[2] < 90;
  }
  bool green(const Vector2d& p) const {
    const auto c = at(p);
    return c[0] < 90 && c[1] > 130 && c[2] < 130;
  }
};

Picture picture_of(const std::string& file) {
  const std::string bytes = text_of(file);
  auto image = limber::decode_image(std::as_bytes(std::span(bytes.data(), bytes.size())));
  EXPECT_TRUE(image.ok());
  return {image.ok() ? std::move(*image) : limber::TextureImage{}};
}

Vector2d projected(const json& view, const Vector3d& world) {
  const Vector3d d = world - vector_of(view["eye"]);
  const double depth = -vector_of(view["back"]).dot(d), focal = view["focal_px"];
  return Vector2d(view["centre_px"][0], view["centre_px"][1]) +
         focal / depth * Vector2d(vector_of(view["right"]).dot(d), -vector_of(view["up"]).dot(d));
}

struct Spots {
  std::vector<Vector2d> targets, reached;
};

Spots spots_of(const json& view, const json& pose) {
  Spots spots;
  for (const json& e : pose["effectors"]) {
    spots.targets.push_back(projected(view, vector_of(e["target"]["position"])));
    spots.reached.push_back(projected(view, vector_of(e["reached"]["position"])));
  }
  return spots;
}

/// How far the nearest other mark is.
double room_about(const Spots& spots, std::size_t i, const Vector2d& p) {
  double room = 1e9;
  for (std::size_t k = 0; k < spots.targets.size(); ++k) {
    if (k == i) continue;
    room = std::min({room, (spots.targets[k] - p).norm(), (spots.reached[k] - p).norm()});
  }
  return room;
}

TEST(PoseSheet, RedAndGreenStandWhereTargetsAndEffectorsProject) {
  for (const auto& [rig, targets] :
       {std::pair{"hand", "hand-out-of-reach"}, std::pair{"hand", "hand-poses"},
        std::pair{"biped-foot-root", "biped-foot-root-poses"}}) {
    const Folder folder;
    const std::string sheet = (folder / "sheet.png").string();
    const auto run = limber({"pose", rig, "--targets", targets, "-o", sheet, "--json"});
    ASSERT_EQ(run.exit_code, 0);
    const json out = json::parse(run.out);
    const Picture picture = picture_of(sheet);
    ASSERT_EQ(picture.image.width, out["sheet"]["width"].get<int>());
    int apart = 0, together = 0;
    for (const json& view : out["sheet"]["views"]) {
      const Spots spots = spots_of(view, out["poses"][view["pose"].get<std::size_t>()]);
      for (std::size_t i = 0; i < spots.targets.size(); ++i) {
        const Vector2d &target = spots.targets[i], &reached = spots.reached[i];
        for (const int k : {0, 1}) {
          const double low = view["box"][k], size = view["box"][k + 2];
          EXPECT_GT(target[k], low);
          EXPECT_LT(target[k], low + size);
        }
        const bool alone = room_about(spots, i, target) > 60 && room_about(spots, i, reached) > 60;
        if (!alone) continue;
        EXPECT_TRUE(picture.green(reached)) << targets << " " << i;
        if ((target - reached).norm() > 40.0) {
          ++apart;
          EXPECT_TRUE(picture.red(target)) << targets << " " << i;
        } else if ((target - reached).norm() < 0.5) {
          ++together;  // a red rim around the green
          bool rim = false;
          for (int a = 0; a < 24; ++a) {
            const double angle = a * M_PI / 12.0;
            rim = rim || picture.red(target + 6.3 * Vector2d(std::cos(angle), std::sin(angle)));
          }
          EXPECT_TRUE(rim) << targets << " " << i;
        }
      }
    }
    EXPECT_GE(apart + together, 5) << targets;
    if (std::string(targets) == "hand-out-of-reach") {
      EXPECT_GE(apart, 5);
    }
  }
}

TEST(PoseSheet, AndAnswerAreTheSameEveryTime) {
  const Folder folder;
  const std::string sheet = (folder / "sheet.png").string();
  const auto draw = [&] {
    const auto run =
        limber({"pose", "hand", "--targets", "hand-out-of-reach", "-o", sheet, "--json"});
    EXPECT_EQ(run.exit_code, 0);
    return run.out + text_of(sheet);
  };
  EXPECT_EQ(draw(), draw());
}

}  // namespace
