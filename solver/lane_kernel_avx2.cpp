#define LIMBER_LANES lanes_avx2
#include "solver/lane_kernel.h"
