/* sync.h: the chip clock of a board as both applications use it.
 *
 * A cycle of the code has N = 2^degree - 1 chips (parameter degree, read once at start; gold.h). The sync wire rises, and SYNC tells a number, not at every cycle of a short code but
 * once in a sync period of K cycles, the power of two that brings it near to 0.1 s:
 *   degree   5    6    7    9    10    11
 *   N       31   63  127  511  1023  2047
 *   K       32   16    8    2     1     1
 *   K N    992 1008 1016 1022  1023  2047
 * To the chip clock a sync period is its cycle: what chip_clock.h says of lock and hold-over is the same for every code, SYNC comes when its edge is the latest, and
 * takes no room on the bus that a short cycle's report needs. No two periods are alike within CHIP_CLOCK_SEARCH_PPM of two good crystals, and SYNC tells N besides.
 */
#ifndef GOLDFIELD_SYNC_H
#define GOLDFIELD_SYNC_H

#include "chip_clock.h"

#define SYNC_CYCLE_MASK 0xFFFFFu  /* Cycle numbers have 20 bits on the wire. */
#define SYNC_FRESH_US 50000u      /* Half a sync period of most codes. */

/* How chips make cycles, and cycles sync periods. */
typedef struct {
    uint16_t degree;
    uint16_t chips;  /* N, of a cycle. */
    uint16_t cycles; /* K, of a sync period. */
} sync_format_t;

/* The format of codes of a degree that gold.h has. */
sync_format_t sync_format(uint32_t degree);

/* A chip clock for the chip engine of hal.h. Its cycle is the sync period. */
void sync_clock_init(chip_clock_t *clock, const sync_format_t *format, bool follow);

/* The cycle of the code that a planned chip belongs to, counted from 0 or from what SYNC told, and its chip. About 10 instructions. */
static inline uint32_t sync_cycle(const sync_format_t *format, const chip_clock_chip_t *chip) {
    return chip->cycle * format->cycles + chip->code_chip / format->chips;
}

static inline uint16_t sync_chip(const sync_format_t *format, const chip_clock_chip_t *chip) { return chip->code_chip % format->chips; }

/* A SYNC message of chips a cycle, with a 20-bit cycle number, came age_us after the latest edge of the sync wire. It is taken if the clock knows the master's edges (from the
 * second edge on, before it is locked) and the edge is younger than SYNC_FRESH_US: an older one means that the wire is silent and the number belongs to an
 * edge that was not seen.
 * False: the master's cycle has another length. The clock then forgets the wire: as long as such messages come it never locks. */
bool sync_number(chip_clock_t *clock, const sync_format_t *format, uint32_t chips, uint32_t cycle, uint32_t age_us);

/* Ticks in units of 10 ns, rounded toward zero. */
int32_t sync_phase(int32_t ticks);

#endif
