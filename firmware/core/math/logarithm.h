/* logarithm.h: the natural logarithm in single precision, without a library and the same on every machine.
 *
 * Method. x = 2^n m with m from sqrt(1/2) to sqrt(2); ln m = 2 artanh((m - 1) / (m + 1)) by its power series. The error
 * is below 2e-7 of the result, or of 1 where that is smaller. Limits: x is positive, finite and not denormal. Time:
 * about 25 instructions.
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

#endif
