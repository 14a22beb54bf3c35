/* tracking_cycles.h: what the cycles that onboard.h locates tell of the sensor's own track (tracking.h): which beacon
 * is left out and what poses are worth until the next one, and where the sensor was, if the track is vague, astray or
 * one of two.
 *
 * Contexts: main only. Time: next to nothing without a new cycle; with one some 200 instructions a beacon, and the
 * start of a track where it moves.
 */
#ifndef GOLDFIELD_TRACKING_CYCLES_H
#define GOLDFIELD_TRACKING_CYCLES_H

#include "services/tracking_state.h"

typedef enum {
    TRACKING_CYCLES_NOTHING, /* The track goes on. */
    TRACKING_CYCLES_MOVED,   /* It goes on from where a cycle was located: beacons are to be selected anew. */
    TRACKING_CYCLES_LOST     /* It is to be given up. */
} tracking_cycles_t;

/* Take the verdict of a cycle that was located since the last call, if any. */
tracking_cycles_t tracking_cycles_look(tracking_t *tracking);

#endif
