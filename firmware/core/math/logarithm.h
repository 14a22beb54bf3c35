/* logarithm.h: the natural logarithm and the exponential in single precision, without a library and the same on every
 * machine.
 *
 * Logarithm. x = 2^n m with m from sqrt(1/2) to sqrt(2); ln m = 2 artanh((m - 1) / (m + 1)) by its power series. The
 * error is below 2e-7 of the result, or of 1 where that is smaller. Limits: x is positive, finite and not denormal.
 *
 * Exponential. x = n ln 2 + r with r of at most ln 2 / 2; the power series of exp r. The relative error is below 1e-6
 * for x from -87 to 88; below it is 0, and above not defined.
 *
 * Time: about 25 instructions each.
 */
#ifndef GOLDFIELD_LOGARITHM_H
#define GOLDFIELD_LOGARITHM_H

#include <stdint.h>
#include <string.h>

static inline float natural_logarithm(float x) {
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    bits += 0x3F800000u - 0x3F3504F3u; /* From the bits of sqrt(1/2) to those of 1, so that the exponent tells n. */
    const int32_t n = (int32_t)(bits >> 23) - 127;
    bits = (bits & 0x007FFFFFu) + 0x3F3504F3u;
    float m;
    memcpy(&m, &bits, sizeof m);
    const float s = (m - 1.0f) / (m + 1.0f), s2 = s * s;
    const float series = 1.0f + s2 * (1.0f / 3.0f + s2 * (1.0f / 5.0f + s2 * (1.0f / 7.0f)));
    return 0.69314718f * (float)n + 2.0f * s * series;
}

static inline float exponential(float x) {
    if (!(x > -87.0f)) {
        return 0.0f;
    }
    const float part = x * 1.44269504f;
    const int32_t n = (int32_t)(part < 0.0f ? part - 0.5f : part + 0.5f);
    const float r = (x - (float)n * 0.693359375f) + (float)n * 2.12194440e-4f; /* ln 2 in two parts: the first exact. */
    const float series = 1.0f + r * (1.0f + r * (1.0f / 2 + r * (1.0f / 6 + r * (1.0f / 24 + r * (1.0f / 120)))));
    const uint32_t bits = (uint32_t)(n + 127) << 23;
    float power;
    memcpy(&power, &bits, sizeof power);
    return power * (series + r * r * r * r * r * r * (1.0f / 720));
}

#endif
