/* despread.h: the correlation of one cycle of samples with every Gold code of a degree at once, on three axes.
 *
 * Method (maths: shift k of a maximum-length sequence is a linear functional of the register's state, v[t+k] = <w_k,
 * state_v(t)>). The sample of chip t, sign-flipped by u[t], is stored at the address state_v(t). One in-place
 * Walsh-Hadamard transform W[w] = sum_a (-1)^<w,a> X[a] then holds
 *   sum_t c_k[t] y[t] = W[w_k] for the codes k = 0..N-1, and W[0] for code N (u).
 * Code N + 1 (v) lacks the sign of u and is not in the transform: it is summed while samples are stored, as is the
 * plain sum (offset). The chip of a bit b is 1 - 2b. Results are sums over the cycle in the samples' unit; divide by N
 * for FIELD and EPOCH_OFFSET.
 *
 * Exactness. Samples are 16 bits: |y| <= 2^15. Every intermediate of the transform is a sum of at most 2^degree <= 2^11
 * stored words with signs, so at most 2^26 in magnitude; a sign-flipped -2^15 is +2^15, held in 32 bits. int32_t cannot
 * overflow, nothing is rounded, every result is an exact integer.
 *
 * Use. despread_start; then for each chip of the cycle in order despread_store, or despread_skip for chips without a
 * sample; then despread_transform; then the results. A chip without a sample counts as zero and is counted in missing:
 * samples should be near zero on average, else a hole costs (mean / 1023) per chip on every code.
 *
 * Parts. despread_start_part begins with the cycle's next chips only: the results are then the sums over these chips,
 * and those of all parts add up to the cycle's.
 *
 * Memory: 24,616 bytes, room for degree 11; a shorter code uses the first 2^degree words of each axis. To sample one
 * cycle while reading the last, own two. Contexts: one despread_t belongs to one context at a time. Instruction counts
 * here and in the other headers: Cortex-M4, gcc 12 -O2, counted in Unicorn by tests/firmware/core/test_instructions.py.
 */
#ifndef GOLDFIELD_DESPREAD_H
#define GOLDFIELD_DESPREAD_H

#include <stdint.h>

#include "core/codes/gold.h"

#define DESPREAD_AXES      3u
#define DESPREAD_WORDS_MAX (GOLD_LENGTH_MAX + 1u)
#define DESPREAD_WORD_V    0xFFFEu
#define DESPREAD_WORD_NONE 0xFFFFu

typedef struct {
    int32_t words[DESPREAD_AXES][DESPREAD_WORDS_MAX];
    const gold_family_t *family;
    int32_t v_sum[DESPREAD_AXES];
    int32_t sum[DESPREAD_AXES]; /* Plain sum of the samples. */
    uint16_t u_state, v_state;  /* Of the next chip. */
    uint16_t chip;              /* Next chip, 0..end; end: full. */
    uint16_t end;               /* Chip at which the cycle, or the part of it, ends. */
    uint16_t missing;           /* Chips without a sample so far; after despread_transform: of the cycle or part. */
} despread_t;

/* Begin a cycle of the family's codes at chip 0. About 20 instructions: each cycle overwrites every word. */
void despread_start(despread_t *despread, const gold_family_t *family);

/* Begin a part of a cycle: so many chips (fewer at the cycle's end) from where the previous part, of the same
 * family, ended; previous NULL: from chip 0. The previous part must be full. About 4,000 instructions with degree
 * 10. */
void despread_start_part(despread_t *despread, const gold_family_t *family, const despread_t *previous, uint32_t chips);

/* The sample of the next chip. Ignored when the cycle is full. About 95 instructions. */
void despread_store(despread_t *despread, const int16_t sample[DESPREAD_AXES]);

/* The next chips have no sample. Stops at the end of the cycle or part. Bound: N chips of about 60 instructions. */
void despread_skip(despread_t *despread, uint32_t chips);

/* End the cycle or part (the rest counts as missing) and transform in place. Call once; results are valid until
 * despread_start. For three axes, whatever the data: degree 5 1,050, 6 2,130, 7 5,230, 9 24,300, 10 57,000, 11
 * 124,600 instructions. */
void despread_transform(despread_t *despread);

/* Where a code's correlation is: the address w_k in the transformed words, 0 for code N (u), DESPREAD_WORD_V for
 * code N + 1; DESPREAD_WORD_NONE for a code that does not exist. About 1100 instructions: keep it. */
uint16_t despread_word(const gold_family_t *family, uint32_t code);

/* After despread_transform: sum over t of chip(code, t) * sample(t), for the code with this word. DESPREAD_WORD_NONE
 * or an axis above 2 gives 0. About 15 instructions. */
int32_t despread_correlation(const despread_t *despread, uint32_t axis, uint16_t word);

#endif
