#include "world/noise.h"

#include <math.h>
#include <stdbool.h>

#include "world/noise_layers.h"

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

/* The same between -1 and 1. The lowest eleven bits are left for others. */
static double signed_unit(uint64_t bits) {
    return 2.0 * unit(bits) - 1.0;
}

uint64_t noise_stream(uint64_t seed, noise_purpose_t purpose, unsigned board, unsigned part) {
    return mix(mix(seed) ^ (((uint64_t)purpose << 48) | ((uint64_t)board << 8) | part));
}

uint64_t noise_bits(uint64_t stream, uint64_t counter) {
    return mix(stream ^ counter);
}

double noise_uniform(uint64_t stream, uint64_t counter) {
    return unit(noise_bits(stream, counter));
}

/* Returns a normal number whose magnitude is beyond the lowest layer's rectangle, by Marsaglia's method for tails. */
static double beyond(uint64_t bits) {
    const double begin = noise_layers[1];
    double further, height;
    uint64_t state = bits;
    do {
        state = mix(state);
        further = -log(unit(state)) / begin;
        state = mix(state);
        height = -log(unit(state));
    } while (2.0 * height <= further * further);
    return copysign(begin + further, signed_unit(bits));
}

/* Returns whether a place in a layer, at a random height between its edges, is below the curve. */
static bool below(unsigned layer, double place, uint64_t bits) {
    const double outer = noise_layers[layer], inner = noise_layers[layer + 1u];
    const double low = exp(-0.5 * (outer * outer - place * place)), high = exp(-0.5 * (inner * inner - place * place));
    return high + unit(bits) * (low - high) < 1.0;
}

double noise_normal(uint64_t stream, uint64_t counter) {
    uint64_t bits = noise_bits(stream, counter);
    for (;;) {
        const unsigned layer = (unsigned)(bits % NOISE_LAYERS);
        const double place = signed_unit(bits) * noise_layers[layer];
        if (fabs(place) < noise_layers[layer + 1u]) {
            return place;
        }
        if (layer == 0u) {
            return beyond(bits);
        }
        bits = mix(bits);
        if (below(layer, place, bits)) {
            return place;
        }
        bits = mix(bits);
    }
}
