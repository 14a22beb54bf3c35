#include "core/timing/code_search.h"

#include <string.h>

#include "core/codes/gold.h"
#include "core/math/roots.h"

#define DEGREE   10u      /* Degree of the codes. */
#define LOW_BINS 32u      /* Lines that are left out on both sides of zero: those up to 160 Hz. */
#define FULL     16384.0f /* Largest line of the record's spectrum as it is kept, in 16 bits. */

static float larger(float a, float b) {
    return a > b ? a : b;
}

void code_search_start(code_search_t *search, const acquire_record_t *record, float chip_length) {
    float mean[ACQUIRE_AXES], variance[ACQUIRE_AXES];
    record_statistics(record, mean, variance);
    const uint32_t least = variance[0] <= variance[1]   ? (variance[0] <= variance[2] ? 0u : 2u)
                           : variance[1] <= variance[2] ? 1u
                                                        : 2u;
    const uint32_t x = least == 0u ? 1u : 0u, y = least == 2u ? 1u : 2u;
    memset(search, 0, sizeof *search);
    for (uint32_t chip = 0; chip < ACQUIRE_CHIPS; chip++) {
        fourier_t *place = &search->work[(uint32_t)((float)chip * chip_length)];
        place->re = (float)record->field[chip][x] - mean[x];
        place->im = (float)record->field[chip][y] - mean[y];
    }
    fourier_forward(search->work);
    for (uint32_t k = 0; k <= 2u * LOW_BINS; k++) {
        search->work[fourier_place(k - LOW_BINS)] = (fourier_t){0.0f, 0.0f};
    }
    float largest = 1.0f;
    for (uint32_t i = 0; i < FOURIER_LENGTH; i++) {
        const fourier_t a = search->work[i];
        largest = larger(largest, larger(larger(a.re, -a.re), larger(a.im, -a.im)));
    }
    for (uint32_t i = 0; i < FOURIER_LENGTH; i++) {
        search->signal[i].re = (int16_t)(search->work[i].re * (FULL / largest));
        search->signal[i].im = (int16_t)(search->work[i].im * (FULL / largest));
    }
}

/* The correlation at a phase p is the sum over t of conj(y[t]) c[t + p]; it is computed at all phases at once. */
void code_search_add(code_search_t *search, uint16_t code) {
    gold_generator_t generator;
    (void)gold_start(&generator, DEGREE, code, 0);
    for (uint32_t t = 0; t < FOURIER_LENGTH; t++) {
        search->work[t] = (fourier_t){gold_next(&generator) != 0u ? -1.0f : 1.0f, 0.0f};
    }
    fourier_forward(search->work);
    for (uint32_t i = 0; i < FOURIER_LENGTH; i++) {
        const fourier_t a = {(float)search->signal[i].re, (float)search->signal[i].im}, b = search->work[i];
        search->work[i] = (fourier_t){a.re * b.re + a.im * b.im, a.re * b.im - a.im * b.re};
    }
    fourier_inverse(search->work);
    for (uint32_t p = 0; p < ACQUIRE_CHIPS; p++) {
        search->metric[p] += search->work[p].re * search->work[p].re + search->work[p].im * search->work[p].im;
    }
}

static uint32_t following(uint32_t p) {
    return p + 1u < ACQUIRE_CHIPS ? p + 1u : 0u;
}

code_peak_t code_search_peak(const code_search_t *search) {
    code_peak_t peak = {0u, 0.5f, 0.0f};
    float mean = 0.0f, best = -1.0f;
    for (uint32_t p = 0; p < ACQUIRE_CHIPS; p++) {
        mean += search->metric[p] / (float)ACQUIRE_CHIPS;
        const float both = search->metric[p] + search->metric[following(p)];
        if (both > best) {
            best = both;
            peak.label = p;
        }
    }
    peak.height = mean > 0.0f ? best / (2.0f * mean) : 0.0f;
    const float first = search->metric[peak.label] - mean, second = search->metric[following(peak.label)] - mean;
    const float before = first > 0.0f ? square_root(first) : 0.0f, after = second > 0.0f ? square_root(second) : 0.0f;
    peak.crossing = before + after > 0.0f ? before / (before + after) : 0.5f;
    return peak;
}
