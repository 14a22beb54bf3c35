/* sync.h: the chip clock of a board as both applications use it. */
#ifndef GOLDFIELD_SYNC_H
#define GOLDFIELD_SYNC_H

#include "chip_clock.h"

#define SYNC_CYCLE_MASK 0xFFFFFu  /* Cycle numbers have 20 bits on the wire. */
#define SYNC_FRESH_US 50000u      /* Half a cycle. */

/* A chip clock for the chip engine of hal.h and codes of degree 10. */
void sync_clock_init(chip_clock_t *clock, bool follow);

/* A SYNC message with a 20-bit cycle number came, age_us after the latest edge of the sync wire. It is taken if the clock knows the master's edges (from the
 * second edge on, before it is locked) and the edge is younger than SYNC_FRESH_US: an older one means that the wire is silent and the number belongs to an
 * edge that was not seen. */
void sync_number(chip_clock_t *clock, uint32_t cycle, uint32_t age_us);

/* Ticks in units of 10 ns, rounded toward zero. */
int32_t sync_phase(int32_t ticks);

#endif
