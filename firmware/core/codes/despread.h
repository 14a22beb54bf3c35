/* despread.h: the correlation of one cycle of samples with every Gold code of a degree at once, on three axes. Results
 * are exact integers.
 *
 * Calls, in the order they are made
 *   1. despread_start        at the cycle's first chip.
 *   2. despread_store        for each chip of the cycle in order, or despread_skip for chips without a sample.
 *   3. despread_transform    once, at the end.
 *   4. despread_correlation  for each axis and code that is wanted; despread_word tells where a code's result is.
 * A chip without a sample counts as zero and is counted in missing. Samples should be near zero on average, else a
 * hole costs (mean / 1023) per chip on every code.
 *
 * Method. Shift k of a maximum-length sequence is a linear functional of the register's state, v[t+k] = <w_k,
 * state_v(t)>. The sample of chip t, sign-flipped by u[t], is stored at the address state_v(t). One in-place
 * Walsh-Hadamard transform W[w] = sum_a (-1)^<w,a> X[a] then holds
 *   sum_t c_k[t] y[t] = W[w_k] for the codes k = 0..N-1, and W[0] for code N (u).
 * Code N + 1 (v) lacks the sign of u and is not in the transform: it is summed while samples are stored, as is the
 * plain sum (offset). The chip of a bit b is 1 - 2b. Results are sums over the cycle in the samples' unit; they are
 * divided by N for FIELD and EPOCH_OFFSET.
 *
 * Exactness. Samples are 16 bits: |y| <= 2^15. Every intermediate of the transform is a sum of at most 2^degree <=
 * 2^11 stored words with signs, so it is at most 2^26 in magnitude; a sign-flipped -2^15 is +2^15, held in 32 bits.
 * int32_t cannot overflow, nothing is rounded, every result is an exact integer.
 *
 * Contexts: one despread_t belongs to one context at a time.
 *
 * Memory: 24,616 bytes, with room for degree 11; a shorter code uses the first 2^degree words of each axis. Sampling
 * one cycle while reading the last takes two despread_t.
 *
 * Time: instruction counts here and in the other headers are of a Cortex-M4, gcc 12 -O2, counted in Unicorn by
 * tests/firmware/core/test_instructions.py.
 */
#ifndef GOLDFIELD_DESPREAD_H
#define GOLDFIELD_DESPREAD_H

#include <stdint.h>

#include "core/codes/gold.h"

#define DESPREAD_AXES      3u                     /* Axes of a sample: x, y, z. */
#define DESPREAD_WORDS_MAX (GOLD_LENGTH_MAX + 1u) /* Words of one axis: one for each state of degree 11, and for 0. */
#define DESPREAD_WORD_V    0xFFFEu                /* The word of code N + 1 (v); no address of a transform. */
#define DESPREAD_WORD_NONE 0xFFFFu                /* The word of a code that does not exist; its correlation is 0. */

typedef struct {
    int32_t words[DESPREAD_AXES][DESPREAD_WORDS_MAX]; /* Signed samples by state; after the transform correlations. */
    const gold_family_t *family;
    int32_t v_sum[DESPREAD_AXES]; /* Correlation with code N + 1 (v). */
    int32_t sum[DESPREAD_AXES];   /* Plain sum of the samples. */
    uint16_t u_state, v_state;    /* The registers at the next chip. */
    uint16_t chip;                /* The next chip, 0..N; at N the cycle is full. */
    uint16_t missing;             /* Chips without a sample so far; after the transform, in the whole cycle. */
} despread_t;

/* Begin a cycle of the family's codes at chip 0. Costs about 20 instructions: each cycle overwrites every word. */
void despread_start(despread_t *despread, const gold_family_t *family);

/* Store the sample of the next chip. It is ignored when the cycle is full. Costs about 95 instructions. */
void despread_store(despread_t *despread, const int16_t sample[DESPREAD_AXES]);

/* Pass over the next chips, which have no sample, up to the end of the cycle. Costs about 60 instructions a chip, at
 * most N chips. */
void despread_skip(despread_t *despread, uint32_t chips);

/* End the cycle (the rest counts as missing) and transform it in place. It is called once; results are valid
 * until despread_start. Cost for three axes, whatever the data:
 *   degree              5      6      7       9      10       11
 *   instructions    1,050  2,130  5,230  24,300  57,000  124,600 */
void despread_transform(despread_t *despread);

/* Tell where a code's correlation is. Costs about 1100 instructions: the caller should keep the result.
 * Returns the address w_k in the transformed words, 0 for code N (u), DESPREAD_WORD_V for code N + 1, and
 * DESPREAD_WORD_NONE for a code that does not exist. */
uint16_t despread_word(const gold_family_t *family, uint32_t code);

/* Read a correlation after despread_transform. Costs about 15 instructions.
 * Returns the sum over t of chip(code, t) * sample(t) for the code with this word; 0 for DESPREAD_WORD_NONE or an axis
 * above 2. */
int32_t despread_correlation(const despread_t *despread, uint32_t axis, uint16_t word);

#endif
