#include "assets/model/mesh.h"

namespace limber {

void skin_positions(const Mesh& mesh, std::span<const DualQuaternion> model_from_joint,
                    std::span<Eigen::Vector3f> out) {
  std::vector<Eigen::Matrix<float, 3, 4>> model_from_mesh(mesh.skin.size());
  for (std::size_t s = 0; s < mesh.skin.size(); ++s) {
    const Eigen::Matrix4d m =
        model_from_joint[mesh.skin[s].joint].matrix() * mesh.skin[s].joint_from_mesh;
    model_from_mesh[s] = m.topRows<3>().cast<float>();
  }
  for (std::size_t v = 0; v < mesh.positions.size(); ++v) {
    const Eigen::Vector4f p = mesh.positions[v].homogeneous();
    Eigen::Vector3f posed = Eigen::Vector3f::Zero();
    for (std::uint32_t i = mesh.influence_begin[v]; i < mesh.influence_begin[v + 1]; ++i) {
      const Influence& influence = mesh.influences[i];
      posed += influence.weight * (model_from_mesh[influence.skin_joint] * p);
    }
    out[v] = posed;
  }
}

}  // namespace limber
