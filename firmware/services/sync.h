/* sync.h: the chip clock of a board as all applications use it (timing.h).
 *
 * A cycle of the code has N = 2^degree - 1 chips (parameter degree, read once at start; gold.h). The sync wire rises,
 * and SYNC tells a number, not at every cycle of a short code but once in a sync period of K cycles, the power of two
 * that brings it near to 0.1 s:
 *   degree   5    6    7    9    10    11
 *   N       31   63  127  511  1023  2047
 *   K       32   16    8    2     1     1
 *   K N    992 1008 1016 1022  1023  2047
 * To the chip clock a sync period is its cycle: what chip_clock.h says of lock and hold-over is the same for every
 * code, SYNC comes when its edge is the latest, and takes no room on the bus that a short cycle's report needs. No two
 * periods are alike within CHIP_CLOCK_SEARCH_PPM of two good crystals, and SYNC tells N besides.
 *
 * Timing over CAN (parameter sync_source = 2): no sync wire, no look at the field (Prigge and How, section 4, first
 * method). Two steps, as in IEEE 1588 and AUTOSAR's CanTSyn. The master sends SYNC with the number of its cycle,
 * whenever the bus takes it. All boards stamp its end on their own chip clocks (hal_can_stamp). The master then tells
 * in FOLLOW_UP how long that cycle had lasted on its own clock at the end of SYNC. A follower has seen that end on its
 * own: end of SYNC minus that time is where the cycle began (chip_clock_message). So nothing that delays SYNC or
 * FOLLOW_UP matters.
 *
 * Jitter. What differs from board to board: the receiver's time quantum (71 ns; its mean, half of it, remains as an
 * offset), what holds the stamping interrupt up (hal.h), the cable (5 ns/m). On emulated boards with a bus 62 % busy
 * single stamps scatter by 15 ns rms (make can-sync-figures); wait states of the flash are not emulated.
 * chip_clock_link's gains are for eight times that, 20 ticks: with an oscillator that wanders by 0.02 ppm a cycle (0.34
 * ticks a cycle and cycle) the tracking index is 0.017, and alpha 0.17, beta 0.016 are the best (Kalata 1984); 16 edges
 * have 0.23, 0.022, and cost less lag while crystals warm up. The error of the rate, some 1 tick a cycle at 20 ticks of
 * jitter, is what 10 s of hold-over multiply by 100.
 *
 *   lost SYNC or FOLLOW_UP, bus off   that cycle has no edge: as with a missing edge of the wire; hold-over for 10 s.
 *   SYNC sent twice                   (its master saw an error in the very last bit, which receivers do not) the latter
 *                                     of the two counts on both sides.
 *   two masters                       a FOLLOW_UP belongs to the SYNC of its node and cycle. The chip clock stays with
 *                                     the one it has, and counts the other's as rejected (counter 10).
 *   another length of cycle           such a SYNC is ignored (and counted, counter 14).
 *
 * Contexts: sync_link_serve from plan, before chips are planned (the context of the chip clock); the rest from main.
 */
#ifndef GOLDFIELD_SYNC_H
#define GOLDFIELD_SYNC_H

#include "core/timing/chip_clock.h"
#include "hal/hal.h"
#include "services/node.h"

#define SYNC_CYCLE_MASK     0xFFFFFu /* Cycle numbers have 20 bits on the wire. */
#define SYNC_FRESH_US       50000u   /* Half a sync period of most codes. */
#define SYNC_SEEN           4u       /* SYNCs without FOLLOW_UP that are remembered. */
#define SYNC_PERIODS_LATE   1        /* A SYNC that was on the bus later than so many sync periods has no FOLLOW_UP. */
#define SYNC_STAMPS_A_BLOCK 8u

/* Parameter sync_source. */
enum { SYNC_BY_WIRE = 0, SYNC_BY_FIELD = 1, SYNC_BY_CAN = 2 };

/* A SYNC that was received. */
typedef struct {
    bool open; /* Its FOLLOW_UP has not come. */
    uint32_t node, cycle;
    chip_clock_mark_t mark;
} sync_seen_t;

typedef struct {
    volatile bool follows;
    /* Private. */
    sync_seen_t seen[SYNC_SEEN];
    uint32_t count;
    bool answer_due; /* Of the master: from plan to main. */
    uint32_t answer_cycle;
    int32_t answer_ticks;
} sync_link_t;

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

/* The cycle of the code that a planned chip belongs to, counted from 0 or from what SYNC told, and its chip. About
 * 10 instructions. */
static inline uint32_t sync_cycle(const sync_format_t *format, const chip_clock_chip_t *chip) {
    return chip->cycle * format->cycles + chip->code_chip / format->chips;
}

static inline uint16_t sync_chip(const sync_format_t *format, const chip_clock_chip_t *chip) {
    return chip->code_chip % format->chips;
}

/* A SYNC message of chips a cycle, with a 20-bit cycle number, came age_us after the latest edge of the sync wire.
 * It is taken if the clock knows the master's edges (from the second edge on, before it is locked) and the edge is
 * younger than SYNC_FRESH_US: an older one means that the wire is silent and the number belongs to an edge that was
 * not seen. False: the master's cycle has another length. The clock then forgets the wire: as long as such messages
 * come it never locks. To a clock that follows messages on CAN nothing happens: its numbers come by FOLLOW_UP. */
bool sync_number(chip_clock_t *clock, const sync_format_t *format, const sync_link_t *link, uint32_t chips,
                 uint32_t cycle, uint32_t age_us);

/* From plan, before chips are planned: all stamps since the last call. About 1,100 instructions when a FOLLOW_UP
 * came, else 20. */
void sync_link_serve(sync_link_t *link, chip_clock_t *clock, const sync_format_t *format, hal_t *hal);

/* From now on the clock follows messages on CAN, or does not: unlocked, searching. */
void sync_link_follow(sync_link_t *link, chip_clock_t *clock, bool follows);

/* Master: send the FOLLOW_UP that is due, if one is. */
void sync_link_answer(sync_link_t *link, node_t *node);

/* Ticks in units of 10 ns, rounded toward zero. */
int32_t sync_phase(int32_t ticks);

#endif
