#include "tests/bench/peers/entries.h"

#include "tests/bench/peers/active_set.h"
#include "tests/bench/peers/coordinate_peer.h"
#include "tests/bench/peers/limber_contestants.h"

namespace limber::peers {

namespace {

template <class M>
std::unique_ptr<Method> make(Task& task) {
  return std::make_unique<M>(task);
}

std::unique_ptr<Method> dense_dls(Task& task) {
  return std::make_unique<ActiveSetDls>(task, ActiveSetDls::Assembly::dense);
}

}  // namespace

std::vector<std::unique_ptr<Contestant>> all_contestants(const Workload& work) {
  std::vector<std::unique_ptr<Contestant>> all;
  const auto peer = [&](MethodEntry entry) {
    all.push_back(std::make_unique<CoordinatePeer>(std::move(entry)));
  };
  all.push_back(make_ours(IkMethod::pgs, Start::extrapolated));
  if (!work.rest_start) all.push_back(make_ours(IkMethod::pgs, Start::previous));

  const std::string limits = "Levenberg-Marquardt, active set over ranges and swing ellipses, ";
  const std::string dense = limits + "mj_jacSite, dense J and J'J, Cholesky";
  const std::string chains = limits + "J'J from each effector's chain, Cholesky";
  peer({"MuJoCo + DLS", dense, dense_dls, Start::extrapolated, true});
  peer({"MuJoCo + DLS by chains", chains, make<ActiveSetDls>, Start::extrapolated, true});
  peer({"DLS by chains", chains, make<ActiveSetDls>, Start::extrapolated, false});
  if (!work.rest_start) {
    peer({"MuJoCo + DLS, previous start", dense, dense_dls, Start::previous, true});
    peer({"MuJoCo + DLS by chains, previous start", chains, make<ActiveSetDls>, Start::previous,
          true});
  }
  return all;
}

}  // namespace limber::peers
