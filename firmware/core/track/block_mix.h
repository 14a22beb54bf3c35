/* block_mix.h: the filters of the bank of block_filter.h as interacting multiple models (Blom and Bar-Shalom, 1988):
 * how they learn from each other, and what they say together. docs/blocks.md has the equations.
 *
 * Calls: block_mix every few blocks, before a prediction; block_mix_weigh after each block; block_mix_output for a
 * pose.
 *
 * Time (Cortex-M4, -O3): block_mix 10,900 instructions, block_mix_output 4,400.
 */
#ifndef GOLDFIELD_BLOCK_MIX_H
#define GOLDFIELD_BLOCK_MIX_H

#include "core/track/block_kalman.h"

#define BLOCK_FILTERS 4u /* Filters of the bank. */

/* Mix the filters: each becomes what all say, with the probabilities that it was any of them until now. change is the
 * probability of a change from one filter to any given other. best is the one with the greatest probability. */
void block_mix(block_kalman_t filters[BLOCK_FILTERS], uint32_t best, float change);

/* Multiply the probabilities by the exponentials of the logarithms of likelihoods, and make their sum 1.
 * *together becomes the logarithm of the likelihood by all filters.
 * Returns the likeliest filter. */
uint32_t block_mix_weigh(block_kalman_t filters[BLOCK_FILTERS], const float likelihood[BLOCK_FILTERS], float *together);

/* Compute the state that all filters say together, so many seconds later, and the covariance of its position (m) and a
 * small turn in the site's frame (rad). */
void block_mix_output(const block_kalman_t filters[BLOCK_FILTERS], uint32_t best, float seconds, block_state_t *state,
                      float covariance[6][6]);

/* Compute what all filters say together as one filter, at the time of their states. */
void block_mix_whole(const block_kalman_t filters[BLOCK_FILTERS], uint32_t best, block_kalman_t *whole);

#endif
