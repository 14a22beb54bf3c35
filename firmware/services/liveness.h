/* liveness.h: the watchdog is fed only while every part of the firmware moves. A processor that still turns its main
 * loop while a timer, a DMA stream or a converter stands still would otherwise hold a coil at its last current for
 * ever.
 *
 * Calls, in the order they are made
 *   1. liveness_start   main, once, before the chip engine starts.
 *   2. liveness_moved   wherever a part has moved: the first three in interrupts, each in one alone.
 *   3. liveness_step    main, once a turn in which liveness_due, which is how the main loop itself is watched.
 *
 * The watchdog is fed when each part that the role needs, and the clock, has moved since it was fed last: without a
 * clock it is never time to look. Once a part has not moved for LIVENESS_PATIENCE_US, the parts that stand still are
 * noted for the next run (hal_note_stalled). The board is reset 0.34 to 0.94 s after the last feeding (0.5 s of an
 * oscillator of 32 kHz that may run at 17 to 47 kHz), which may come LIVENESS_PERIOD_US after a part has stopped.
 *
 * A dead CAN bus is no reason to restart, nor is a serial port that nobody listens to: only a port that does not send
 * what it was given.
 *
 * Time: a step, once in 15 ms, takes about 130 instructions. Memory: 48 bytes.
 */
#ifndef GOLDFIELD_LIVENESS_H
#define GOLDFIELD_LIVENESS_H

#include "hal/hal.h"

/* Time after a feeding until the next look, us: in it each part moves, as a rule. */
#define LIVENESS_PERIOD_US   15000u
#define LIVENESS_PATIENCE_US 100000u /* Time without a move after which a part counts as standing still, us. */
#define LIVENESS_GOOD_BLOCKS 4u /* Blocks without an overrun of the converters that count as a move of the samples. */

/* The numbers are the bits of RESET_REPORT.stalled. */
typedef enum {
    LIVENESS_BLOCKS = 0,   /* plan() was called. */
    LIVENESS_CURRENTS = 1, /* current() was called (beacon, anchor). */
    LIVENESS_SAMPLES = 2,  /* samples() was called (sensor, anchor). */
    LIVENESS_LINK = 3      /* The serial port has sent bytes, or has none to send. */
} liveness_part_t;

#define LIVENESS_PARTS 4u

typedef struct {
    hal_t *hal;
    volatile uint32_t moves[LIVENESS_PARTS];
    uint32_t seen[LIVENESS_PARTS]; /* The moves when the watchdog was fed. */
    uint32_t needed;               /* A bit for each part that must move. */
    uint32_t overruns;             /* Overruns of the converters, as counted last. */
    uint32_t fed_us;               /* Time when the watchdog was fed, modulo 2^32. */
} liveness_t;

/* Begin to watch the parts that a role has; without a chip engine (HAL_CLOCK_SLOW) that is the link alone. */
void liveness_start(liveness_t *liveness, hal_t *hal, hal_role_t role);

/* [any] Tell that a part has moved. */
static inline void liveness_moved(liveness_t *liveness, liveness_part_t part) {
    liveness->moves[part] = liveness->moves[part] + 1u;
}

/* now_us is the time that hal_microseconds() told last. Returns whether it is time to look again. */
static inline bool liveness_due(const liveness_t *liveness, uint64_t now_us) {
    return (uint32_t)now_us - liveness->fed_us > LIVENESS_PERIOD_US;
}

/* Feed the watchdog, or note what stands still. */
void liveness_step(liveness_t *liveness, uint64_t now_us);

#endif
