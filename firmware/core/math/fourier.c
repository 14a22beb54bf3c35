#include "core/math/fourier.h"

/* The twiddle factors' steps, exp(-i pi / 2^stage), for stages 0..10. */
static const fourier_t steps[FOURIER_BITS] = {
    {-1.0f, 0.0f},
    {0.0f, -1.0f},
    {0.70710678f, -0.70710678f},
    {0.92387953f, -0.38268343f},
    {0.98078528f, -0.19509032f},
    {0.99518473f, -0.09801714f},
    {0.99879546f, -0.049067674f},
    {0.99969882f, -0.024541229f},
    {0.99992470f, -0.012271538f},
    {0.99998118f, -0.0061358846f},
    {0.99999529f, -0.0030679568f},
};

static inline fourier_t product(fourier_t a, fourier_t b) {
    return (fourier_t){a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
}

void fourier_forward(fourier_t x[FOURIER_LENGTH]) {
    for (uint32_t stage = FOURIER_BITS; stage-- > 0u;) {
        const uint32_t half = 1u << stage;
        fourier_t twiddle = {1.0f, 0.0f};
        for (uint32_t j = 0; j < half; j++) {
            for (uint32_t i = j; i < FOURIER_LENGTH; i += 2u * half) {
                const fourier_t a = x[i], b = x[i + half];
                x[i] = (fourier_t){a.re + b.re, a.im + b.im};
                x[i + half] = product((fourier_t){a.re - b.re, a.im - b.im}, twiddle);
            }
            twiddle = product(twiddle, steps[stage]);
        }
    }
}

void fourier_inverse(fourier_t x[FOURIER_LENGTH]) {
    for (uint32_t stage = 0; stage < FOURIER_BITS; stage++) {
        const uint32_t half = 1u << stage;
        const fourier_t step = {steps[stage].re, -steps[stage].im};
        fourier_t twiddle = {1.0f, 0.0f};
        for (uint32_t j = 0; j < half; j++) {
            for (uint32_t i = j; i < FOURIER_LENGTH; i += 2u * half) {
                const fourier_t a = x[i], b = product(x[i + half], twiddle);
                x[i] = (fourier_t){a.re + b.re, a.im + b.im};
                x[i + half] = (fourier_t){a.re - b.re, a.im - b.im};
            }
            twiddle = product(twiddle, step);
        }
    }
}

uint32_t fourier_place(uint32_t k) {
    uint32_t place = 0;
    for (uint32_t bit = 0; bit < FOURIER_BITS; bit++) {
        place = place << 1 | (k >> bit & 1u);
    }
    return place;
}
