#define LIMBER_LANES lanes_sse2
#include "solver/lane_kernel.h"
