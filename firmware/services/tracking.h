/* tracking.h: the sensor's own track: from the sums of each block of 31 chips to a pose at its end, by the block filter
 * (core/track/block_filter.h), sent as POSE_POSITION, POSE_ATTITUDE, POSE_QUALITY and POSE_INTEGRITY on both links. It
 * is active with the parameters pose = 1 and pose_blocks = n above 0: then every n-th block has a pose.
 *
 * Calls, in the order they are made
 *   1. tracking_configure  at start, and when a parameter has changed, after onboard_configure.
 *   2. tracking_takes      first of all in a turn, and before each block: whether it is to be given the next one.
 *      tracking_take       with the sums of each block in turn.
 *   3. tracking_search     in the turn's spare time: a step of a start.
 *
 * Start. With no track, the fields of one block (of two, with more than 20 codes) are separated and located with no
 * prior, by the search of core/pose in steps of bounded time. Until it is done tracking_takes is false: later blocks
 * wait, BLOCKS_WAITING of them, and then each has its pose, a little late. If nothing was found, the blocks that waited
 * are answered as failed, with the search's reason, and the latest of them is the next to start from. The track is lost
 * after BLOCK_FILTER_REFUSALS blocks in a row that were refused, did not fit or did not come, and starts again.
 *
 * One block may tell so little that nothing is linear over its errors, beside a coil above all, where the field is
 * known to a thousandth: the filter, which linearises each block where it believes the sensor then, is soon sure of a
 * wrong place. A track that starts vague stays weak until TRACKING_VAGUE_CYCLES cycles were located,
 * and begins anew with each of them (block_filter_shift); from then on, slopes are kept while the sensor stands still
 * (block_filter_keep_slopes). It begins anew with every later cycle that is vague itself, too: single cycles know
 * better than what the filter makes of several of them. Such a track is restless, and its unrest is in what it makes of
 * a cycle; so cycles are located as of a sensor at rest, unless that does not fit, for TRACKING_UNREST_CYCLES. One that
 * is found more than TRACKING_ASTRAY deviations away meanwhile moves the track, too. (The host fits the first blocks
 * together instead, for which there is no memory here.)
 *
 * Status. Single blocks are too noisy to tell that a beacon is not as the site says. Status, reason, the beacon left
 * out and the protection level of each pose are those of the latest cycle that onboard.h has located; before there is
 * one since the start, those of the start. With degree 10 cycles are located from what the track makes of them
 * (block_cycle.h), so that motion does not look like a fault; others count only where there is no such cycle because
 * blocks do not fit. A beacon that is left out has its column eliminated from each block (block_leave_out), and so has
 * one without a moment in the parameter beacons. Where TRACKING_PATIENCE single blocks fit no pose, a track starts all
 * the same: its poses are inconsistent, until the cycles tell which beacon to leave out. A beacon that fits worst and
 * does not fit in TRACKING_DOUBTS blocks in a row (block_residual.h) is left out at once, until such a cycle is located
 * well. If blocks do not fit all the same, or are refused by the filter, poses are inconsistent from the
 * TRACKING_DOUBTS-th in a row on, with reason "pending". So are those of a track that starts after one was lost for
 * that, unless the beacons were silent; it is given up if the first such cycle does not agree with the site either.
 *
 * A cycle that is located far from where the track is, by a quarter of the distance to the nearest beacon, ends it: far
 * from all beacons, where a block tells nothing, a wrong track contradicts none.
 *
 * A track that started where another pose explained the fields as well follows the likelier of them, and says so: its
 * poses are ambiguous, and its cycles located with no prior, until one of these tells that no other pose explains it.
 * If that is not where the track is, it starts again. (The host follows both in the meantime.)
 *
 * Limits. With the parameter strongest above 0 every pose fails: the filter has a column for each row of the beacons,
 * and what a block carries would change from cycle to cycle. Of more than BLOCK_SELECTED beacons that are believed the
 * strongest are used (block_select.h), in the blocks and in the cycles that are located from them. Codes: at most
 * BLOCK_BEACONS, and those that onboard.h can separate; otherwise every pose fails. Blocks come only while the chip
 * clock is locked; without any there are no poses.
 *
 * Covariance: that of the filter and, once in TRACKING_ERRORS_BLOCKS blocks, that by the declared errors of the site.
 *
 * Time, as tests/firmware/apps/test_track_instructions.py counts it (Cortex-M4, the objects of the image), with a pose
 * for each block; everything that a sensor does is in the share: interrupts, filter, messages, location of cycles.
 *   beacons                                                     8        16        32
 *   main for a block                                       79,000   106,000   126,000
 *   mean of all for a block                               111,000   149,000   169,000
 *   of the processor's time at 1 cycle an instruction        22 %      29 %      33 %
 *     at 1.5                                                 33 %      44 %      50 %
 *     at 2.5                                                 54 %      73 %      83 %
 * With 32 beacons the track uses the 16 that block_select.h selects.
 *   longest step of a start                               217,000   405,000   782,000
 *   all steps of a start                                  1.3 M     2.3 M     4.6 M
 *
 * Contexts: main only. Memory: 13 kB, in the core-coupled memory, and 9 kB lent by sense.h; the search works in that of
 * onboard.h, which is lent.
 */
#ifndef GOLDFIELD_TRACKING_H
#define GOLDFIELD_TRACKING_H

#include "core/track/block_errors.h"
#include "core/track/block_filter.h"
#include "services/blocks.h"
#include "services/onboard.h"

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

/* Read the parameters again, and give up the track. Costs about 50 instructions a code. */
void tracking_configure(tracking_t *tracking, onboard_t *onboard, const parameters_t *parameters);

/* Returns whether the next block may be given; if not, it is to wait. */
bool tracking_takes(const tracking_t *tracking);

/* Take the sums of a block, if active, and send its pose if it is due. more tells that others wait behind it. */
void tracking_take(tracking_t *tracking, node_t *node, const block_sums_t *sums, bool more);

/* Do a step of the search, if there is one. Returns whether there was. */
bool tracking_search(tracking_t *tracking, node_t *node);

#endif
