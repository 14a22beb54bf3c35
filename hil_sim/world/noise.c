#include "world/noise.h"

#include <math.h>

static const double two_pi = 6.283185307179586;

static uint64_t mix(uint64_t value) {
    value += 0x9E3779B97F4A7C15u;
    value = (value ^ (value >> 30)) * 0xBF58476D1CE4E5B9u;
    value = (value ^ (value >> 27)) * 0x94D049BB133111EBu;
    return value ^ (value >> 31);
}

/* 53 bits, shifted by half a step so that neither 0 nor 1 comes out: a logarithm follows. */
static double unit(uint64_t bits) {
    return ((double)(bits >> 11) + 0.5) * 0x1p-53;
}

uint64_t noise_stream(noise_purpose_t purpose, unsigned board, unsigned part) {
    return ((uint64_t)purpose << 48) | ((uint64_t)board << 8) | part;
}

uint64_t noise_bits(uint64_t seed, uint64_t stream, uint64_t counter) {
    return mix(mix(mix(seed) ^ stream) ^ counter);
}

double noise_uniform(uint64_t seed, uint64_t stream, uint64_t counter) {
    return unit(noise_bits(seed, stream, counter));
}

double noise_normal(uint64_t seed, uint64_t stream, uint64_t counter) {
    const uint64_t bits = noise_bits(seed, stream, counter);
    return sqrt(-2.0 * log(unit(bits))) * cos(two_pi * unit(mix(bits)));
}
