#include "core/codes/despread.h"

#include <stddef.h>

void despread_start(despread_t *despread, const gold_family_t *family) {
    despread->family = family;
    for (uint32_t axis = 0; axis < DESPREAD_AXES; axis++) {
        despread->words[axis][0] = 0; /* No state is zero, so no chip writes this word. */
        despread->v_sum[axis] = 0;
        despread->sum[axis] = 0;
    }
    despread->u_state = family->length; /* All ones. */
    despread->v_state = family->length;
    despread->chip = 0;
    despread->missing = 0;
}

static void next_chip(despread_t *despread) {
    const gold_family_t *family = despread->family;
    despread->u_state = gold_step(family->u_taps, despread->u_state, family->length);
    despread->v_state = gold_step(family->v_taps, despread->v_state, family->length);
    despread->chip++;
}

void despread_store(despread_t *despread, const int16_t sample[DESPREAD_AXES]) {
    if (despread->chip >= despread->family->length) {
        return;
    }
    /* In a state above half the output stage is 1. */
    const uint32_t state = despread->v_state, half = despread->family->length / 2u;
    const int32_t u = despread->u_state > half ? -1 : 1;
    const int32_t v = state > half ? -1 : 1;
    for (uint32_t axis = 0; axis < DESPREAD_AXES; axis++) {
        despread->words[axis][state] = u * sample[axis];
        despread->v_sum[axis] += v * sample[axis];
        despread->sum[axis] += sample[axis];
    }
    next_chip(despread);
}

void despread_skip(despread_t *despread, uint32_t chips) {
    for (; chips > 0u && despread->chip < despread->family->length; chips--) {
        for (uint32_t axis = 0; axis < DESPREAD_AXES; axis++) {
            despread->words[axis][despread->v_state] = 0;
        }
        despread->missing++;
        next_chip(despread);
    }
}

/* Does three stages of the transform on the eight words x[0], x[stride], ..., x[7 stride]. With a constant stride,
 * eight values stay in registers between one load and one store each. */
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

__attribute__((always_inline)) static inline void stages8(int32_t *words, size_t size, size_t stride) {
    for (int32_t *group = words; group < words + size; group += 8u * stride) {
        for (int32_t *x = group; x < group + stride; x++) {
            butterfly8(x, stride);
        }
    }
}

/* Does the last stage of the transform, on 2 half words. */
static void stage2(int32_t *words, size_t half) {
    for (int32_t *x = words, *y = words + half; x < words + half; x += 4, y += 4) {
        const int32_t a = x[0], b = x[1], c = x[2], d = x[3];
        const int32_t e = y[0], f = y[1], g = y[2], h = y[3];
        x[0] = a + e;
        x[1] = b + f;
        x[2] = c + g;
        x[3] = d + h;
        y[0] = a - e;
        y[1] = b - f;
        y[2] = c - g;
        y[3] = d - h;
    }
}

/* Does the last two stages of the transform, on 4 quarter words. */
__attribute__((always_inline)) static inline void stages4(int32_t *words, size_t quarter) {
    for (int32_t *x = words; x < words + quarter; x++) {
        const int32_t a = x[0] + x[quarter], b = x[0] - x[quarter];
        const int32_t c = x[2u * quarter] + x[3u * quarter], d = x[2u * quarter] - x[3u * quarter];
        x[0] = a + c;
        x[quarter] = b + d;
        x[2u * quarter] = a - c;
        x[3u * quarter] = b - d;
    }
}

static void transform(int32_t *words, uint32_t degree) {
    const size_t size = (size_t)1 << degree;
    stages8(words, size, 1);
    if (degree >= 6u) {
        stages8(words, size, 8);
    }
    if (degree >= 9u) {
        stages8(words, size, 64);
    }
    switch (degree) {
    case 5:
        stages4(words, 8);
        break;
    case 7:
    case 10:
        stage2(words, size / 2u);
        break;
    case 11:
        stages4(words, 512);
        break;
    default: /* Degrees 6 and 9 are done with stages in threes. */
        break;
    }
}

void despread_transform(despread_t *despread) {
    const gold_family_t *family = despread->family;
    despread_skip(despread, family->length);
    for (uint32_t axis = 0; axis < DESPREAD_AXES; axis++) {
        transform(despread->words[axis], family->degree);
    }
}

uint16_t despread_word(const gold_family_t *family, uint32_t code) {
    if (code < family->length) {
        return gold_functional(family, family->v_taps, code);
    }
    return code == family->length ? 0u : code == family->length + 1u ? DESPREAD_WORD_V : DESPREAD_WORD_NONE;
}

int32_t despread_correlation(const despread_t *despread, uint32_t axis, uint16_t word) {
    if (axis >= DESPREAD_AXES || word > GOLD_LENGTH_MAX) {
        return axis < DESPREAD_AXES && word == DESPREAD_WORD_V ? despread->v_sum[axis] : 0;
    }
    return despread->words[axis][word];
}
