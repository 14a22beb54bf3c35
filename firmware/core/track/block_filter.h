/* block_filter.h: position, attitude, velocity and turn rate of a moving sensor from each block of 31 chips, in single
 * precision: 330 poses a second from the codes that run all the time. It is the filter of docs/blocks.md, where the
 * equations are; the same file runs on the sensor and in the host.
 *
 * Calls, in the order they are made
 *   1. block_filter_init    once, with coils and noise. The coils stay the caller's and must live on.
 *   2. block_filter_start   with the pose of one block, from core/pose by the fields of block_separate (block_out.h).
 *   3. block_filter_update  with each block (block_gram.h) and the time since the block before; a block that was lost
 *                           only makes that time longer.
 *                           block_filter_update_swept does the same with the sweep of the ambient field, for the host.
 *   4. block_filter_output  for the pose at the last sample, or at any other time near it.
 * When block_filter_lost returns true the start is due, at first and again after BLOCK_FILTER_REFUSALS blocks in a row
 * that no filter could believe. Until then blocks are predicted over.
 *
 * Method. A bank of BLOCK_FILTERS Kalman filters that differ in the agility they expect: white acceleration, of
 * position and of turn. One has the greatest of six agilities, the others those next to the likeliest one. Each block
 * is linearised once, at the prediction of the likeliest filter: nine observed numbers (position, attitude, ambient
 * field at the sensor) with their information. Each filter takes them, or refuses them by its gate. The filters are
 * mixed every 12 ms, and what they say together is output (block_mix.h).
 *
 * Units: uT, m, rad, s. Attitudes are quaternions x, y, z, w with B_site = R B_sensor; turns are in the site's frame.
 *
 * Accuracy. Poses differ from those of the same filter in double precision by at most a hundredth of their standard
 * deviations, a fiftieth with the sweep (tests/firmware/core/track/test_block_filter.py).
 *
 * Time (Cortex-M4, gcc 12 -O3 -ffp-contract=fast, counted in Unicorn by
 * tests/firmware/core/track/test_block_instructions.py): instructions of block_gram, block_filter_update and
 * block_filter_output together, most of them in the four filters.
 *   beacons                              8       16       32
 *   a block                         65,000   82,000  138,000
 *   each fourth, with mixing        76,000   93,000  149,000
 *   mean                            67,800   84,800  140,200
 *   of the time of 31 chips (509,000 cycles at 168 MHz), at so many cycles an instruction
 *     1                               13 %     17 %     28 %
 *     1.5                           20.0 %     25 %     41 %
 *     2.5                             33 %     42 %     69 %
 * With slopes that are kept a block takes as many with 8 beacons, and 1,300 more with 16.
 * Of 67,800, 41,000 are the updates of the four filters, 4,500 their predictions, 11,000 what the block tells, 4,500
 * the output, 2,500 the mixing, 2,200 the gram matrix.
 *
 * Contexts: one. Memory: block_filter_t 9.6 kB, block_t 9.1 kB; stack 2 kB.
 */
#ifndef GOLDFIELD_BLOCK_FILTER_H
#define GOLDFIELD_BLOCK_FILTER_H

#include <stdbool.h>
#include <stdint.h>

#include "core/pose/loop_field.h"
#include "core/track/block_gram.h"
#include "core/track/block_measure.h"
#include "core/track/block_mix.h"

#define BLOCK_FILTER_REFUSALS 10u /* Blocks in a row that all filters refuse, after which the track is lost. */

/* What the filter starts from: a pose at the middle of a block. */
typedef struct {
    float position_m[3], quaternion[4];
    float position_cov_m2[3][3], attitude_cov_rad2[3][3]; /* As in pose_t; the filter doubles the deviations. */
    float ambient_uT[3]; /* Ambient field in the sensor's frame, from the same block. */
    float ambient_sd_uT; /* Its standard deviation by noise, each component. */
} block_start_t;

/* A pose at an asked time. */
typedef struct {
    block_state_t state;
    float covariance[6][6]; /* Covariance of position (m) and a small turn in the site's frame (rad). */
    float chi_square;       /* Chi-square of the last block that was taken ... */
    uint32_t freedom;       /* ... and its degrees of freedom. */
} block_pose_t;

typedef struct {
    block_kalman_t filters[BLOCK_FILTERS];
    block_measure_t measure; /* Work of the last block. */
    const loop_t *coils;
    uint32_t count;   /* Coils. */
    uint32_t best;    /* The likeliest filter. */
    uint32_t least;   /* Which agility is the least that a filter has. */
    float unmixed_s;  /* Time since the filters were mixed. */
    uint32_t refused; /* Blocks in a row that all filters refused. */
    float chi_square; /* Chi-square of the last block that was taken, and its degrees of freedom. */
    uint32_t freedom;
    float log_likelihood; /* Logarithm of the likelihood of that block, by all filters. */
    bool keeps;           /* Slopes are kept while the sensor stands still: ... */
    bool kept;            /* ... those of the latest block are, ... */
    float kept_m2;        /* ... and where they were taken the variances of position ... */
    float kept_rad2;      /* ... and turn were these. */
} block_filter_t;

/* Begin without a track, for so many coils (at most BLOCK_BEACONS), which are the columns of the blocks in this order.
 */
void block_filter_init(block_filter_t *filter, const loop_t *coils, uint32_t count, float noise_uT);

/* Change the coils, between blocks: those of the columns of the next ones. The track goes on. */
void block_filter_coils(block_filter_t *filter, const loop_t *coils, uint32_t count);

/* Begin a track with any state and covariance of its errors. */
void block_filter_begin(block_filter_t *filter, const block_state_t *state,
                        const float covariance[BLOCK_STATES][BLOCK_STATES]);

/* Begin a track at the middle of the block that start is from. */
void block_filter_start(block_filter_t *filter, const block_start_t *start);

/* Returns whether there is no track: it has not been started, or not been believed for too long. */
bool block_filter_lost(const block_filter_t *filter);

/* Begin a track anew by a pose that tells better where it was: it is moved by what that pose, whose deviations it
 * takes, differs from the track's own at the same time, position from_m and attitude from. Its motion and field go on,
 * with the deviations of a start, or of what samples for so many seconds as the pose is from tell of a motion. Of the
 * field of there only its deviation is used. */
void block_filter_shift(block_filter_t *filter, const float from_m[3], const float from[4], const block_start_t *there,
                        float seconds);

/* Keep the slopes of the fields while the sensor stands still, for all that is known, or do not. A track whose pose is
 * so uncertain that the slopes differ over its errors needs it: it wanders within them, and where each block is
 * linearised anew their changes seem to tell what no block tells, so that it is soon sure of a wrong place. Only
 * block_filter_update keeps them, and after block_filter_init it does not. */
void block_filter_keep_slopes(block_filter_t *filter, bool keep);

/* Move on to the middle of a block, seconds after that of the block before, and take it. Without a track nothing
 * happens.
 * Returns false if no filter took the block: the state is then the prediction alone. Sums that are not finite or huge
 * are refused without being counted. */
bool block_filter_update(block_filter_t *filter, const block_t *block, float seconds);

/* The same, with the sweep of the ambient field, which tells more of the turn rate (block_sweep.h), for more time. */
bool block_filter_update_swept(block_filter_t *filter, const block_t *block, float seconds);

/* Move on by so many seconds without a block. */
void block_filter_predict(block_filter_t *filter, float seconds);

/* Compute the pose so many seconds after the middle of the last block (or a little before, if negative). The last
 * sample of a block of m chips is (m - 1) / 2 chips after its middle. */
void block_filter_output(const block_filter_t *filter, float seconds, block_pose_t *pose);

#endif
