#include "core/link/spread.h"

uint32_t spread_place(uint32_t node, uint32_t places) {
    const uint32_t odd = (places - 1u) | 1u;
    return 2u * node % odd;
}
