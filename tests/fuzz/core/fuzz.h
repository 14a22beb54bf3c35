/* fuzz.h: what the harnesses of this folder share: bytes of the input as numbers, and what must hold.
 *
 * A harness is one function, LLVMFuzzerTestOneInput. libFuzzer calls it with inputs of its own making; standalone.c
 * calls it with the files of a corpus, for machines without a fuzzer. It keeps nothing from one call to the next. */
#ifndef GOLDFIELD_FUZZ_H
#define GOLDFIELD_FUZZ_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* What is claimed of the code; an input that refutes it is a crash to the fuzzer. */
#define REQUIRE(condition)                                                                                             \
    ((condition) ? (void)0 : (fprintf(stderr, "%s:%d: does not hold: %s\n", __FILE__, __LINE__, #condition), abort()))

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size);

/* The bytes that are left; behind their end come zeros, so that short inputs mean something. */
typedef struct {
    const uint8_t *bytes;
    size_t left;
} input_t;

static inline uint8_t take_u8(input_t *input) {
    if (input->left == 0u) {
        return 0;
    }
    input->left--;
    return *input->bytes++;
}

static inline uint16_t take_u16(input_t *input) {
    const uint32_t low = take_u8(input);
    return (uint16_t)(low | (uint32_t)take_u8(input) << 8);
}

static inline uint32_t take_u32(input_t *input) {
    const uint32_t low = take_u16(input);
    return low | (uint32_t)take_u16(input) << 16;
}

static inline float take_float(input_t *input) {
    const uint32_t bits = take_u32(input);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* A number in a range, in 65,536 steps. */
static inline float take_between(input_t *input, float low, float high) {
    return low + (high - low) * (float)take_u16(input) / 65535.0f;
}

/* Chances that are the same for each run of an input: xorshift32, Marsaglia 2003. */
static inline uint32_t chance(uint32_t *state) {
    uint32_t x = *state != 0u ? *state : 1u;
    x ^= x << 13;
    x ^= x >> 17;
    x ^= x << 5;
    *state = x;
    return x;
}

#endif
