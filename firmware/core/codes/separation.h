/* separation.h: computes the exact fields of synchronised Gold codes from their plain correlations and the mean, in
 * closed form. The calls are separation_init for a list of codes, then separation_apply for each axis of each cycle,
 * and separation_variance for the noise of a field.
 *
 * Method. With samples y = C b + offset, the plain sums r = C'y / N and mean = 1'y / N hold all that least squares on
 * [codes, 1] needs:
 *   A b = N r - s mean,   A = C'C - s s' / N,   s = C'1.
 * Any two different codes of a family but v (code N + 1) have the product -1, so that A = (N + 1) I - 1 1' - s s' / N:
 * a multiple of the identity and a matrix of rank two, whose inverse is that of a 2 x 2 matrix (Woodbury).
 *
 * Limits. The products with v take other values: lists with code N + 1 are refused, as are repeated codes, which
 * nothing can separate.
 *
 * Noise. With a standard deviation of noise on each sample, that of a component of b_i is noise sqrt((A^-1)_ii).
 *
 * Time: about 25 instructions a code and axis. Memory: 280 bytes.
 */
#ifndef GOLDFIELD_SEPARATION_H
#define GOLDFIELD_SEPARATION_H

#include <stdbool.h>
#include <stdint.h>

#define SEPARATION_CODES_MAX 64u /* Longest list of codes: as many as a sensor reports. */

typedef struct {
    uint32_t count;                   /* Codes in the list. */
    float chips;                      /* N, the chips in a cycle. */
    float sums[SEPARATION_CODES_MAX]; /* s, the sum of each code's chips. */
    float inverse[2][2];              /* The inverse of (N + 1) I - V'U with U = [1, s], V = [1, s / N]. */
} separation_t;

/* Prepare for a list of codes of N = chips with their sums (gold_sum).
 * Returns false, with count 0, if there are too many codes for this list or for so few chips, if a code is N + 1 or
 * above, or if one comes twice. */
bool separation_init(separation_t *separation, uint32_t chips, const uint16_t *codes, const int16_t *sums,
                     uint32_t count);

/* Turn the correlations of one axis into fields, in place. They and mean are sums over the same cycle divided by N. */
void separation_apply(const separation_t *separation, float mean, float *field);

/* Returns (A^-1)_ii: the variance of a component of field i over that of a sample. */
float separation_variance(const separation_t *separation, uint32_t index);

#endif
