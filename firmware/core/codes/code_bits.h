/* code_bits.h: 31 successive chips of any Gold code of a family as the bits of a word, from any chip on.
 *
 * Calls, in the order they are made: code_bits_init once, then code_bits_at.
 *
 * Every code but the last two is u[t] XOR v[t + k] (gold.h). One period of u and of v, continued by the chips that a
 * word may reach beyond its end, holds them all: a code from any chip on is two words and an exclusive or, with no
 * register to keep running, and nothing to do when the chip clock jumps.
 *
 * Memory: 544 bytes.
 */
#ifndef GOLDFIELD_CODE_BITS_H
#define GOLDFIELD_CODE_BITS_H

#include "core/codes/gold.h"

#define CODE_BITS_CHIPS 31u                                              /* Chips in a word. */
#define CODE_BITS_WORDS ((GOLD_LENGTH_MAX + CODE_BITS_CHIPS) / 32u + 2u) /* Words of a period, continued. */

/* Fields are private. */
typedef struct {
    const gold_family_t *family;
    uint32_t u[CODE_BITS_WORDS], v[CODE_BITS_WORDS]; /* Bit t % 32 of word t / 32 is chip t. */
} code_bits_t;

/* Prepare for the codes of a family. Costs about 50 instructions a chip of the period. */
void code_bits_init(code_bits_t *bits, const gold_family_t *family);

/* Costs about 50 instructions. code is 0..N+1, chip any number, which counts modulo N. Returns the chips from this one
 * on: bit t is chip + t, 0 for +1 and 1 for -1; the highest bit is 0. */
uint32_t code_bits_at(const code_bits_t *bits, uint32_t code, uint32_t chip);

#endif
