/* gold.h: Gold codes from two linear feedback shift registers. It gives any code of a family from any chip on.
 *
 * Calls, in the order they are made: gold_start with a degree, a code and a chip, then gold_next once for each chip.
 * despread.h uses the registers themselves: gold_family, gold_step, gold_functional and gold_next_functional.
 *
 * Family. Degree n has the length N = 2^n - 1 chips. Both registers u and v are Fibonacci registers, start with all
 * ones, and give out stage n. A polynomial 1 + x^a + ... + x^n means that the sum of stages a, ..., n enters stage 1.
 * Bit 1 is chip -1, bit 0 is chip +1. There are N + 2 codes in all:
 *   index k = 0..N-1    u[t] XOR v[(t + k) mod N]
 *   index N             u
 *   index N+1           v
 *
 * Preferred pairs (R. Gold, 1967). Degree 10 is that of GPS C/A (IS-GPS-200; G1 and G2): a satellite's G2 delay of d
 * chips is k = 1023 - d, so PRN 1 (d = 5) is k = 1018. The other degrees are the pairs published in the manual of
 * MathWorks' comm.GoldSequence:
 *   degree  length   u                v
 *      5      31     1+x^2+x^5        1+x^2+x^3+x^4+x^5
 *      6      63     1+x+x^6          1+x+x^2+x^5+x^6
 *      7     127     1+x^3+x^7        1+x+x^2+x^3+x^7
 *      9     511     1+x^4+x^9        1+x^3+x^4+x^6+x^9
 *     10    1023     1+x^3+x^10       1+x^2+x^3+x^6+x^8+x^9+x^10
 *     11    2047     1+x^2+x^11       1+x^2+x^5+x^8+x^11
 * The tests prove every pair preferred: its cross-correlation over all shifts has three values. Degree 8 has no
 * preferred pair.
 *
 * How a jump works. A later output is a linear functional of the present state, v[t + k] = <w_k, state(t)>: the sum
 * over GF(2) of the state's bits where w_k has ones. w_0 picks stage n, and w_(k+1) follows from w_k by one shift; w_k
 * as a power in GF(2^n) takes n squarings. States and functionals share one layout: bit j - 1 is stage j.
 *
 * Memory: there are no tables but the polynomials. Errors: nothing fails silently; gold_start refuses a wrong degree
 * or code.
 */
#ifndef GOLDFIELD_GOLD_H
#define GOLDFIELD_GOLD_H

#include <stdbool.h>
#include <stdint.h>

#define GOLD_DEGREE_MAX 11u   /* Largest degree of a family. */
#define GOLD_LENGTH_MAX 2047u /* Chips of its codes. */

typedef struct {
    uint16_t degree; /* n, the stages of each register. */
    uint16_t length; /* N = 2^n - 1, the chips of a code. */
    uint16_t u_taps; /* The stages of u that are fed back: bit j - 1 stands for stage j. */
    uint16_t v_taps; /* Those of v. */
} gold_family_t;

/* Returns the family of a degree (5, 6, 7, 9, 10, 11), a constant, or NULL for another degree. */
const gold_family_t *gold_family(uint32_t degree);

/* Returns the sum of 16 bits over GF(2). */
static inline uint32_t gold_parity(uint32_t bits) {
    bits ^= bits >> 8;
    bits ^= bits >> 4;
    return 0x6996u >> (bits & 15u) & 1u; /* The parities of 0..15. */
}

/* Move a register on by one chip. state is 1..N; 0 never occurs in a running register and would stay 0. Costs about 10
 * instructions. Returns the state one chip later. */
static inline uint16_t gold_step(uint16_t taps, uint16_t state, uint16_t length) {
    return (uint16_t)(((uint32_t)state << 1 | gold_parity((uint32_t)state & taps)) & length);
}

/* Compute the functional of a register for any k. Costs at most 11 squarings, about 1100 instructions.
 * Returns w_k: output t + k is the parity of (w_k & state(t)). */
uint16_t gold_functional(const gold_family_t *family, uint16_t taps, uint32_t k);

/* Returns the next functional, w_(k+1) from w_k. Costs about 5 instructions. */
uint16_t gold_next_functional(uint16_t taps, uint16_t functional);

/* One code, chip after chip. The caller owns it; fields are private. */
typedef struct {
    const gold_family_t *family;
    uint16_t u_state, v_state; /* The registers at the present chip. */
    uint16_t u_mask, v_mask;   /* The output stage, or 0 if the register is not part of this code. */
} gold_generator_t;

/* Start a code at a chip, any number, which counts modulo N. Costs at most about 3000 instructions.
 * Returns false, with the generator untouched, for a degree without family or a code above N + 1. */
bool gold_start(gold_generator_t *generator, uint32_t degree, uint32_t code, uint32_t chip);

/* Move on to the next chip. Costs about 30 instructions. Returns the bit of the chip before it (0: chip +1, 1: chip
 * -1), so that the first call gives the chip of gold_start. */
uint8_t gold_next(gold_generator_t *generator);

/* Sum the chips of one period. In a family of degree 10 the sum is -1 (balanced) for 769 codes, 63 for 136, -65 for
 * 120. Costs N calls of gold_next, 47,000 instructions for degree 10.
 * Returns the sum, or 0, which is no code's sum, for a code that does not exist. */
int32_t gold_sum(uint32_t degree, uint32_t code);

#endif
