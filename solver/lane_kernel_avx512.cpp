#define LIMBER_LANES lanes_avx512
#include "solver/lane_kernel.h"
