/* strongest.h: finds the codes that a sensor hears, among all of its degree, in the transform of a cycle: the strongest
 * few, which stay chosen until they are clearly no longer among them. Nobody has to tell the sensor its beacons.
 *
 * Calls, in the order they are made
 *   1. strongest_init    once.
 *   2. strongest_choose  with each cycle, behind despread_transform; it changes the selection that epoch.h reports.
 *      strongest_clear   when the selection is to begin anew.
 *
 * Candidates are the codes 0..N. Any two of them have the product -1. Code N + 1 (v) has others with most of the
 * unbalanced ones, so that a beacon of it is heard in all of those: it is never chosen, and no beacon should have it.
 *
 * Strength. With the fields B_j of the codes j in the selection, as sums, and an offset o, a correlation is
 *   R_k = (N + 1) B_k - sum_j B_j + S_k o,   B_k = 0 of the others,   sum_t y[t] = sum_j S_j B_j + N o.
 * Summed over the selection, plainly and times S_k, these are two equations for the sum of all B_j and o. Then
 *   d_k = R_k + sum_j B_j - S_k o
 * is (N + 1) B_k of the codes in the selection and noise of all others, to the nearest integer; the strength of a code
 * is the sum of d_k^2 over the axes, exact in 64 bits. An axis at the rail adds nothing to it.
 *
 * Noise. Q is the upper quartile of the strengths of the codes that are not in the selection, interpolated in classes
 * a quarter of an octave wide, and at least N, that of half a count in each sample. Up to a quarter of those codes may
 * be heard all the same. With noise that is alike on three axes, of variance s^2 in d_k, Q is 4.11 s^2.
 *
 * Hysteresis
 *   enters    above 8 Q. Such noise does so in one of 2.9 million codes; noise along one line, as of a single cable's
 *             hum, in one of 880, that is one code a cycle with degree 10.
 *   stays     to 2.5 Q, below which it leaves. Such noise is above in 1.6 % of cases: a code that should not have come
 *             is gone with the next cycle. A code of |d| = 5.6 s enters in half of the cycles, one of 8.7 s in all but
 *             one of 1000; one of 6.1 s leaves in one cycle of 1000, one of 7.8 s in one of a million.
 *   replaces  the weakest, where the selection is full, above 2 (its strength + 8 Q): of two codes of equal field noise
 *             makes one replace the other in less than 1 of 30,000 cycles, as (a + b)^2 <= 2 (a^2 + b^2), and 8 Q is
 *             (5.7 s)^2, 4 standard deviations of a difference of two |d|. Without noise it is a factor of 1.41.
 *
 * Of newcomers of equal strength the lower code is preferred, of codes in the selection the one that comes last in it.
 *
 * Rounds. What enters changes the noise, as a code that is not in the selection leaks into all others: by 1/1000 of its
 * field, unbalanced ones into unbalanced ones by 1/200 (degree 10). So a round takes in only what is well above that of
 * the strongest newcomer, and then another one is made, up to STRONGEST_ROUNDS in a cycle. Codes leave in a round that
 * takes in none. With degree 10 three rounds reach 1/10,000 of the strongest field; what is below comes with the next
 * cycle.
 *
 * Order. A code that comes takes the place of one that it replaces, or the next place; when one leaves, those behind it
 * move up. So two codes that stay never change their order.
 *
 * Limits. At most (N + 1) / 8 codes are chosen, 4 of degree 5, 8 of degree 6 and 16 of degree 7: more could not be told
 * from what they leak. A cycle of which more than a quarter was not sampled changes nothing. Samples must be those of
 * a locked clock.
 *
 * Contexts: main only. Memory: 2.7 kB, and 1.3 kB of stack. Time, degree 10: see strongest_choose.
 */
#ifndef GOLDFIELD_STRONGEST_H
#define GOLDFIELD_STRONGEST_H

#include "core/codes/epoch.h"

#define STRONGEST_ROUNDS 3u /* Most rounds in a cycle. */

/* Fields are private, but for tests. */
typedef struct {
    const gold_family_t *family;
    uint8_t kinds[DESPREAD_WORDS_MAX];          /* By code 0..N: which of three sums it has, and if it is in. */
    int32_t adjust[3][EPOCH_AXES];              /* What a correlation needs to become d, by kind of sum. */
    uint64_t strengths[EPOCH_CODES_MAX], noise; /* Strengths by entry of the selection, and Q, of the latest round. */
} strongest_t;

/* Prepare for a family. What scratch held is lost. Costs 176,000 instructions with degree 10. */
void strongest_init(strongest_t *strongest, const gold_family_t *family, despread_t *scratch);

/* Empty the selection. */
void strongest_clear(strongest_t *strongest, epoch_selection_t *selection);

/* Choose at most so many codes of a cycle that has been transformed. The selection is that of the cycle before; only
 * this module has changed it since strongest_clear. Costs with degree 10, in a cycle in which nothing changes,
 * 70,000 instructions and 40 a code; where 8 come at once 184,000, and 350,000 where 64 do. A newcomer needs no search
 * for its word and its sum: the words are gone through in the order of the codes, and the sums are kept.
 * Returns whether the codes or their places changed. */
bool strongest_choose(strongest_t *strongest, const despread_t *despread, uint32_t most, epoch_selection_t *selection);

#endif
