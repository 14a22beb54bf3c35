/* any.h: what may be anything, as Eva takes it: each value in the range at once. */
#ifndef GOLDFIELD_PROOF_ANY_H
#define GOLDFIELD_PROOF_ANY_H

#include <stddef.h>
#include <stdint.h>

#include "__fc_builtin.h"

static inline uint32_t any_word(void) {
    return Frama_C_unsigned_int_interval(0, UINT32_MAX);
}

static inline uint8_t any_byte(void) {
    return (uint8_t)Frama_C_unsigned_int_interval(0, UINT8_MAX);
}

static inline uint32_t any_up_to(uint32_t most) {
    return Frama_C_unsigned_int_interval(0, most);
}

/* Make all bytes anything. */
static inline void fill(void *bytes, size_t count) {
    Frama_C_make_unknown(bytes, count);
}

#endif
