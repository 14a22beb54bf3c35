#include "core/codes/code_bits.h"

#include <string.h>

#define CHIPS_MASK ((1u << CODE_BITS_CHIPS) - 1u)

static void write_register(uint32_t words[CODE_BITS_WORDS], const gold_family_t *family, uint16_t taps) {
    const uint32_t output = (family->length + 1u) / 2u;
    uint16_t state = family->length;
    for (uint32_t t = 0; t < family->length + CODE_BITS_CHIPS; t++) {
        words[t / 32u] |= ((state & output) != 0u ? 1u : 0u) << t % 32u;
        state = gold_step(taps, state, family->length);
    }
}

void code_bits_init(code_bits_t *bits, const gold_family_t *family) {
    memset(bits, 0, sizeof *bits);
    bits->family = family;
    write_register(bits->u, family, family->u_taps);
    write_register(bits->v, family, family->v_taps);
}

/* Returns the 32 chips from t on. */
static uint32_t read_register(const uint32_t words[CODE_BITS_WORDS], uint32_t t) {
    const uint32_t *const word = &words[t / 32u];
    return t % 32u == 0u ? word[0] : word[0] >> t % 32u | word[1] << (32u - t % 32u);
}

uint32_t code_bits_at(const code_bits_t *bits, uint32_t code, uint32_t chip) {
    const uint32_t length = bits->family->length, first = chip % length;
    const uint32_t shifted = first + (code < length ? code : 0u);
    const uint32_t u = code == length + 1u ? 0u : read_register(bits->u, first);
    const uint32_t v = code == length ? 0u : read_register(bits->v, shifted < length ? shifted : shifted - length);
    return (u ^ v) & CHIPS_MASK;
}
