/* guard.h: looks at every measurement of one coil's current, driven or not, and tells what is wrong with it.
 *
 * Calls: guard_configure, then, once a chip from the interrupt of the current sense, guard_sample at its end and, where
 * the board measures there, guard_edge before it, behind its beginning and in its middle; also in chips that are not
 * driven and while the bridge is off.
 *
 * What is looked at, in this order
 *   over-current  |current| is above the limit. The rails of the converter are, too: what lies beyond is unknown.
 *   excess        |current| is above 1.375 times what was asked in this chip or in the one before (whichever asked for
 *                 more: a current may take a chip to fall) plus 0.5 A. No driver that current.h follows makes so much.
 *   overload      The mean square of the current, over an exponential window, is above the square of its limit (I2t).
 *
 * Units: those of current.h. Contexts: one, and guard_configure while no sample comes. Memory: 32 bytes.
 */
#ifndef GOLDFIELD_GUARD_H
#define GOLDFIELD_GUARD_H

#include <stdbool.h>
#include <stdint.h>

#include "core/drive/cause.h"

typedef struct {
    float over_current_A; /* Limit of the magnitude, A; more than 2046 counts of the sense is taken as that. */
    float rms_A;          /* Limit of the root mean square, A; 0 switches the overload protection off. */
    float rms_chips;      /* Time constant of the mean, chips, 1 or more. */
} guard_config_t;

/* Fields are private but for heat, the mean square in counts of the sense. */
typedef struct {
    uint16_t over_count;   /* Largest magnitude that is no fault, counts of the sense. */
    uint16_t before;       /* What the chip before asked for, counts of set-point. */
    uint16_t latest;       /* The most that explained the latest guard_sample. */
    uint32_t excess_scale; /* Most counts of sense for a count of set-point, 16 fractional bits. */
    uint32_t excess_count; /* And so many more. */
    float heat, heat_limit, heat_share;
} guard_t;

/* Take a configuration; reference_A is at most 8 times sense_A. The mean square stays as it is, since what is hot stays
 * hot, and so does what the chip before asked for, whose current may still fall. The caller zeroes guard_t after a
 * reset: what was asked before it nobody knows, and its current may still fall, so the first chip is not judged for
 * excess.
 * Returns false, with nothing done, if a value is out of range or not a number. */
bool guard_configure(guard_t *guard, const guard_config_t *config, float sense_A, float reference_A);

/* Take a measurement. asked is the size of the set-point, 0 if the chip is not driven; came is the sense's count from
 * its zero, -2048..2047. Costs about 30 instructions. Returns what is wrong, or CAUSE_NONE. */
cause_t guard_sample(guard_t *guard, uint32_t asked, int32_t came);

/* Take one more measurement of a chip, before its end, for over-current and excess. A drive that was switched off
 * just before the latest guard_sample still has its current: what explained that one explains this one, too. The mean
 * square and what is compared later are those of guard_sample. Costs about 15 instructions. Returns what is wrong, or
 * CAUSE_NONE. */
cause_t guard_edge(const guard_t *guard, uint32_t asked, int32_t came);

#endif
