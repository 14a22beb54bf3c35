/* tracking_state.h: what the parts of the sensor's own track (tracking.h) share: its state, and the limits of its
 * decisions.
 */
#ifndef GOLDFIELD_TRACKING_STATE_H
#define GOLDFIELD_TRACKING_STATE_H

#include "core/track/block_errors.h"
#include "core/track/block_filter.h"
#include "services/blocks.h"
#include "services/onboard.h"

#define TRACKING_CHIP_S ((float)HAL_CHIP_TICKS / (float)HAL_TICKS_PER_SECOND) /* Length of a chip, s. */

#define TRACKING_COLUMNS_A_BLOCK 21u  /* Most columns that the fields of one block are separated for. */
#define TRACKING_DOUBTS          3u   /* Blocks in a row that do not fit, from which on poses are inconsistent. */
#define TRACKING_PATIENCE        5u   /* Starts that do not agree with the site, after which one is taken as it is. */
#define TRACKING_VAGUE_CYCLES    2u   /* Cycles that are located before a track that started weak is believed. */
#define TRACKING_UNREST_CYCLES   10u  /* Cycles for which such a track is restless. */
#define TRACKING_ASTRAY          3.0f /* Deviations by which a track and a cycle differ that contradict each other. */
#define TRACKING_ERRORS_BLOCKS   33u  /* Blocks from one covariance by the errors of the site to the next. */

typedef enum {
    TRACKING_LOST,     /* The next block begins a start. */
    TRACKING_SEARCHES, /* The fields of a start are being located. */
    TRACKING_FOLLOWS   /* There is a track. */
} tracking_state_t;

/* Private but for tests. */
typedef struct {
    onboard_t *onboard;     /* Has the site, tells what the cycles say, and lends its memory. */
    uint32_t every;         /* A pose every so many blocks; 0: the track is not active. */
    uint32_t count;         /* Codes, and beacons. */
    bool able;              /* They can be tracked. */
    tracking_state_t state; /* What the next call is about. */
    loop_t coils[BLOCK_BEACONS];
    block_beacon_errors_t beacon_errors[BLOCK_BEACONS];
    block_select_t select;      /* Those that have columns in the blocks of a track, ... */
    uint32_t selected;          /* ... since the block of this number; ... */
    loop_t used[BLOCK_BEACONS]; /* ... their coils and errors. */
    block_beacon_errors_t used_errors[BLOCK_BEACONS];
    block_site_errors_t errors;
    bool exact;                  /* No errors are declared. */
    float site_covariance[6][6]; /* That by the errors of the site. */
    uint32_t errors_number;      /* The block that it is from. */
    block_filter_t filter;
    block_t *block;          /* The block at work, and the blocks that a start gathers; lent by sense.h. */
    uint32_t number;         /* The number of the latest block. */
    uint32_t cycle, chip;    /* Cycle and code chip of its first sample. */
    uint32_t gathered;       /* Blocks that a start has gathered. */
    uint32_t contradictions; /* Starts that did not agree with the site, since the last track. */
    uint32_t misfits; /* Blocks that did not fit what was predicted (block_residual.h), less those that did since. */
    uint32_t worst, accused;   /* The beacon that fitted worst, and in how many blocks in a row. */
    uint32_t suspect;          /* The beacon that is left out for that until a cycle tells more, or POSE_NOBODY. */
    block_cycle_t moving;      /* What the track makes of the cycle under way. */
    float behind_s;            /* How far the filter's state lies behind the middle of the latest block, s. */
    pose_work_t *work;         /* Lent, during a search. */
    pose_t start;              /* What the search found. */
    onboard_verdict_t verdict; /* What holds for the poses. */
    bool doubted;              /* Blocks did not fit the track before this one. */
    uint32_t vague;            /* Cycles that are to be located before the track is believed. */
    uint32_t unrest;           /* Cycles in which the track is restless, as it started vague. */
    bool rests;                /* Meanwhile: the next cycle is located as that of a sensor at rest; ... */
    bool unfit;                /* ... the one before did not agree with the site. */
    bool ambiguous;            /* When it started, another pose explained the fields as well. */
    uint32_t judged;           /* The verdict of onboard.h that was last looked at. */
} tracking_t;

#endif
