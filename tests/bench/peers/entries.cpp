#include "tests/bench/peers/entries.h"

#include "tests/bench/peers/clamped_jacobian.h"
#include "tests/bench/peers/coordinate_peer.h"
#include "tests/bench/peers/geometric.h"
#include "tests/bench/peers/limber_contestants.h"
#include "tests/bench/peers/second_order.h"

namespace limber::peers {

namespace {

template <class M>
std::unique_ptr<Method> make(Task& task) {
  return std::make_unique<M>(task);
}

std::unique_ptr<Method> dense_dls(Task& task) {
  return std::make_unique<LeastSquares>(task, LeastSquares::Assembly::dense);
}

/// Damped least squares three times: as MuJoCo's users write it, as fast as MuJoCo lets us make it,
/// and without MuJoCo.
std::vector<MethodEntry> least_squares(Start start) {
  const std::string limits = "Levenberg-Marquardt, active set over ranges and swing ellipses, ";
  const std::string dense = limits + "mj_jacSite, dense J and J'J, Cholesky; starts again as ours";
  const std::string chains = limits + "J'J by effectors' chains, Cholesky; starts again as ours";
  const std::string tail = start == Start::previous ? ", previous start" : "";
  return {
      {.name = "MuJoCo + DLS" + tail,
       .setting = dense,
       .make = dense_dls,
       .start = start,
       .mujoco = true},
      {.name = "MuJoCo + DLS by chains" + tail,
       .setting = chains,
       .make = make<LeastSquares>,
       .start = start,
       .mujoco = true},
      {.name = "DLS by chains" + tail,
       .setting = chains,
       .make = make<LeastSquares>,
       .start = start},
  };
}

std::vector<MethodEntry> newton_and_broyden() {
  return {{.name = "Newton",
           .setting = "true Hessian by differences of the gradient, damped, active set; starts "
                      "again as ours",
           .make = make<Newton>,
           .start = Start::extrapolated},
          {.name = "BFGS",
           .setting = "Broyden's class, Powell's damping, Hessian kept between frames, active set; "
                      "starts again as ours",
           .make = make<Bfgs>,
           .start = Start::extrapolated}};
}

/// Methods that know limits only by clamping; each takes one start.
std::vector<MethodEntry> clamping() {
  const std::string tail = ", joints clamped after each step; one start";
  const auto entry = [](std::string name, std::string setting, auto maker) {
    return MethodEntry{.name = std::move(name),
                       .setting = std::move(setting),
                       .make = maker,
                       .start = Start::extrapolated,
                       .rescue = false};
  };
  return {
      entry("DLS, clamped",
            "lambda^2 = 1e-5, the best of 1e-5, 1e-4 and 1e-3 on motions, at most 100 iterations" +
                tail,
            make<ClampedDls>),
      entry("SVD-DLS, clamped",
            "numerical filtering below 3e-3 m/rad, at most 100 iterations" + tail, make<SvdDls>),
      entry("SDLS, clamped", "Buss & Kim 2005, gamma_max 45 degrees, at most 100 iterations" + tail,
            make<Sdls>),
      entry("Jacobian transpose", "Buss 2004's step length, at most 1000 iterations" + tail,
            make<JacobianTranspose>),
      entry("CCD",
            "weighted fit of all effectors below a joint, balls in closed form, at most 500 "
            "sweeps; one start",
            make<Ccd>),
      entry("FABRIK",
            "limits in the outward pass, twists from the next bone, at most 500 passes, one "
            "start; orientations are met only by the joint that carries the effector",
            make<Fabrik>)};
}

}  // namespace

std::vector<std::unique_ptr<Contestant>> all_contestants(const Workload& work) {
  std::vector<std::unique_ptr<Contestant>> all;
  const auto add = [&](std::vector<MethodEntry> entries) {
    for (MethodEntry& entry : entries) {
      all.push_back(std::make_unique<CoordinatePeer>(std::move(entry)));
    }
  };
  all.push_back(make_ours(IkMethod::pgs, Start::extrapolated));
  if (!work.rest_start) {
    all.push_back(make_ours(IkMethod::pgs, Start::previous));
    all.push_back(make_ours(IkMethod::pgs, Start::extrapolated, 8));
  }
  all.push_back(make_ours(IkMethod::pgs_paper, Start::extrapolated));
  add(least_squares(Start::extrapolated));
  if (!work.rest_start) add(least_squares(Start::previous));
  add(newton_and_broyden());
  add(clamping());
  all.push_back(make_ceres());
  return all;
}

}  // namespace limber::peers
