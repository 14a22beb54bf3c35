/* fourier.h: the discrete Fourier transform of 2048 complex numbers, in place, in single precision, for long
 * correlations. The calls are fourier_forward, a product of spectra place by place, then fourier_inverse.
 *
 *   forward   X[k] = sum over t of x[t] exp(-2 pi i k t / 2048)
 *   inverse   2048 x[t] = sum over k of X[k] exp(+2 pi i k t / 2048)
 *
 * Method. Radix 2 (Cooley and Tukey, 1965). fourier_forward decimates in frequency and leaves bin k at the place whose
 * eleven bits are those of k reversed; fourier_inverse takes that order and decimates in time. So no numbers are
 * moved, and a product of two spectra place by place is a correlation. Twiddle factors follow each other by one
 * complex product, so there is no table; the relative error of a result is below 1e-4 of the largest.
 *
 * Limits: any finite numbers. Time: about 260,000 instructions (tests/firmware/core/test_instructions.py). Memory:
 * none but the array.
 */
#ifndef GOLDFIELD_FOURIER_H
#define GOLDFIELD_FOURIER_H

#include <stdint.h>

#define FOURIER_BITS   11u   /* Stages of the transform. */
#define FOURIER_LENGTH 2048u /* 2^FOURIER_BITS: the power of two that holds a cycle of 1023 chips twice. */

typedef struct {
    float re, im;
} fourier_t;

/* Transform in place, forward and back; the result of both is 2048 times the start. */
void fourier_forward(fourier_t x[FOURIER_LENGTH]);
void fourier_inverse(fourier_t x[FOURIER_LENGTH]);

/* Returns the place of bin k. k counts modulo 2048: bin -1 is 2047. */
uint32_t fourier_place(uint32_t k);

#endif
