/* noise.h: random numbers that depend on nothing but their address. noise_stream() makes the first part of an address,
 * noise_bits(), noise_uniform() and noise_normal() the numbers.
 *
 * A number is a hash of seed, who asks and for what (noise_stream), and a counter, usually the time in picoseconds: no
 * generator has a state, so results depend neither on the order of calls, nor on threads, nor on how a run is cut in
 * slices. Who asks again and again keeps the stream.
 *
 * The hash is three rounds of the SplitMix64 finaliser (Steele, Lea, Flood 2014, "Fast splittable pseudorandom number
 * generators"), two of them in the stream. Normal numbers come of Marsaglia's Ziggurat (noise_layers.h), whose
 * distribution is exact but for the 53 bits of a number. About 2 ns for bits and 5 ns for a normal number. No memory,
 * no errors.
 */
#ifndef GOLDFIELD_WORLD_NOISE_H
#define GOLDFIELD_WORLD_NOISE_H

#include <stdint.h>

typedef enum {
    NOISE_CHIP = 1,
    NOISE_CONVERTER = 2,
    NOISE_CURRENT_SENSE = 3,
    NOISE_IMPULSE = 4,
    NOISE_FLOATING = 5
} noise_purpose_t;

/* Returns the stream of a purpose, a board and an axis (or other part, 0..255). */
uint64_t noise_stream(uint64_t seed, noise_purpose_t purpose, unsigned board, unsigned part);

/* Returns 64 random bits. */
uint64_t noise_bits(uint64_t stream, uint64_t counter);

/* Returns a number in (0, 1), both ends excluded. */
double noise_uniform(uint64_t stream, uint64_t counter);

/* Returns a normal number of mean 0 and standard deviation 1. */
double noise_normal(uint64_t stream, uint64_t counter);

#endif
