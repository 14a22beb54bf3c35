#include "core/codes/gold.h"

#include <stddef.h>

#define STAGE(j) (1u << ((j)-1u))

static const gold_family_t families[] = {
    {5, 31, STAGE(2) | STAGE(5), STAGE(2) | STAGE(3) | STAGE(4) | STAGE(5)},
    {6, 63, STAGE(1) | STAGE(6), STAGE(1) | STAGE(2) | STAGE(5) | STAGE(6)},
    {7, 127, STAGE(3) | STAGE(7), STAGE(1) | STAGE(2) | STAGE(3) | STAGE(7)},
    {9, 511, STAGE(4) | STAGE(9), STAGE(3) | STAGE(4) | STAGE(6) | STAGE(9)},
    {10, 1023, STAGE(3) | STAGE(10), STAGE(2) | STAGE(3) | STAGE(6) | STAGE(8) | STAGE(9) | STAGE(10)},
    {11, 2047, STAGE(2) | STAGE(11), STAGE(2) | STAGE(5) | STAGE(8) | STAGE(11)},
};

const gold_family_t *gold_family(uint32_t degree) {
    for (size_t i = 0; i < sizeof families / sizeof families[0]; i++) {
        if (families[i].degree == degree) {
            return &families[i];
        }
    }
    return NULL;
}

uint16_t gold_next_functional(uint16_t taps, uint16_t functional) {
    /* Output t + i is stage n - i, one bit lower for each chip later; beyond stage 1 comes the feedback, which is
     * the taps' functional. */
    return (uint16_t)((uint32_t)functional >> 1 ^ ((functional & 1u) != 0u ? taps : 0u));
}

/* Returns the product in GF(2^n) of two functionals, w_a times w_b = w_(a+b). */
static uint16_t product(const gold_family_t *family, uint16_t taps, uint16_t a, uint16_t b) {
    uint32_t sum = 0;
    for (uint32_t i = 0; i < family->degree; i++) {
        if (((uint32_t)b >> (family->degree - 1u - i) & 1u) != 0u) {
            sum ^= a;
        }
        a = gold_next_functional(taps, a);
    }
    return (uint16_t)sum;
}

uint16_t gold_functional(const gold_family_t *family, uint16_t taps, uint32_t k) {
    const uint32_t exponent = k % family->length;
    uint16_t power = (uint16_t)((family->length + 1u) / 2u); /* w_0 picks the output stage. */
    for (uint32_t bit = family->degree; bit-- > 0u;) {
        power = product(family, taps, power, power);
        if ((exponent >> bit & 1u) != 0u) {
            power = gold_next_functional(taps, power);
        }
    }
    return power;
}

/* Returns the register t chips after all ones. Its stage n - i is output t + i: the parity of w_(t+i) alone. */
static uint16_t state_at(const gold_family_t *family, uint16_t taps, uint32_t t) {
    uint16_t functional = gold_functional(family, taps, t);
    uint32_t state = 0;
    for (uint32_t i = 0; i < family->degree; i++) {
        state = state << 1 | gold_parity(functional);
        functional = gold_next_functional(taps, functional);
    }
    return (uint16_t)state;
}

bool gold_start(gold_generator_t *generator, uint32_t degree, uint32_t code, uint32_t chip) {
    const gold_family_t *family = gold_family(degree);
    if (family == NULL || code > family->length + 1u) {
        return false;
    }
    const uint32_t first = chip % family->length;
    const uint16_t output = (uint16_t)((family->length + 1u) / 2u);
    generator->family = family;
    generator->u_state = state_at(family, family->u_taps, first);
    generator->v_state = state_at(family, family->v_taps, code < family->length ? first + code : first);
    generator->u_mask = code == family->length + 1u ? 0u : output;
    generator->v_mask = code == family->length ? 0u : output;
    return true;
}

uint8_t gold_next(gold_generator_t *generator) {
    const gold_family_t *family = generator->family;
    const bool u = (generator->u_state & generator->u_mask) != 0u;
    const bool v = (generator->v_state & generator->v_mask) != 0u;
    generator->u_state = gold_step(family->u_taps, generator->u_state, family->length);
    generator->v_state = gold_step(family->v_taps, generator->v_state, family->length);
    return u != v ? 1u : 0u;
}

int32_t gold_sum(uint32_t degree, uint32_t code) {
    gold_generator_t generator;
    if (!gold_start(&generator, degree, code, 0)) {
        return 0;
    }
    int32_t sum = generator.family->length;
    for (uint32_t chip = 0; chip < generator.family->length; chip++) {
        sum -= 2 * (int32_t)gold_next(&generator);
    }
    return sum;
}
