// limber_bench_concatenation [--quick]: Kenwright 2012 on concatenation, claim by claim.

#include <string_view>

#include "tests/bench/concatenation_tables.h"

int main(int argc, char** argv) {
  const bool quick = argc > 1 && std::string_view(argv[1]) == "--quick";
  limber::test::print_operation_counts();
  limber::test::print_times(quick);
  limber::test::print_drift(quick);
  limber::test::print_following(quick);
}
