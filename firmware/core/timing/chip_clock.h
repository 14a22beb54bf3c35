/* chip_clock.h: how long each chip lasts and which chip of the code it is; follows the sync wire, or messages that the
 * master's clock dates.
 *
 * The board counts chips from 0 for ever ("absolute chip", uint32_t, wraps after 4.8 days: harmless). It asks for each
 * chip's length up to two blocks ahead, and reports an edge of the sync wire as (absolute chip, ticks into that chip).
 * The wire rises when the master begins chip 0 of a cycle.
 *
 * Method. Both sides are put on one time line, the board's own ticks. An estimator holds when the master begins its
 * chips: phase and chip period (an alpha-beta filter on the edges, that is a PI loop without dead time: an edge is
 * dated with the periods that were really handed out). The planner makes each chip end where the master's chip ends,
 * within the allowed length of a chip. So plans already handed out are accounted for exactly, and how far ahead the
 * board plans has no influence on stability.
 *   ends are rounded down to whole ticks: the mean period is exact (32 fractional bits), no tick is lost or gained.
 *
 * Gains. Of the k-th edge since the search those of the straight line fitted to k edges, alpha = (4 k - 2) / (k (k +
 * 1)), beta = 6 / (k (k + 1)) (Brookner, Tracking and Kalman Filtering Made Easy, 1.2.10: expanding memory), k growing
 * up to the source's memory_edges and staying there. The phase then has alpha times the variance of an edge; what the
 * oscillators drift, d ticks a cycle and cycle, costs a lag of d (1 - alpha) / beta.
 *   wire     6 edges, alpha 0.52, beta 0.14: its capture has a tick of jitter, so what matters is to follow the
 *            oscillator.
 *   link    16 edges, alpha 0.23, beta 0.022. sync.h has the figures of the jitter and what the choice rests on.
 *
 * Messages. A frame on a bus ends for all boards at one moment. The board marks that moment on its own chip clock
 * (chip_clock_mark); the master tells later how long its cycle had lasted at that moment on its own
 * (chip_clock_message). Mark minus this time is an edge. Nothing else is new: arbitration, bit stuffing and the way of
 * the later message have no part in it, and the mark may be seconds old.
 *
 * Life of a follower
 *   1. searching: runs at the nominal period. Two edges whole cycles apart (1 to 4, within CHIP_CLOCK_SEARCH_PPM) give
 *      phase and period. The label of the chip (code chip) jumps to the master's nearest: cycles before the jump are
 *      cut short. The rest, at most half a chip, is slewed off by chips of the shortest or longest allowed length (at
 *      most 22 chips).
 *   2. tracking: each edge corrects phase and period. Edges off by more than the source's gate, and a second edge in
 *      one cycle, are rejected and counted. Three rejected edges whole cycles apart with no good one between: the
 *      master has moved; phase and period are taken from them, the label jumps again, the lock is lost.
 *   3. locked: three edges in succession with the phase within the source's lock_ticks. Lost when one is not, and
 *      CHIP_CLOCK_HOLDOVER_CYCLES after the last edge. Until then, and after it, the last period is kept (hold-over).
 * A master (follow = false) runs at the nominal period, is always locked, and ignores edges.
 *
 * Drive nothing, and report no cycle as synchronous, while not locked.
 *
 * Contexts: chip_clock_plan, _edge, _mark, _message and _at from one interrupt priority; reading locked and phase_ticks
 * from main; chip_clock_number_cycle from either. Time: no loops but a wrap of at most 5 turns; figures of each call
 * below. Memory: about 1.6 kB.
 */
#ifndef GOLDFIELD_CHIP_CLOCK_H
#define GOLDFIELD_CHIP_CLOCK_H

#include <stdbool.h>
#include <stdint.h>

#define CHIP_CLOCK_HISTORY         128u /* Planned chips that are remembered: two blocks ahead and two back. */
#define CHIP_CLOCK_LOCK_EDGES      3u
#define CHIP_CLOCK_SEARCH_PPM      300  /* Two crystals of +-100 ppm, and reserve. */
#define CHIP_CLOCK_SEARCH_CYCLES   4u   /* Edges that may be missing while searching: three. */
#define CHIP_CLOCK_HOLDOVER_CYCLES 100u /* 10 s: 0.5 us at 0.05 ppm of drift since the last edge. */

typedef struct {
    uint16_t chips;         /* Of a cycle: 31..2047. */
    uint16_t nominal_ticks; /* Of a chip. */
    uint16_t minimum_ticks; /* A planned chip is never shorter, */
    uint16_t maximum_ticks; /* nor longer. Must leave at least 1 % to both sides of nominal. */
    bool follow;            /* false: master, runs free. */
} chip_clock_config_t;

/* What is peculiar to a source of edges. */
typedef struct {
    uint16_t gate_ticks;  /* An edge that is farther from the estimate is rejected. */
    uint16_t lock_ticks;  /* Locked while the phase is within. */
    uint8_t memory_edges; /* 3 or more. */
} chip_clock_source_t;

extern const chip_clock_source_t chip_clock_wire; /* 2 us, 0.5 us. */
extern const chip_clock_source_t chip_clock_link; /* 3 us, 0.5 us. */

/* A planned chip. */
typedef struct {
    uint32_t cycle;     /* Counts code cycles; see chip_clock_number_cycle. */
    uint16_t code_chip; /* 0..chips-1 */
    uint16_t period_ticks;
    uint32_t position; /* Its start on the board's time line, ticks modulo 2^32. */
} chip_clock_chip_t;

/* A moment on the board's time line and in its cycle. */
typedef struct {
    uint32_t position;   /* Ticks modulo 2^32. */
    int32_t cycle_ticks; /* Since chip 0 of this cycle began, by what the clock really did; negative: before it. */
    uint32_t cycle;      /* The one that began nearest. */
} chip_clock_mark_t;

typedef struct {
    chip_clock_config_t config;
    chip_clock_source_t source;
    /* Results, for reading. */
    bool locked;
    int32_t phase_ticks; /* Chip clock minus sync wire at the last good edge: positive is early. Without a wire minus
                            the field's edge. */
    uint32_t edges_rejected; /* Stops at its maximum. */
    uint64_t period;         /* Estimate of the master's chip in own ticks, 32 fractional bits. */
    int16_t detune_ticks; /* Written by the owner: planned chips are longer by this than the estimate, so that the phase
                             slides (acquire.h). */
    /* Private. Positions are own ticks with 32 fractional bits modulo 2^64; only differences below 12 s are formed. */
    uint32_t chip;     /* Next absolute chip to plan. */
    uint32_t position; /* Its start, whole ticks modulo 2^32. */
    uint64_t target;   /* Where the master begins that chip. */
    uint32_t cycle;
    uint16_t code_chip;
    uint8_t good_edges;
    uint8_t memory;          /* Edges that the gains stand for. */
    uint8_t candidate_edges; /* Edges whole cycles apart that led to the candidate; 0: none. */
    bool tracking;
    bool compared;
    uint32_t edge_cycle; /* Cycle that the last good edge began. */
    uint32_t cycle_shift;
    uint32_t candidate_chip;
    uint64_t candidate_position; /* Of its message; of the edge itself with a wire. */
    int32_t candidate_since;     /* From edge to message, the master's ticks. */
    struct {
        uint32_t position;
        uint32_t cycle;
        uint16_t code_chip;
        uint16_t period_ticks;
    } history[CHIP_CLOCK_HISTORY];
} chip_clock_t;

/* Start at absolute chip 0, cycle 0, code chip 0, source chip_clock_wire. False, and nothing done, for a
 * configuration outside the ranges above. */
bool chip_clock_init(chip_clock_t *clock, const chip_clock_config_t *config);

/* Plan the next absolute chip: the first call plans chip 0. About 55 instructions. */
chip_clock_chip_t chip_clock_plan(chip_clock_t *clock);

/* A rising edge of the sync wire, ticks after the start of an absolute chip. An edge in a chip that is not planned
 * or is forgotten is rejected. At most about 670 instructions (64-bit divisions). */
void chip_clock_edge(chip_clock_t *clock, uint32_t chip, uint16_t ticks);

/* What was planned for an absolute chip. False, and *planned untouched, if it is not planned yet or is more than
 * CHIP_CLOCK_HISTORY chips ago. About 20 instructions. */
bool chip_clock_at(const chip_clock_t *clock, uint32_t chip, chip_clock_chip_t *planned);

/* ---- Instead of the wire: messages of the master. ---- */

/* Ticks after the start of an absolute chip, at most two chips. False, and *mark untouched, for a chip that is not
 * planned or is forgotten. About 50 instructions. */
bool chip_clock_mark(const chip_clock_t *clock, uint32_t chip, uint32_t ticks, chip_clock_mark_t *mark);

/* At the mark the master's cycle had lasted master_ticks of its own (negative: was to begin in so many). Within 0.4
 * s; more is rejected and counted. The mark may lie up to 12 s back. True: the estimate now counts this edge;
 * chip_clock_number_cycle may tell which cycle it began. At most about 900 instructions (64-bit divisions). */
bool chip_clock_message(chip_clock_t *clock, const chip_clock_mark_t *mark, int32_t master_ticks);

/* ---- Instead of the wire: an estimate made elsewhere (acquire.h). Same context as chip_clock_edge; a master
 * ignores them. ---- */

/* The master begins chip 0 of some cycle at edge (position, 32 fractional bits) and its chip lasts period (32
 * fractional bits; limited as the estimate always is): take both over as from the wire while searching. The label
 * jumps, the lock is lost. edge may lie up to 12 s back. About 200 instructions. */
void chip_clock_jump(chip_clock_t *clock, uint64_t edge, uint64_t period);

/* The estimate moves by phase (32 fractional bits; positive: chips start later) and its period by period.
 * residual_ticks becomes phase_ticks, locked tells what it tells. Counts as an edge of the present cycle for the
 * hold-over. About 40 instructions. */
void chip_clock_correct(chip_clock_t *clock, int64_t phase, int64_t period, int32_t residual_ticks, bool locked);

/* From main: another source of time begins. Unlocked, searching, no detuning; phase and period stay until the new
 * source tells better. */
void chip_clock_forget(chip_clock_t *clock, const chip_clock_source_t *source);

/* An edge of a wire that is there but not followed: from now on phase_ticks is the difference to the wire, not that
 * to the source that is followed. */
void chip_clock_compare(chip_clock_t *clock, uint32_t chip, uint16_t ticks);

/* On a SYNC message: the cycle that the last good edge began has this number (modulo 2^32; a SYNC has 20 bits, so
 * compare those only). All cycles that chip_clock_plan and _at tell from now on are counted from it. Call it within
 * a cycle of the edge. */
void chip_clock_number_cycle(chip_clock_t *clock, uint32_t cycle);

#endif
