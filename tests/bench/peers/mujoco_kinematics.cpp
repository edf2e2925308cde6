#include <fmt/format.h>
#include <mujoco/mujoco.h>

#include <cstdio>
#include <cstring>

#include "tests/bench/peers/kinematics.h"

namespace limber::peers {

namespace {

struct FreeModel {
  void operator()(mjModel* model) const { mj_deleteModel(model); }
};
struct FreeData {
  void operator()(mjData* data) const { mj_deleteData(data); }
};

std::string numbers(const Eigen::Vector3d& v) {
  return fmt::format("{:.17g} {:.17g} {:.17g}", v.x(), v.y(), v.z());
}

std::string joint_elements(const RigJoint& joint) {
  switch (joint.type) {
    case JointType::fixed:
      return "";
    case JointType::hinge:
    case JointType::universal: {
      std::string text;
      for (int k = 0; k < dof_count(joint.type); ++k) {
        text += fmt::format("<joint type=\"hinge\" axis=\"{}\"/>", numbers(joint.axes[k]));
      }
      return text;
    }
    case JointType::ball:
      return "<joint type=\"ball\"/>";
    case JointType::free:
      return "<freejoint/>";
  }
  return "";
}

/// A body with its children. The inertia is never used, but a moving body must have one.
std::string body_element(const Rig& rig, std::int32_t i) {
  const RigJoint& joint = rig.joints[i];
  const Eigen::Quaterniond& r = joint.rest;
  std::string text =
      fmt::format("<body name=\"j{}\" pos=\"{}\" quat=\"{:.17g} {:.17g} {:.17g} {:.17g}\">", i,
                  numbers(joint.offset), r.w(), r.x(), r.y(), r.z()) +
      "<inertial pos=\"0 0 0\" mass=\"1\" diaginertia=\"1 1 1\"/>" + joint_elements(joint);
  for (std::size_t e = 0; e < rig.effectors.size(); ++e) {
    if (rig.effectors[e].joint != i) continue;
    text += fmt::format("<site name=\"e{}\" pos=\"{}\"/>", e, numbers(rig.effectors[e].offset));
  }
  for (std::int32_t child = i + 1; child < rig.size(); ++child) {
    if (rig.joints[child].parent == i) text += body_element(rig, child);
  }
  return text + "</body>";
}

std::string mjcf(const Rig& rig) {
  std::string text = "<mujoco><size njmax=\"1\" nconmax=\"1\" nstack=\"100000\"/><worldbody>";
  for (std::int32_t i = 0; i < rig.size(); ++i) {
    if (rig.joints[i].parent == kNoJoint) text += body_element(rig, i);
  }
  return text + "</worldbody></mujoco>";
}

mjModel* load(const std::string& text) {
  const auto files = std::make_unique<mjVFS>();  // two megabytes
  mj_defaultVFS(files.get());
  mj_makeEmptyFileVFS(files.get(), "rig.xml", static_cast<int>(text.size()));
  std::memcpy(files->filedata[0], text.data(), text.size());
  char fault[1000] = "";
  mjModel* model = mj_loadXML("rig.xml", files.get(), fault, sizeof fault);
  if (model == nullptr) fmt::print(stderr, "MuJoCo: {}\n", fault);
  mj_deleteVFS(files.get());
  return model;
}

/// MuJoCo numbers bodies and coordinates in an order of its own; a joint finds its by name.
class MujocoKinematics : public Kinematics {
 public:
  MujocoKinematics(const Coordinates& coordinates, mjModel* model)
      : Kinematics(coordinates), model_(model), data_(mj_makeData(model)) {
    const Rig& rig = coordinates.rig();
    for (std::int32_t i = 0; i < rig.size(); ++i) {
      body_.push_back(mj_name2id(model, mjOBJ_BODY, fmt::format("j{}", i).c_str()));
    }
    for (std::size_t e = 0; e < rig.effectors.size(); ++e) {
      site_.push_back(mj_name2id(model, mjOBJ_SITE, fmt::format("e{}", e).c_str()));
      std::vector<int> dofs;
      for (const std::int32_t i : joints(e)) {
        const int begin = model->body_dofadr[body_[i]];
        for (int k = 0; k < dof_count(rig.joints[i].type); ++k) dofs.push_back(begin + k);
      }
      dofs_.push_back(std::move(dofs));
    }
    ball_.resize(rig.joints.size());
    scratch_.resize(6, model->nv);
  }

  void set(const State& state) override {
    const Rig& rig = coordinates_.rig();
    for (std::int32_t i = 0; i < rig.size(); ++i) {
      const RigJoint& joint = rig.joints[i];
      if (joint.type == JointType::fixed) continue;
      const double* q = state.q.data() + coordinates_.begin(i);
      mjtNum* to = data_->qpos + model_->jnt_qposadr[model_->body_jntadr[body_[i]]];
      if (joint.type == JointType::free) {
        const Eigen::Vector3d at = joint.offset + Eigen::Vector3d(q[0], q[1], q[2]);
        std::copy(at.data(), at.data() + 3, to);
        write(joint.rest * state.turn, to + 3);
      } else if (joint.type == JointType::ball) {
        write(coordinates_.rotation(i, state), to);
      } else {
        std::copy(q, q + dof_count(joint.type), to);
      }
    }
    mj_kinematics(model_.get(), data_.get());
  }

  Eigen::Vector3d position(std::size_t e) const override {
    return Eigen::Vector3d::Map(data_->site_xpos + 3 * site_[e]);
  }

  Eigen::Quaterniond rotation(std::size_t e) const override {
    // A site's space is its body's here, and the body's quaternion is at hand.
    const mjtNum* q = data_->xquat + 4 * body_[coordinates_.rig().effectors[e].joint];
    return {q[0], q[1], q[2], q[3]};
  }

  void prepare_jacobian(const State& state) override {
    mj_comPos(model_.get(), data_.get());
    const Rig& rig = coordinates_.rig();
    for (std::int32_t i = 0; i < rig.size(); ++i) {
      if (rig.joints[i].type == JointType::ball) ball_[i] = coordinates_.ball_columns(i, state);
    }
  }

  void jacobian(std::size_t e, ChainJacobian& jacobian) override {
    mj_jacSite(model_.get(), data_.get(), scratch_.data(), scratch_.data() + 3 * model_->nv,
               site_[e]);
    Eigen::Index column = 0;
    for (const std::int32_t i : joints(e)) {
      const RigJoint& joint = coordinates_.rig().joints[i];
      const Eigen::Index n = dof_count(joint.type);
      const int from = dofs_[e][static_cast<std::size_t>(column)];
      if (joint.type == JointType::ball) {
        // MuJoCo's ball turns in the joint's own space; ours has a column per swing and twist.
        jacobian.middleCols<3>(column).noalias() = scratch_.middleCols<3>(from) * ball_[i];
      } else {
        jacobian.middleCols(column, n) = scratch_.middleCols(from, n);
      }
      column += n;
    }
  }

 private:
  static void write(const Eigen::Quaterniond& r, mjtNum* to) {
    to[0] = r.w();
    to[1] = r.x();
    to[2] = r.y();
    to[3] = r.z();
  }

  std::unique_ptr<mjModel, FreeModel> model_;
  std::unique_ptr<mjData, FreeData> data_;
  std::vector<int> body_;               // [joint]
  std::vector<int> site_;               // [effector]
  std::vector<std::vector<int>> dofs_;  // [effector] MuJoCo's coordinates along the chain
  std::vector<Eigen::Matrix3d> ball_;   // [joint]
  Eigen::Matrix<double, 6, Eigen::Dynamic, Eigen::RowMajor> scratch_;
};

}  // namespace

std::unique_ptr<Kinematics> mujoco_kinematics(const Coordinates& coordinates) {
  mjModel* model = load(mjcf(coordinates.rig()));
  if (model == nullptr) return nullptr;
  return std::make_unique<MujocoKinematics>(coordinates, model);
}

bool has_mujoco() { return true; }

}  // namespace limber::peers
