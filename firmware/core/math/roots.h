/* roots.h: sqrt(x), 1/sqrt(x) and 1/cbrt(x) in single precision, without a library and the same on every machine, bit
 * for bit.
 *
 * square_root is correctly rounded: it is one instruction where the processor has it, else it is refined in double
 * precision. The inverses begin with a first guess from the bits of the number (its exponent over -2 or -3; the
 * constants minimise the guess's error) and go on with Newton on y^-n - x, which converges quadratically: three steps
 * take 4 % to rounding.
 *
 * Limits. The relative error is at most 3e-7 for x from 1e-35 to 1e35. x = 0 gives a large finite number. A negative
 * number has no meaningful result. Time: about 15 and 18 instructions, no more than a division takes.
 */
#ifndef GOLDFIELD_ROOTS_H
#define GOLDFIELD_ROOTS_H

#include <stdint.h>
#include <string.h>

static inline float roots_guess(float x, uint32_t constant, uint32_t power) {
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    bits = constant - bits / power;
    float guess;
    memcpy(&guess, &bits, sizeof guess);
    return guess;
}

static inline float inverse_square_root(float x) {
    float y = roots_guess(x, 0x5F375A86u, 2u);
    const float half = 0.5f * x;
    y *= 1.5f - half * y * y;
    y *= 1.5f - half * y * y;
    return y * (1.5f - half * y * y);
}

static inline float square_root(float x) {
#if defined(__arm__) && defined(__ARM_FP)
    float root;
    __asm__("vsqrt.f32 %0, %1" : "=t"(root) : "t"(x));
    return root;
#else
    const double y = (double)inverse_square_root(x), root = (double)x * y;
    return (float)(root + 0.5 * y * ((double)x - root * root));
#endif
}

static inline float inverse_cube_root(float x) {
    float y = roots_guess(x, 0x54A2FA8Cu, 3u);
    const float third = x * (1.0f / 3.0f);
    y *= 4.0f / 3.0f - third * y * y * y;
    y *= 4.0f / 3.0f - third * y * y * y;
    return y * (4.0f / 3.0f - third * y * y * y);
}

#endif
