/* gold.h: Gold codes from two linear feedback shift registers, any code of the family from any chip on.
 *
 * Degree n, length N = 2^n - 1 chips. Both registers u and v are Fibonacci registers, start with all ones, and give out
 * stage n. A polynomial 1 + x^a + ... + x^n means: the sum of stages a, ..., n enters stage 1. Bit 1 is chip -1, bit 0
 * is chip +1. The family:
 *   index k = 0..N-1: u[t] XOR v[(t + k) mod N];   index N: u;   index N+1: v;   N + 2 codes in all.
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
 * Every pair is proved preferred by the tests: three-valued cross-correlation over all shifts. Degree 8 has no
 * preferred pair.
 *
 * How a jump works. A later output is a linear functional of the present state: v[t + k] = <w_k, state(t)>, the sum
 * over GF(2) of the state's bits where w_k has ones. w_0 picks stage n, and w_(k+1) follows from w_k by one shift; w_k
 * as a power in GF(2^n) takes n squarings. States and functionals share one layout: bit j - 1 is stage j.
 *
 * Memory: no tables but the polynomials. Nothing here fails silently: a wrong degree or code is refused by gold_start.
 */
#ifndef GOLDFIELD_GOLD_H
#define GOLDFIELD_GOLD_H

#include <stdbool.h>
#include <stdint.h>

#define GOLD_DEGREE_MAX 11u
#define GOLD_LENGTH_MAX 2047u

typedef struct {
    uint16_t degree; /* n */
    uint16_t length; /* N = 2^n - 1 */
    uint16_t u_taps; /* Bit j - 1: stage j is fed back. */
    uint16_t v_taps;
} gold_family_t;

/* The family of a degree (5, 6, 7, 9, 10, 11), a constant; NULL for another degree. */
const gold_family_t *gold_family(uint32_t degree);

/* Sum of 16 bits over GF(2). */
static inline uint32_t gold_parity(uint32_t bits) {
    bits ^= bits >> 8;
    bits ^= bits >> 4;
    return 0x6996u >> (bits & 15u) & 1u; /* The parities of 0..15. */
}

/* The register one chip later. About 10 instructions. state is 1..N (0 never occurs in a running register and would
 * stay 0). */
static inline uint16_t gold_step(uint16_t taps, uint16_t state, uint16_t length) {
    return (uint16_t)(((uint32_t)state << 1 | gold_parity((uint32_t)state & taps)) & length);
}

/* w_k of a register: output t + k is the parity of (w_k & state(t)). Any k; bound: 11 squarings, about 1100
 * instructions. */
uint16_t gold_functional(const gold_family_t *family, uint16_t taps, uint32_t k);

/* The next functional, w_(k+1) from w_k. About 5 instructions. */
uint16_t gold_next_functional(uint16_t taps, uint16_t functional);

/* One code, chip after chip. The caller owns it; fields are private. */
typedef struct {
    const gold_family_t *family;
    uint16_t u_state, v_state;
    uint16_t u_mask, v_mask; /* The output stage, or 0 if the register is not part of this code. */
} gold_generator_t;

/* Start a code at a chip (any number; it counts modulo N). False, and the generator untouched, for a degree without
 * family or a code above N + 1. Bound: about 3000 instructions. */
bool gold_start(gold_generator_t *generator, uint32_t degree, uint32_t code, uint32_t chip);

/* The bit of the present chip (0: chip +1, 1: chip -1); moves on to the next. About 30 instructions. */
uint8_t gold_next(gold_generator_t *generator);

/* Sum of the chips of one period: -1 means balanced. In a family of degree 10 it is -1 for 769 codes, 63 for 136,
 * -65 for 120. For a code that does not exist 0, which is no code's sum. Bound: N calls of gold_next, 47,000
 * instructions for degree 10. */
int32_t gold_sum(uint32_t degree, uint32_t code);

#endif
