/* onboard.h: the sensor's own pose: from one cycle's plain correlations to POSE_POSITION, POSE_ATTITUDE,
 * POSE_QUALITY and POSE_INTEGRITY on both links. It is active with parameter pose = 1.
 *
 * Calls, in the order they are made
 *   1. onboard_configure  at start, and when a parameter has changed.
 *   2. onboard_take       with each whole cycle: it copies the cycle's sums while they are there; before it, where the
 *                         sensor tracks its motion, onboard_take_track.
 *   3. onboard_step       at once, and again and again: each call does a step of the pose, the last one sends it, and
 *                         further ones review fields that do not agree with the site (pose_live.h).
 *
 * The beacon of place i in the code list is row i of the parameter beacons (docs/parameters.md), row i of survey
 * says how well it is known; these, noise, gain_sd and axis_sd give the weights, and half_space resolves the mirror of
 * coplanar coils. Where the sensor chooses its codes by their strength (parameter strongest), the code list only tells
 * which row a code has: all chosen codes are separated, those that are in the list have their beacons located from, and
 * all other rows count as not heard. A code that is listed twice makes every pose fail, then as always. Lost chips
 * scale the sums; saturated and lost ones widen the noise by the part of the offset that no longer cancels. Each cycle
 * that is taken gives four messages, whatever happens; status and reason tell. A cycle that is taken while the pose of
 * another is computed waits; if a further one comes before that is done, as with cycles of a few milliseconds or dozens
 * of beacons, the one that waits is answered as failed, and late is its reason.
 *
 * Contexts: main only. Memory: 24 kB. Time: a call takes as long as a step of pose.h. The separation takes about 25
 * instructions a code and axis. With nothing to do a call takes none.
 */
#ifndef GOLDFIELD_ONBOARD_H
#define GOLDFIELD_ONBOARD_H

#include "core/codes/epoch.h"
#include "core/codes/separation.h"
#include "core/pose/pose_live.h"
#include "core/track/block_cycle.h"
#include "services/node.h"

#define ONBOARD_NO_ROW 255u /* The code is of no beacon. */

/* What the location of a cycle came to, for the poses of blocks until the next (tracking.h). */
typedef struct {
    pose_status_t status; /* Not failed. */
    pose_reason_t reason;
    uint32_t left_out;  /* Row of the beacon that is not to be believed, or POSE_NOBODY. */
    float protection_m; /* Protection level, m. */
    bool by_track;      /* The cycle was located from what the track makes of it. */
    bool beside;        /* The track was there in the cycle, ... */
    float away_m;       /* ... so far from where it was located, m. */
    bool searched;      /* It was located with no prior. */
} onboard_verdict_t;

/* Private but for tests. */
typedef struct {
    bool active, due;                 /* Poses are wanted; a cycle has been taken and not been computed. */
    bool separable;                   /* The code list, or what was chosen of the cycle taken, can be separated. */
    bool chosen;                      /* Codes are chosen by their strength, ... */
    bool told_apart;                  /* ... no code is in the list twice, ... */
    uint16_t listed[EPOCH_CODES_MAX]; /* ... and these are the codes of the rows. */
    uint8_t rows[EPOCH_CODES_MAX];    /* The row of each code that is separated, or ONBOARD_NO_ROW. */
    float noise_T;                    /* Standard deviation of a sample, T. */
    separation_t separation;
    pose_site_t site;
    float sums[EPOCH_AXES][EPOCH_CODES_MAX]; /* Correlations of the cycle taken, later its fields, T. */
    float mean[EPOCH_AXES];                  /* Its mean field, T. */
    uint32_t cycle, located;                 /* Its number, and that of the cycle whose pose is being computed. */
    uint32_t chips;                          /* N, the chips in a cycle. */
    uint32_t missing, saturated;             /* Chips of it without a sample, and with a saturated one. */
    block_cycle_t moving;                    /* What the track makes of a cycle ... */
    uint32_t moving_cycle;                   /* ... of this number ... */
    bool moved;                              /* ... which is there ... */
    bool moving_rests, moving_doubted;       /* ... of a sensor at rest, of a track that may be another. */
    bool by_track, located_by_track;         /* The cycle taken, and the one that is computed, are such ones, ... */
    bool beside, located_beside;             /* ... or the track was there in them. */
    float located_m[3], located_q[4];        /* Where the track was in the latter, position and attitude. */
    pose_field_t fields[POSE_BEACONS_MAX];
    pose_live_t live;
    pose_t pose;
    onboard_verdict_t verdict; /* What the latest cycle with a pose came to. */
    uint32_t judged;           /* Cycles with a pose, modulo 2^32. */
    bool lent, owed;           /* The memory of the pose is lent; a cycle waited when it came back. */
} onboard_t;

/* Read the parameters and forget the pose that tracking starts from. chips is the number of chips in a cycle. A
 * selection that left out a code of the list makes every pose fail. Costs the reading of 11 parameters for each code.
 */
void onboard_configure(onboard_t *onboard, const parameters_t *parameters, uint32_t chips,
                       const epoch_selection_t *selection);

/* Take what the track makes of the cycle of a number, before onboard_take takes that cycle: it is located from this, as
 * if the sensor stood still in the middle of the cycle; if the sensor rests, from what the cycle is itself; with no
 * prior if it is doubted that the track is where it says. */
void onboard_take_track(onboard_t *onboard, const block_cycle_t *moving, uint32_t cycle, bool rests, bool doubted);

/* Take a whole cycle, if active and if it has any sample; one that waits is answered. Costs about 250 instructions a
 * code, with codes that are chosen by their strength 6 for each pair of them and the code list. */
void onboard_take(onboard_t *onboard, node_t *node, const epoch_sums_t *cycle, const epoch_calibration_t *calibration,
                  const epoch_selection_t *selection);

/* Do a step of the pose of the cycle taken, if there is one, and send it when it is complete; else of the review.
 * Returns whether there was anything to do. */
bool onboard_step(onboard_t *onboard, node_t *node);

/* Returns whether the memory of the pose can be lent. It cannot while a pose is computed, nor twice in a row while a
 * cycle waits. */
bool onboard_lends(const onboard_t *onboard);

/* Lend the memory of the pose, which onboard_lends promised; cycles wait until it is back. */
pose_work_t *onboard_lend(onboard_t *onboard);

/* Take it back. */
void onboard_take_back(onboard_t *onboard);

#endif
