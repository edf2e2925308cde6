#include <fmt/core.h>

#include "tests/bench/concatenation_tables.h"
#include "tests/model/following_chain.h"
#include "tests/model/long_chain.h"

namespace limber::test {
namespace {

void drift_row(const Traveller& traveller, int products, const Drift& drift) {
  fmt::print("  {:<6} {:<20} {:<13} {:>8}   {:8.1e}   {:8.1e}   {:8.1e}\n", traveller.scalar,
             traveller.form, to_string(traveller.mending), products, drift.not_rigid,
             drift.angle_rad, drift.position_m);
}

void drift_head(const char* title) {
  fmt::print("{}\n  {:<6} {:<20} {:<13} {:>8}   {:>8}   {:>8}   {:>8}\n", title, "", "", "mended",
             "products", "A'A - 1", "rad", "m");
}

void print_wandering(int products) {
  Travellers all;
  for (const Mending m : {Mending::never, Mending::at_the_end, Mending::each}) {
    add_travellers(m, all);
  }
  drift_head("Drift over unlike steps in a room of 4 m, against the closed form");
  Wander wander(1);
  for (int k = 1; k <= products; ++k) {
    const ExactMotion step = wander.step();
    for (auto& traveller : all) traveller->step(step);
    if (k != 100 && k != 10000 && k != products) continue;
    for (const auto& traveller : all) {
      if (k != products && traveller->mending != Mending::never) continue;
      drift_row(*traveller, k, traveller->drift(wander.pose()));
    }
  }
  fmt::print(
      "  True here: dual quaternion and matrices walk away as the root of the number of products,\n"
      "  side by side: drift favours neither. Mending, at the end or each time, makes a result "
      "rigid;\n"
      "  where it went astray stays as it was. Quaternion + vector is as good if it is normalised\n"
      "  after each product; left alone, its position errs in proportion to their number. (3x4\n"
      "  matrices give the 4x4's digits.)\n\n");
}

void print_turntable(int turns) {
  constexpr int kPerTurn = 1000;
  Travellers all;
  add_travellers(Mending::never, all);
  add_travellers(Mending::each, all);
  drift_head("Drift over one repeated step, a thousandth of a turn, against the closed form");
  const ExactMotion step = turntable_step(kPerTurn), half_turn = turntable_step(2);
  for (int k = 1; k <= turns * kPerTurn; ++k) {
    for (auto& traveller : all) traveller->step(step);
    const int turn = k / kPerTurn;
    if (k % kPerTurn != kPerTurn / 2) continue;
    if (turn != turns / 100 && turn != turns / 10 && turn != turns - 1) continue;
    for (const auto& traveller : all) {
      if (turn != turns - 1 && traveller->mending != Mending::never) continue;
      drift_row(*traveller, k, traveller->drift(half_turn));
    }
  }
  fmt::print(
      "  True here: the same rounding each time adds up in proportion to the number of products\n"
      "  (its square, for the position of quaternion + vector left alone). Mending takes off "
      "scale\n"
      "  and skew; the turn that the step was rounded by adds up still, in every form.\n\n");
}

template <class Form>
void following_rows(int frames) {
  for (const Repair repair : {Repair::never, Repair::links, Repair::levels}) {
    const Following f = follow<Form>(repair, frames);
    fmt::print("  {:<6} {:<20} {:<15} {:8.1e}   {:8.1e}   {:9.2e}   {:9.2e}   {:6.4f}\n",
               sizeof(typename Form::Scalar) == 4 ? "float" : "double", Form::name,
               to_string(repair), f.not_rigid, f.link_stretch_m, f.miss_m, f.rigid_miss_m,
               f.joint_step_rad);
  }
}

}  // namespace

void print_drift(bool quick) {
  print_wandering(quick ? 10000 : 1000000);
  print_turntable(quick ? 10 : 1000);
}

void print_following(bool quick) {
  const int frames = quick ? 1200 : 200000;
  fmt::print(
      "A chain of six links follows a target, {} frames (section 10.1, figures 2 to 4)\n"
      "  {:<6} {:<20} {:<15} {:>8}   {:>8}   {:>9}   {:>9}   {:>6}\n",
      frames, "", "", "repaired", "A'A - 1", "stretch", "miss", "rigid", "step");
  following_rows<DualQuaternionForm<float>>(frames);
  following_rows<Matrix4x4Form<float>>(frames);
  following_rows<DualQuaternionForm<double>>(frames);
  following_rows<Matrix4x4Form<double>>(frames);
  fmt::print(
      "  stretch: change of a link's length (m); miss: end from target as the form sees it (m);\n"
      "  rigid: the same with rigid bones (m); step: largest turn of a link in one frame (rad).\n"
      "  Paper: matrices skew and scale (figure 3); putting them right breaks joints and leaves "
      "the\n"
      "  end beside its ideal (figure 4); dual quaternions only need normalising.\n"
      "  True here: in float and left alone both forms lose their shape, the dual quaternion no "
      "less\n"
      "  than the matrix, and its links change length too; what the solver sees still follows, as "
      "it\n"
      "  closes the loop over the drift, while rigid bones do not. Repairing each link after its\n"
      "  update cures either form and breaks nothing. In double neither needs it.\n\n");
}

}  // namespace limber::test
