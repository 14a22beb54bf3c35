/* chip_clock.h: decides how long each of the board's chips lasts and which chip of the code it is. A follower keeps
 * its chips in step with the master's by edges of the sync wire, by messages that the master's clock dates, or by an
 * estimate made elsewhere; a master runs free.
 *
 * Calls, in the order they are made
 *   1. chip_clock_init          once, before the chip engine starts.
 *   2. chip_clock_forget        when another source of edges than the wire is to be followed.
 *   3. chip_clock_plan          for each chip, up to two blocks before the chip begins.
 *   4. chip_clock_edge          for each edge of the wire; or chip_clock_mark and chip_clock_message for each message;
 *                               or chip_clock_jump and chip_clock_correct for an estimate (acquire.h).
 *   5. chip_clock_number_cycle  when the master tells the number of a cycle.
 *   6. chip_clock_at            when something that was measured in a chip is to be labelled, and chip_clock_contested.
 *   7. chip_clock_lead, chip_clock_yield  when a follower becomes the master, and when it follows again.
 * The owner drives nothing, and reports no cycle as synchronous, while `locked` is false.
 *
 * Time. The board counts chips from 0 and never resets the count: the "absolute chip", a uint32_t, which wraps
 * harmlessly after 4.8 days. The board reports an edge of the sync wire as the absolute chip in which it came and the
 * ticks into that chip. The wire rises when the master begins chip 0 of a cycle.
 *
 * Method. The board's chips and the master's are put on one time line, the board's own ticks. An estimator holds when
 * the master begins its chips: their phase and their period. It is an alpha-beta filter on the edges, that is a PI
 * loop without dead time, since an edge is dated with the periods that were really handed out. The planner makes each
 * chip end where the master's chip ends, within the allowed length of a chip. Plans already handed out are thus
 * accounted for exactly, and how far ahead the board plans has no influence on stability. Ends are rounded down to
 * whole ticks, but the mean period is exact (32 fractional bits): no tick is lost or gained.
 *
 * Gains. The k-th edge since the search has the gains of the straight line fitted to k edges,
 *   alpha = (4 k - 2) / (k (k + 1)),   beta = 6 / (k (k + 1))
 * (Brookner, Tracking and Kalman Filtering Made Easy, 1.2.10: expanding memory). k grows up to the source's
 * memory_edges and stays there. The phase then has alpha times the variance of an edge. Oscillators whose rate drifts
 * by d ticks a cycle in each cycle cost a lag of d (1 - alpha) / beta.
 *   source   edges   alpha   beta    why
 *   wire         6   0.52    0.14    The capture has a tick of jitter: what matters is to follow the oscillator.
 *   link        16   0.23    0.022   sync.h has the figures of the jitter and what the choice rests on.
 *
 * Messages. A frame on a bus ends for all boards at one moment. The board marks that moment on its own chip clock
 * (chip_clock_mark). The master tells later how long its cycle had lasted at that moment on the master's own clock
 * (chip_clock_message). The mark minus this time is an edge, which is treated like an edge of the wire. Arbitration,
 * bit stuffing and the way of the later message have no part in it, and the mark may be seconds old.
 *
 * Life of a follower
 *   1. Searching. The clock runs at the nominal period. Two edges that are whole cycles apart (1 to 4, within
 *      CHIP_CLOCK_SEARCH_PPM) give phase and period. The label of the chip (its code chip) jumps to the master's
 *      nearest; the cycle under way is cut short. What remains, at most half a chip, is slewed off by chips of the
 *      shortest or the longest allowed length (at most 22 chips).
 *   2. Tracking. Each edge corrects phase and period. An edge that is off by more than the source's gate, and a second
 *      edge in one cycle, are rejected and counted. Three rejected edges whole cycles apart, with no good one between,
 *      mean that the master has moved: phase and period are taken from them, the label jumps again, the lock is lost.
 *   3. Locked. The clock locks after three edges in succession with the phase within the source's lock_ticks. It loses
 *      the lock when the phase of an edge is not within them, and at the end of hold-over.
 *
 * Hold-over. While edges are missing the clock runs on with the last period, and lets it go on changing as it did: the
 * drift of the two oscillators against each other is the mean change of the period, over the last
 * CHIP_CLOCK_DRIFT_CYCLES edges; it is taken for none until there were so many. What no edge tells is whether a drift
 * goes on: an oven that is switched off ends it. So the lock ends as soon as the learnt drift, begun or ended with the
 * last edge, could have moved the phase by lock_ticks (n cycles move it by drift n^2 / 2), and
 * CHIP_CLOCK_HOLDOVER_CYCLES after the last edge in any case. A drift of d ppm/s that nothing showed before adds d t^2
 * / 2 microseconds in t seconds: 0.05 ppm/s make 2.5 us in the longest hold-over.
 *
 * Another master. A master that restarted has a new time, and its coil drives by it at once, while those who hold over
 * still keep the old one: a code that is shifted against the others is taken for fields of theirs. So what is measured
 * in hold-over counts as not locked for a cycle after each edge that does not fit (chip_clock_contested). While the own
 * master's edges come, an edge that does not fit is a glitch, and costs nothing.
 *
 * Estimated error (chip_clock_quality). With the scatter s of the edges, the memory k and n cycles since the last edge,
 *   floor + 2 s + n 2 s / k + |drift| n^2 / 2 + (0.02 ppm/s) t^2 / 2
 * The floor is what all edges have in common: the delay of wire, transceivers and stamps (sync.h). The third term is
 * the rate's error, the fourth that the learnt drift ends or has just begun, the last a drift that nothing showed.
 * tests/firmware/core/timing/test_clock_error.py compares it with the truth.
 *
 * Leading. A master (follow = false) runs at the period that it has, is always locked, and ignores edges. A follower
 * becomes one with chip_clock_lead, in a hold-over: its chips go on with the phase and the period that it has learnt,
 * so that nobody sees a step. The period then stays; the drift is not carried on, as there is nothing any more that it
 * were a drift against. A master becomes a follower with chip_clock_yield if it is in step with the other one already,
 * and with chip_clock_forget if not.
 *
 * Contexts: chip_clock_plan, _edge, _mark, _message, _jump, _correct, _compare and _at are called from one interrupt
 * priority. Main may read locked and phase_ticks. chip_clock_number_cycle is called from either.
 * Time: there is no loop but a wrap of at most 5 turns; each call's instructions are given with it.
 * Memory: about 1.6 kB.
 */
#ifndef GOLDFIELD_CHIP_CLOCK_H
#define GOLDFIELD_CHIP_CLOCK_H

#include <stdbool.h>
#include <stdint.h>

#define CHIP_CLOCK_HISTORY         128u /* Planned chips that are remembered: two blocks ahead and two back. */
#define CHIP_CLOCK_LOCK_EDGES      3u   /* Edges in succession with a good phase that make the lock. */
#define CHIP_CLOCK_SEARCH_PPM      300  /* Largest difference of two clocks, ppm: two crystals of +-100, and reserve. */
#define CHIP_CLOCK_SEARCH_CYCLES   4u   /* Most cycles between two edges of a search: three edges may be missing. */
#define CHIP_CLOCK_HOLDOVER_CYCLES 100u /* Most cycles of hold-over: 10 s, in which 0.01 ppm/s make 0.5 us. */
#define CHIP_CLOCK_DRIFT_CYCLES    32   /* Edges over which the drift is averaged. */

typedef struct {
    uint16_t chips;         /* Chips in a cycle, 31..2047. */
    uint16_t nominal_ticks; /* Nominal length of a chip, ticks. */
    uint16_t minimum_ticks; /* Shortest length of a planned chip, ticks; at least 1 % below nominal. */
    uint16_t maximum_ticks; /* Longest length of a planned chip, ticks; at least 1 % above nominal. */
    bool follow;            /* True: the clock follows a master. False: it is the master and runs free. */
} chip_clock_config_t;

/* What distinguishes one source of edges from another. */
typedef struct {
    uint16_t gate_ticks;  /* Largest distance of an edge from the estimate, ticks; an edge beyond it is rejected. */
    uint16_t lock_ticks;  /* Largest phase with which the clock counts as locked, ticks. */
    uint8_t memory_edges; /* Edges that the gains stand for once the clock has settled, 3 or more. */
    uint8_t floor_ticks;  /* Error that the source's edges may have in common, which no scatter shows, ticks. */
} chip_clock_source_t;

extern const chip_clock_source_t chip_clock_wire; /* The sync wire: gate 2 us, lock 0.5 us, 6 edges, floor 0.05 us. */
extern const chip_clock_source_t chip_clock_link; /* Messages on CAN: gate 3 us, lock 0.5 us, 16 edges, 0.25 us. */
/* An estimate by the field: what is compared with it has a gate of 3 us; lock 0.5 us, 16 edges, floor 0.25 us. */
extern const chip_clock_source_t chip_clock_field;

/* A planned chip. */
typedef struct {
    uint32_t cycle;        /* Number of its cycle; chip_clock_number_cycle sets from where it counts. */
    uint16_t code_chip;    /* Its place in the cycle, 0..chips-1. */
    uint16_t period_ticks; /* Its length, ticks. */
    uint32_t position;     /* Its start on the board's time line, ticks modulo 2^32. */
} chip_clock_chip_t;

/* A moment on the board's time line and in its cycle. */
typedef struct {
    uint32_t position;   /* The moment, ticks modulo 2^32. */
    int32_t cycle_ticks; /* Ticks since chip 0 of `cycle` began, as the clock really ran; negative before it. */
    uint32_t cycle;      /* Number of the cycle that began nearest to the moment. */
} chip_clock_mark_t;

typedef struct {
    chip_clock_config_t config;
    chip_clock_source_t source;
    /* Results, for reading. */
    bool locked;         /* The chips are in step with the master's. */
    int32_t phase_ticks; /* Chip clock minus sync wire at the last good edge, ticks; positive is early. Without a wire:
                            minus the edge of the source that is followed. */
    uint32_t edges_rejected; /* Edges rejected since the start; the count stops at its maximum. */
    uint64_t period;         /* Estimate of the master's chip, own ticks with 32 fractional bits. */
    int64_t drift;           /* Its change in a cycle. */
    uint32_t scatter;        /* Mean size of what the latest edges were off the estimate, 1/256 ticks. */
    int16_t detune_ticks;    /* Written by the owner: planned chips are so many ticks longer than the estimate, so that
                                the phase slides (acquire.h). */
    int16_t late_ticks;      /* So many ticks after the master's do the own chips begin on purpose. */
    /* Private. Positions are own ticks with 32 fractional bits modulo 2^64; only differences below 12 s are formed. */
    uint32_t chip;               /* Next absolute chip to plan. */
    uint32_t position;           /* Its start, whole ticks modulo 2^32. */
    uint64_t target;             /* Where the master begins that chip. */
    uint32_t cycle;              /* Its cycle, counted without cycle_shift. */
    uint16_t code_chip;          /* Its place in the cycle. */
    uint8_t good_edges;          /* Edges in succession with a good phase, at most CHIP_CLOCK_LOCK_EDGES. */
    uint8_t memory;              /* Edges that the gains stand for now. */
    uint8_t drift_edges;         /* Edges that the drift stands for, at most CHIP_CLOCK_DRIFT_CYCLES. */
    uint8_t candidate_edges;     /* Edges whole cycles apart that led to the candidate; 0: there is none. */
    bool tracking;               /* Phase and period are known. */
    bool compared;               /* phase_ticks comes from a wire that is not followed. */
    uint32_t edge_cycle;         /* Cycle that the last good edge began. */
    uint32_t cycle_shift;        /* What is added to the count of cycles to give their numbers. */
    uint32_t candidate_chip;     /* Next absolute chip to plan when the candidate came. */
    uint64_t candidate_position; /* Position of the candidate's message, or with a wire of the edge itself. */
    int32_t candidate_since;     /* Time from the candidate's edge to its message, the master's ticks. */
    struct {
        uint32_t position;
        uint32_t cycle;
        uint16_t code_chip;
        uint16_t period_ticks;
    } history[CHIP_CLOCK_HISTORY]; /* Planned chips, by absolute chip modulo CHIP_CLOCK_HISTORY. */
} chip_clock_t;

/* Set the clock to absolute chip 0, cycle 0, code chip 0, with the source chip_clock_wire.
 * Returns false, with nothing done, for a configuration outside the ranges above. */
bool chip_clock_init(chip_clock_t *clock, const chip_clock_config_t *config);

/* Plan the next absolute chip; the first call plans chip 0. Costs about 55 instructions. Returns the planned chip. */
chip_clock_chip_t chip_clock_plan(chip_clock_t *clock);

/* Take a rising edge of the sync wire, which came so many ticks after the start of an absolute chip. An edge in a chip
 * that is not planned yet or is forgotten is rejected. Costs at most about 670 instructions (64-bit divisions).
 * Returns true if the estimate now counts this edge. */
bool chip_clock_edge(chip_clock_t *clock, uint32_t chip, uint16_t ticks);

/* How well a clock has the time. */
typedef struct {
    uint32_t age_us;   /* Time since the last edge that counted; UINT32_MAX: there was none. */
    int32_t rate_ppb;  /* Rate of the own oscillator minus that of the master's chips. */
    uint32_t error_ns; /* Estimated error of a chip's edge; UINT32_MAX: not known. 0 for a master. */
} chip_clock_quality_t;

/* Tell how well the clock has the time; the context is that of chip_clock_plan, ticks_per_us are the clock's. Costs
 * about 400 instructions. */
chip_clock_quality_t chip_clock_quality(const chip_clock_t *clock, uint32_t ticks_per_us);

/* Look up what was planned for an absolute chip. Costs about 20 instructions. Returns false, with *planned untouched,
 * if the chip is not planned yet or is more than CHIP_CLOCK_HISTORY chips ago. */
bool chip_clock_at(const chip_clock_t *clock, uint32_t chip, chip_clock_chip_t *planned);

/* Returns whether an edge that does not fit came within the last cycle, and none of the own master in it or the one
 * before: the owner then reports no cycle as synchronous, though the clock may be locked. Costs about 15 instructions.
 */
bool chip_clock_contested(const chip_clock_t *clock);

/* ---- Instead of the wire: messages of the master. ---- */

/* Mark the moment so many ticks, at most two chips, after the start of an absolute chip. Costs about 50 instructions.
 * Returns false, with *mark untouched, for a chip that is not planned yet or is forgotten. */
bool chip_clock_mark(const chip_clock_t *clock, uint32_t chip, uint32_t ticks, chip_clock_mark_t *mark);

/* Take a message: at the mark the master's cycle had lasted master_ticks of the master's own ticks; a negative number
 * says that the cycle was to begin in so many. The number lies within 0.4 s; a larger one is rejected and counted. The
 * mark may lie up to 12 s back. Costs at most about 900 instructions (64-bit divisions).
 * Returns true if the estimate now counts this edge: chip_clock_number_cycle may then tell which cycle it began. */
bool chip_clock_message(chip_clock_t *clock, const chip_clock_mark_t *mark, int32_t master_ticks);

/* ---- Instead of the wire: an estimate made elsewhere (acquire.h). The context is that of chip_clock_edge; a master
 * ignores these calls. ---- */

/* Take over that the master begins chip 0 of some cycle at edge (a position with 32 fractional bits) and that its chip
 * lasts period (32 fractional bits; limited as the estimate always is), as from the wire while searching. The label
 * jumps and the lock is lost. The edge may lie up to 12 s back. Costs about 200 instructions. */
void chip_clock_jump(chip_clock_t *clock, uint64_t edge, uint64_t period);

/* Move the estimate by phase (32 fractional bits; positive: chips start later) and its period by period.
 * residual_ticks becomes phase_ticks (unless a wire is compared), and locked becomes `locked`. The call counts as an
 * edge of the present cycle for the hold-over; a drift that was learnt is forgotten. Costs about 40 instructions. */
void chip_clock_correct(chip_clock_t *clock, int64_t phase, int64_t period, int32_t residual_ticks, bool locked);

/* Let the own chips begin so many ticks after the master's from now on, in place of late_ticks before. The label, the
 * lock and the rate stay; the planner slews. What compares a wire or a message with the clock allows for it. Costs
 * about 10 instructions. */
void chip_clock_late(chip_clock_t *clock, int16_t ticks);

/* Begin with another source of edges, from main. The clock is then unlocked, searching, not detuned and not late;
 * phase and period stay until the new source tells better. */
void chip_clock_forget(chip_clock_t *clock, const chip_clock_source_t *source);

/* Returns own ticks, at most 0.4 s of them, as a message of this clock tells them to others: a chip of it has the
 * nominal number, whatever its period is. Costs about 100 instructions. */
int32_t chip_clock_told(const chip_clock_t *clock, int32_t ticks);

/* Tell how early the clock is against such a message, ticks, without following it; late_ticks is no error. Costs
 * about 150 instructions.
 * Returns false, with *phase untouched, if master_ticks is beyond 0.4 s. */
bool chip_clock_phase(const chip_clock_t *clock, const chip_clock_mark_t *mark, int32_t master_ticks, int32_t *phase);

/* Go over to another source whose edges were compared and lie within the gate; phase, period, drift and lock stay. The
 * gains are those of a settled clock from the first edge on, so that the difference is slewed off. */
void chip_clock_change(chip_clock_t *clock, const chip_clock_source_t *source);

/* Take an edge of a wire that is there but is not followed. From now on phase_ticks is the difference to the wire, not
 * to the source that is followed, late_ticks included.
 * Returns whether the edge lies within the gate of where the master's cycle is to begin. */
bool chip_clock_compare(chip_clock_t *clock, uint32_t chip, uint16_t ticks);

/* ---- Leading; from the context of chip_clock_plan. ---- */

/* Become the master: phase and period go on as they are. With `anew`, for a clock that never followed anybody, the next
 * chip that is planned is chip 0 of cycle 0. */
void chip_clock_lead(chip_clock_t *clock, bool anew);

/* Follow, and keep the lock: the caller has seen that the clock is within the source's gate of what it is to follow.
 * The next edges decide, with the gains of a clock that has just found its master. */
void chip_clock_yield(chip_clock_t *clock, const chip_clock_source_t *source);

/* Tell, on a SYNC message, that the cycle which the last good edge began has this number. All cycles that
 * chip_clock_plan and chip_clock_at tell from now on are counted from it, modulo 2^32; a SYNC has 20 bits, so only
 * those are to be compared. The call must come within a cycle of the edge. */
void chip_clock_number_cycle(chip_clock_t *clock, uint32_t cycle);

#endif
