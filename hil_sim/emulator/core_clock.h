/* core_clock.h: core cycles to picoseconds and back, exactly. core_clock_set() at each change of frequency, the other
 * two in between.
 *
 * Cycle c starts at base_ps + floor(((c - base_cycle) * period + fraction) / 2^64), period being picoseconds times
 * 2^64: a period's rounding error is below 1e-16 of it, so times do not depend on how a run is sliced. Range: 150 days
 * between two changes of frequency.
 */
#ifndef GOLDFIELD_CORE_CLOCK_H
#define GOLDFIELD_CORE_CLOCK_H

#include <stdint.h>

typedef unsigned __int128 clock_wide_t;

typedef struct {
    uint64_t base_cycle; /* The cycle of the last change of frequency, */
    int64_t base_ps;     /* the picosecond that it starts in, */
    uint64_t fraction;   /* and where in it, 2^-64 ps. */
    clock_wide_t period; /* Length of a cycle, 2^-64 ps. */
    double cycles_per_ps;
} core_clock_t;

/* Returns the picosecond at which a cycle starts. */
static inline int64_t core_clock_time(const core_clock_t *clock, uint64_t cycle) {
    return clock->base_ps +
           (int64_t)(((clock_wide_t)(cycle - clock->base_cycle) * clock->period + clock->fraction) >> 64);
}

/* Returns the first cycle that starts at or after time_ps. */
static inline uint64_t core_clock_cycle(const core_clock_t *clock, int64_t time_ps) {
    if (time_ps <= clock->base_ps) {
        return clock->base_cycle;
    }
    uint64_t cycle = clock->base_cycle + (uint64_t)((double)(time_ps - clock->base_ps) * clock->cycles_per_ps);
    while (cycle > clock->base_cycle && core_clock_time(clock, cycle - 1) >= time_ps) {
        cycle--;
    }
    while (core_clock_time(clock, cycle) < time_ps) {
        cycle++;
    }
    return cycle;
}

/* Cycles last 1/hz seconds from this one on. */
static inline void core_clock_set(core_clock_t *clock, uint64_t cycle, double hz) {
    const clock_wide_t position = (clock_wide_t)(cycle - clock->base_cycle) * clock->period + clock->fraction;
    clock->base_ps += (int64_t)(position >> 64);
    clock->fraction = (uint64_t)position;
    clock->base_cycle = cycle;
    clock->period = (clock_wide_t)(1e12 / hz * 0x1p64);
    clock->cycles_per_ps = hz * 1e-12;
}

#endif
