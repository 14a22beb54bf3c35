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
 * wrong place. A track that starts vague (tracking_judge.h) stays weak until TRACKING_VAGUE_CYCLES cycles were located,
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

#include "services/tracking_state.h"

/* Read the parameters again, and give up the track. Costs about 50 instructions a code. */
void tracking_configure(tracking_t *tracking, onboard_t *onboard, const parameters_t *parameters);

/* Returns whether the next block may be given; if not, it is to wait. */
bool tracking_takes(const tracking_t *tracking);

/* Take the sums of a block, if active, and send its pose if it is due. more tells that others wait behind it. */
void tracking_take(tracking_t *tracking, node_t *node, const block_sums_t *sums, bool more);

/* Do a step of the search, if there is one. Returns whether there was. */
bool tracking_search(tracking_t *tracking, node_t *node);

#endif
