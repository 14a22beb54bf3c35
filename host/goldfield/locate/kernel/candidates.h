/* Where a search starts: points at which the start beacon is as strong as measured and the others fit best.
 */
#ifndef GF_LOCATE_CANDIDATES_H
#define GF_LOCATE_CANDIDATES_H

#include "descent.h"

#define GF_CANDIDATES 8
#define GF_SPREAD     64

/* The coil that a search starts from: least apparent range (1.5 k/|b|)^(1/3) among those that stand out of the noise,
 * else the one that stands out most. */
size_t gf_start_coil(const gf_epoch_t *epoch);

/* The best local minima of Wahba's loss over the level set of a coil (three levels if it is noisy), the best first.
 * Returns how many there are, at most GF_CANDIDATES. The epoch's weights are changed. Bound: 1536 evaluations. */
size_t gf_candidates(gf_epoch_t *epoch, size_t coil, gf_pose_t out[GF_CANDIDATES]);

/* Points all over the level set of a coil, four a ring, with the attitudes that fit best there. The epoch's weights are
 * changed. Takes GF_SPREAD evaluations. */
void gf_spread(gf_epoch_t *epoch, size_t coil, gf_pose_t out[GF_SPREAD]);

/* Give a pose the attitude that fits best at its position. Takes one evaluation; the weights are used as they are. */
void gf_align(gf_epoch_t *epoch, gf_pose_t *pose);

#endif
