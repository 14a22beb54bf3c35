/* sync.h: the chip clock of a board as all applications use it: the sync period that gathers short code cycles, the
 * cycle numbers that SYNC tells, and timing over CAN instead of a sync wire. The applications reach it by timing.h.
 *
 * Calls, in the order they are made
 *   1. sync_format, sync_clock_init  once, at the start.
 *   2. sync_link_follow              when timing over CAN begins or ends.
 *   3. sync_link_serve               before each block is planned.
 *   4. sync_link_answer, sync_number in main, when a FOLLOW_UP may be due, and when a SYNC was received.
 *   5. sync_cycle, sync_chip         for each planned chip that is to be labelled.
 *
 * Sync period. A cycle of the code has N = 2^degree - 1 chips (parameter degree, read once at start; gold.h). With a
 * short code the sync wire does not rise, and SYNC does not tell a number, at every cycle but once in a sync period.
 * That is K cycles, K the power of two that brings the period near to 0.1 s:
 *   degree   5    6    7    9    10    11
 *   N       31   63  127  511  1023  2047
 *   K       32   16    8    2     1     1
 *   K N    992 1008 1016 1022  1023  2047
 * To the chip clock a sync period is its cycle. What chip_clock.h says of lock and hold-over is therefore the same for
 * every code, SYNC comes while its edge is the latest, and it takes no room on the bus that a short cycle's report
 * needs. No two periods are alike within CHIP_CLOCK_SEARCH_PPM of two good crystals, and SYNC tells N besides.
 *
 * Timing over CAN (parameter sync_source = 2) needs neither a sync wire nor a look at the field (Prigge and How,
 * section 4, first method). It takes two steps, as in IEEE 1588 and AUTOSAR's CanTSyn.
 *   1. The master sends SYNC with the number of its cycle, whenever the bus takes it. All boards stamp the end of the
 *      frame on their own chip clocks (hal_can_stamp).
 *   2. The master then tells in FOLLOW_UP how long that cycle had lasted on its own clock at the end of SYNC. A
 *      follower has seen that end on its own clock: the end of SYNC minus that time is where the cycle began
 *      (chip_clock_message).
 * So nothing that delays SYNC or FOLLOW_UP matters.
 *
 * Jitter. Three things differ from board to board: the receiver's time quantum (71 ns at 1 Mbit/s, 381 ns at 125
 * kbit/s; the board takes off its mean, half of it), what holds the stamping interrupt up (hal.h), and the cable (5
 * ns/m). On emulated boards with a bus 62 % busy single stamps scatter by 15 ns rms (make can-sync-figures); wait
 * states of the flash are not emulated. The gains of chip_clock_link are chosen for eight times that, 20 ticks, which
 * is what a quantum of 125 kbit/s scatters by. With an oscillator that wanders by 0.02 ppm a cycle (0.34 ticks a cycle
 * in each cycle) the tracking index is 0.017, and alpha 0.17, beta 0.016 are the best (Kalata 1984); 16 edges have 0.23
 * and 0.022, and cost less lag while crystals warm up. The error of the rate, some 1 tick a cycle at 20 ticks of
 * jitter, is what 10 s of hold-over multiply by 100.
 *
 * What may go wrong
 *   SYNC or FOLLOW_UP lost, bus off  The cycle has no edge, as with a missing edge of the wire: hold-over.
 *   SYNC sent twice                  Its master saw an error in the very last bit, which receivers do not see. The
 *                                    second of the two counts on both sides.
 *   two masters                      A FOLLOW_UP belongs to the SYNC of its node and cycle. The chip clock stays with
 *                                    the master it has, and counts the other's edges as rejected (counter 10).
 *                                    Of the two one steps back (election.h); it has compared its clock with what the
 *                                    other's messages tell.
 *   another length of cycle          Such a SYNC is ignored, and counted (counter 14). A wire whose master has not told
 *                                    its own number lately is then forgotten (timing.h).
 *
 * Contexts: sync_link_serve is called from plan, before chips are planned, which is the context of the chip clock;
 * sync_cycle, sync_chip, sync_format and sync_phase from any; the others from main.
 */
#ifndef GOLDFIELD_SYNC_H
#define GOLDFIELD_SYNC_H

#include "core/timing/chip_clock.h"
#include "hal/hal.h"
#include "services/node.h"

#define SYNC_CYCLE_MASK     0xFFFFFu /* The bits of a cycle number in a message: 20. */
#define SYNC_FRESH_US       50000u   /* Largest age of the edge that a SYNC numbers, us: half a period of most codes. */
#define SYNC_NEAR_TICKS     168      /* Largest difference of two sources that are called the same, ticks: 1 us. */
#define SYNC_SEEN           4u       /* SYNCs without FOLLOW_UP that are remembered. */
#define SYNC_PERIODS_LATE   1  /* Largest delay of a SYNC on the bus, sync periods; a later one gets no FOLLOW_UP. */
#define SYNC_STAMPS_A_BLOCK 8u /* Most stamps taken before a block is planned: as many as the board keeps. */

/* What a SYNC was to a clock. */
typedef enum {
    SYNC_IDLE = 0,        /* It numbers nothing that this clock follows. */
    SYNC_NUMBERED = 1,    /* It numbered the latest edge of the wire. */
    SYNC_OTHER_LENGTH = 2 /* Its master's cycle has another length. */
} sync_told_t;

/* The values of the parameter sync_source. */
enum { SYNC_BY_WIRE = 0, SYNC_BY_FIELD = 1, SYNC_BY_CAN = 2, SYNC_AUTOMATIC = 3 };

/* A SYNC that was received. */
typedef struct {
    bool open;              /* Its FOLLOW_UP has not come yet. */
    uint32_t node, cycle;   /* The master that sent it, and the cycle that it numbers, 20 bits. */
    chip_clock_mark_t mark; /* When it ended on the board's clock. */
} sync_seen_t;

typedef struct {
    volatile bool follows;  /* The clock follows messages on CAN. */
    volatile bool compares; /* It compares itself with them while it follows the wire. */
    /* Private. */
    sync_seen_t seen[SYNC_SEEN]; /* A ring of the latest SYNCs. */
    uint32_t count;              /* SYNCs put into the ring. */
    uint32_t leader;             /* The node whose messages the clock took last. */
    bool answer_due;             /* The master owes a FOLLOW_UP: plan sets it, main clears it. */
    uint32_t answer_cycle;       /* The cycle that the FOLLOW_UP is to tell of. */
    int32_t answer_ticks;        /* How long it had lasted at the end of SYNC, ticks. */
    uint32_t message_chip;       /* The chip that was planned next when a FOLLOW_UP came last. */
    uint32_t good;               /* Messages in a row that the clock was within SYNC_NEAR_TICKS of. */
    bool compared;               /* While the clock leads: another leader's messages were compared with it. */
    uint32_t rival_node;         /* That leader, */
    uint32_t rival_chip;         /* the chip that was planned next when its message was taken, */
    int32_t rival_phase;         /* and how early the own clock was, ticks. */
} sync_link_t;

/* How chips make cycles, and cycles sync periods. */
typedef struct {
    uint16_t degree; /* Degree of the codes. */
    uint16_t chips;  /* N, the chips in a cycle. */
    uint16_t cycles; /* K, the cycles in a sync period. */
} sync_format_t;

/* Returns the format of the codes of a degree, which must be one that gold.h has. */
sync_format_t sync_format(uint32_t degree);

/* Make a chip clock for the chip engine of hal.h. Its cycle is the sync period. */
void sync_clock_init(chip_clock_t *clock, const sync_format_t *format, bool follow);

/* The place of a planned chip in the code. Each costs about 10 instructions. sync_cycle returns the cycle of the code
 * that the chip belongs to, counted from 0 or from what SYNC told; sync_chip returns its chip in that cycle, 0..N-1. */
static inline uint32_t sync_cycle(const sync_format_t *format, const chip_clock_chip_t *chip) {
    return chip->cycle * format->cycles + chip->code_chip / format->chips;
}

static inline uint16_t sync_chip(const sync_format_t *format, const chip_clock_chip_t *chip) {
    return chip->code_chip % format->chips;
}

/* Take a SYNC message of a master with so many chips a cycle. It tells a 20-bit cycle number and came age_us after the
 * latest edge of the sync wire. The number is taken if the clock knows the master's edges (from the second edge on,
 * before it is locked) and the edge is younger than SYNC_FRESH_US: an older one means that the wire is silent and the
 * number belongs to an edge that was not seen. Nothing happens to a clock that follows messages on CAN: its numbers
 * come by FOLLOW_UP.
 * Returns what the SYNC was. With SYNC_OTHER_LENGTH the clock is untouched; the caller decides (sync_distrust). */
sync_told_t sync_number(chip_clock_t *clock, const sync_format_t *format, const sync_link_t *link, uint32_t chips,
                        uint32_t cycle, uint32_t age_us);

/* Let a clock that follows the wire forget it: its master may be the one of another cycle whose SYNC came, though its
 * edges fit. As long as such messages come and this is called it never locks. */
void sync_distrust(chip_clock_t *clock, const sync_link_t *link);

/* Take all time stamps since the last call; from plan, before chips are planned. Costs about 1,100 instructions when a
 * FOLLOW_UP came, else 20. */
void sync_link_serve(sync_link_t *link, chip_clock_t *clock, const sync_format_t *format, hal_t *hal);

/* Let the clock follow messages on CAN from now on, or the wire. It is then unlocked and searches. */
void sync_link_follow(sync_link_t *link, chip_clock_t *clock, bool follows);

/* Send the FOLLOW_UP that a master owes, if it owes one. */
void sync_link_answer(sync_link_t *link, node_t *node);

/* Returns ticks in units of 10 ns, rounded toward zero. */
int32_t sync_phase(int32_t ticks);

#endif
