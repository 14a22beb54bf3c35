#include "despread.h"

#include <stddef.h>

#include "gold.h"

#define DEGREE 10u
#define OUTPUT (1u << (DEGREE - 1u))
#define U_TAPS 0x204u /* Stages 3, 10. */
#define V_TAPS 0x3A6u /* Stages 2, 3, 6, 8, 9, 10. */

void despread_start(despread_t *despread) {
    for (uint32_t axis = 0; axis < DESPREAD_AXES; axis++) {
        despread->words[axis][0] = 0; /* No state is zero: the only word that no chip writes. */
        despread->v_sum[axis] = 0;
        despread->sum[axis] = 0;
    }
    despread->u_state = DESPREAD_CHIPS; /* All ones. */
    despread->v_state = DESPREAD_CHIPS;
    despread->chip = 0;
    despread->end = DESPREAD_CHIPS;
    despread->missing = 0;
}

void despread_start_part(despread_t *despread, const despread_t *previous, uint32_t chips) {
    despread_start(despread);
    if (previous != NULL) {
        despread->u_state = previous->u_state;
        despread->v_state = previous->v_state;
        despread->chip = previous->chip;
    }
    const uint32_t end = despread->chip + chips;
    despread->end = (uint16_t)(end < DESPREAD_CHIPS ? end : DESPREAD_CHIPS);
    for (uint32_t axis = 0; axis < DESPREAD_AXES; axis++) {
        for (int32_t *x = despread->words[axis]; x < despread->words[axis] + DESPREAD_WORDS; x += 4) {
            x[0] = 0; /* Four at a time: a plain loop would become the library's memset, byte by byte. */
            x[1] = 0;
            x[2] = 0;
            x[3] = 0;
        }
    }
}

static void next_chip(despread_t *despread) {
    despread->u_state = gold_step(U_TAPS, despread->u_state, DESPREAD_CHIPS);
    despread->v_state = gold_step(V_TAPS, despread->v_state, DESPREAD_CHIPS);
    despread->chip++;
}

void despread_store(despread_t *despread, const int16_t sample[DESPREAD_AXES]) {
    if (despread->chip >= despread->end) {
        return;
    }
    const uint32_t state = despread->v_state;
    const int32_t u = (despread->u_state & OUTPUT) != 0u ? -1 : 1;
    const int32_t v = (state & OUTPUT) != 0u ? -1 : 1;
    for (uint32_t axis = 0; axis < DESPREAD_AXES; axis++) {
        despread->words[axis][state] = u * sample[axis];
        despread->v_sum[axis] += v * sample[axis];
        despread->sum[axis] += sample[axis];
    }
    next_chip(despread);
}

void despread_skip(despread_t *despread, uint32_t chips) {
    for (; chips > 0u && despread->chip < despread->end; chips--) {
        for (uint32_t axis = 0; axis < DESPREAD_AXES; axis++) {
            despread->words[axis][despread->v_state] = 0;
        }
        despread->missing++;
        next_chip(despread);
    }
}

/* Three stages of the transform on the eight words x[0], x[stride], ..., x[7 stride]: with a constant stride, eight values stay in registers between
 * one load and one store each. */
__attribute__((always_inline)) static inline void butterfly8(int32_t *x, size_t stride) {
    const int32_t a0 = x[0] + x[stride], a1 = x[0] - x[stride];
    const int32_t a2 = x[2u * stride] + x[3u * stride], a3 = x[2u * stride] - x[3u * stride];
    const int32_t a4 = x[4u * stride] + x[5u * stride], a5 = x[4u * stride] - x[5u * stride];
    const int32_t a6 = x[6u * stride] + x[7u * stride], a7 = x[6u * stride] - x[7u * stride];
    const int32_t b0 = a0 + a2, b2 = a0 - a2, b1 = a1 + a3, b3 = a1 - a3;
    const int32_t b4 = a4 + a6, b6 = a4 - a6, b5 = a5 + a7, b7 = a5 - a7;
    x[0] = b0 + b4;
    x[4u * stride] = b0 - b4;
    x[stride] = b1 + b5;
    x[5u * stride] = b1 - b5;
    x[2u * stride] = b2 + b6;
    x[6u * stride] = b2 - b6;
    x[3u * stride] = b3 + b7;
    x[7u * stride] = b3 - b7;
}

__attribute__((always_inline)) static inline void stages8(int32_t *words, size_t stride) {
    for (int32_t *group = words; group < words + DESPREAD_WORDS; group += 8u * stride) {
        for (int32_t *x = group; x < group + stride; x++) {
            butterfly8(x, stride);
        }
    }
}

static void transform(int32_t *words) {
    stages8(words, 1);
    stages8(words, 8);
    stages8(words, 64);
    const size_t half = DESPREAD_WORDS / 2u;
    for (int32_t *x = words; x < words + half; x += 4) {
        const int32_t a = x[0], b = x[1], c = x[2], d = x[3];
        const int32_t e = x[half], f = x[half + 1u], g = x[half + 2u], h = x[half + 3u];
        x[0] = a + e;
        x[1] = b + f;
        x[2] = c + g;
        x[3] = d + h;
        x[half] = a - e;
        x[half + 1u] = b - f;
        x[half + 2u] = c - g;
        x[half + 3u] = d - h;
    }
}

void despread_transform(despread_t *despread) {
    despread_skip(despread, DESPREAD_CHIPS);
    for (uint32_t axis = 0; axis < DESPREAD_AXES; axis++) {
        transform(despread->words[axis]);
    }
}

uint16_t despread_word(uint32_t code) {
    if (code >= DESPREAD_CODE_U) {
        return 0;
    }
    return gold_functional(gold_family(DEGREE), V_TAPS, code);
}

int32_t despread_correlation(const despread_t *despread, uint32_t axis, uint32_t code, uint16_t word) {
    if (axis >= DESPREAD_AXES || code >= DESPREAD_CODES || word >= DESPREAD_WORDS) {
        return 0;
    }
    return code == DESPREAD_CODE_V ? despread->v_sum[axis] : despread->words[axis][word];
}
