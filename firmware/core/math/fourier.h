/* fourier.h: the discrete Fourier transform of 2048 complex numbers, in place, single precision; for long correlations.
 *
 * Radix 2 (Cooley and Tukey, 1965). fourier_forward decimates in frequency and leaves bin k at the place whose eleven
 * bits are those of k reversed; fourier_inverse takes that order and decimates in time. So no numbers are moved, and a
 * product of two spectra place by place is a correlation. Twiddle factors follow each other by one complex product: no
 * table; relative error of a result below 1e-4 of the largest.
 *     forward: X[k] = sum over t of x[t] exp(-2 pi i k t / 2048);   inverse: 2048 x[t] = sum over k of X[k] exp(+2 pi i
 *       k t / 2048)
 * Time: see tests/firmware/core/test_instructions.py; about 260,000 instructions. Memory: none but the array. Any
 * finite numbers.
 */
#ifndef GOLDFIELD_FOURIER_H
#define GOLDFIELD_FOURIER_H

#include <stdint.h>

#define FOURIER_BITS   11u
#define FOURIER_LENGTH 2048u

typedef struct {
    float re, im;
} fourier_t;

void fourier_forward(fourier_t x[FOURIER_LENGTH]);
void fourier_inverse(fourier_t x[FOURIER_LENGTH]);

/* Where bin k lies. k modulo 2048: bin -1 is 2047. */
uint32_t fourier_place(uint32_t k);

#endif
