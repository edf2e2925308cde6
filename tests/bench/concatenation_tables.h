#pragma once

namespace limber::test {

// The tables of limber_bench_concatenation: what Kenwright 2012 ("A Beginners Guide to
// Dual-Quaternions", sections 10 and 11) says of concatenation, beside what is measured.
// `quick`: a fraction of the work, to see that it runs.

void print_operation_counts();
void print_times(bool quick);
void print_drift(bool quick);
void print_following(bool quick);

}  // namespace limber::test
