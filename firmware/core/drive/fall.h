/* fall.h: watches how fast the current of one coil falls at a chip's edge, and tells when turns of the coil are
 * shorted.
 *
 * Calls: fall_edge once a chip, behind its edge, from the interrupt of the current sense. The caller zeroes fall_t
 * after a reset, and never again: what was learned of a coil holds until somebody takes the power away to mend it.
 *
 * Why. Where the current shall turn or end, the bridge puts the supply V against it, and it falls by V t / L until it
 * is where it shall be. At the end of the chip it is there, with whatever coil: nothing tells then that turns are
 * shorted. A few microseconds behind the edge (hal.h says how many) a sound coil is still on its way. Shorted turns are
 * the secondary of a transformer, whose leakage alone an edge sees: a share f of the turns with the coupling k leaves
 * about (1 - f)^2 (1 - k^2) of L, a tenth with .9 a sixth of it. Copper's temperature counts for nothing there (1.5 of
 * 120 V), nor does the driver's gain, which says where the current goes and not how fast; the supply is measured.
 *
 * What is learned. The rate r = fall / supply of a coil is the mean of the first FALL_LEARNED falls that were on their
 * way: not beyond half of it. That is in the ramp of the first start after a reset. A coil whose current does not begin
 * to be on its way is not watched: FALL_MINIMUM counts of it, and two falls' worth of way, are needed.
 *   FALL_ROW falls in a row beyond FALL_FAST times r V are a short: CAUSE_EXCESS. Falls with so little way that a
 * short could not go so far are left aside.
 *
 * What it does not see: turns that were shorted when the coil was learned (the field for an ampere tells: a sensor's
 * host finds the beacon's current wrong), a rotating field, whose current turns in small steps, and a coil whose
 * amplitude is reached within two falls.
 *
 * Contexts: one. It uses the floating-point unit. Memory: 8 bytes.
 */
#ifndef GOLDFIELD_FALL_H
#define GOLDFIELD_FALL_H

#include <stdint.h>

#include "core/drive/cause.h"

#define FALL_LEARNED 16u /* Falls of which the rate is the mean. */
#define FALL_ROW     2u  /* Successive falls that are too fast for a sound coil: one may be a disturbance. */
#define FALL_MINIMUM 128 /* Least current that falls, counts of the sense: 1 A. */
/* So many times the learned rate is too fast. A plate of metal beside the coil, which is a shorted turn, too, would
 * have to share .6 of its flux (k^2 = .37) for that. */
#define FALL_FAST 1.6f

/* Fields are private but for learned. */
typedef struct {
    float rate;      /* Counts of the sense for a count of the supply. */
    uint8_t learned; /* Falls in the rate: the coil is watched with FALL_LEARNED. */
    uint8_t fast;    /* Falls in a row that were too fast. */
} fall_t;

/* What is known behind a chip's edge. */
typedef struct {
    int32_t before;  /* Current at the end of the chip before, counts of the sense. */
    int32_t wanted;  /* Current that is asked for, counts of the sense with its sign; 0 if the chip is not driven. */
    int32_t came;    /* Current behind the edge, counts of the sense. */
    uint32_t supply; /* Supply of the bridge, counts; 0: it is not known, and no fall is judged. */
} fall_edge_t;

/* Take the current behind a chip's edge. Costs about 15 instructions, 50 if the current falls. Returns CAUSE_NONE, or
 * CAUSE_EXCESS if turns are shorted. */
cause_t fall_edge(fall_t *watch, const fall_edge_t *edge);

#endif
