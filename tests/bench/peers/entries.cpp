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

/// Second-order methods: limits by active set, starts again as ours does.
std::vector<MethodEntry> second_order(Start start) {
  const std::string limits = "Levenberg-Marquardt, active set over ranges and swing ellipses";
  const std::string dense =
      limits + ", mj_jacSite, dense J and J'J, Cholesky; starts again as ours";
  const std::string chains = limits + ", J'J by effectors' chains, Cholesky; starts again as ours";
  const std::string tail = start == Start::previous ? ", previous start" : "";
  return {
      {"MuJoCo + DLS" + tail, dense, dense_dls, start, true},
      {"MuJoCo + DLS by chains" + tail, chains, make<LeastSquares>, start, true},
      {"DLS by chains" + tail, chains, make<LeastSquares>, start},
  };
}

std::vector<MethodEntry> others() {
  const Start start = Start::extrapolated;
  const std::string again = "; starts again as ours", once = "; one start";
  const std::string clamp = ", joints clamped after each step";
  return {
      {"Newton", "true Hessian by differences of the gradient, damped, active set" + again,
       make<Newton>, start},
      {"BFGS", "Broyden's class, Powell's damping, Hessian kept between frames, active set" + again,
       make<Bfgs>, start},
      {"DLS, clamped", "lambda^2 = 1e-5, at most 100 iterations" + clamp + once, make<ClampedDls>,
       start, false, false},
      {"SVD-DLS, clamped",
       "numerical filtering below 3e-3 m/rad, at most 100 iterations" + clamp + once, make<SvdDls>,
       start, false, false},
      {"SDLS, clamped",
       "Buss & Kim 2005, gamma_max 45 degrees, at most 100 iterations" + clamp + once, make<Sdls>,
       start, false, false},
      {"Jacobian transpose", "Buss 2004's step length, at most 1000 iterations" + clamp + once,
       make<JacobianTranspose>, start, false, false},
      {"CCD",
       "weighted fit of all effectors below a joint, balls in closed form, at most 500 sweeps" +
           once,
       make<Ccd>, start, false, false},
      {"FABRIK",
       "limits in the outward pass, at most 500 passes; has no way to meet an orientation "
       "but through the bone that carries it" +
           once,
       make<Fabrik>, start, false, false},
  };
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
  if (!work.rest_start) all.push_back(make_ours(IkMethod::pgs, Start::previous));
  all.push_back(make_ours(IkMethod::pgs_paper, Start::extrapolated));
  add(second_order(Start::extrapolated));
  if (!work.rest_start) add(second_order(Start::previous));
  add(others());
  all.push_back(make_ceres());
  return all;
}

}  // namespace limber::peers
