#include "core/link/parameter_set.h"

#define BEFORE_RUNS 2u
#define ID_MASK     0xFFFu
#define KIND_SHIFT  12u
#define KIND_MASK   0xFu
#define COUNT_SHIFT 16u

static uint32_t head_of(const parameter_entry_t *entry, uint32_t row) {
    return (entry->first_id + row * entry->stride) | (uint32_t)entry->kind << KIND_SHIFT |
           (uint32_t)entry->elements << COUNT_SHIFT;
}

uint32_t parameter_set_write(const parameters_t *parameters, uint32_t version, uint32_t *words) {
    uint32_t count = 0, place = 0;
    words[count++] = PARAMETER_SET_MARK | PARAMETER_SET_FORMAT;
    words[count++] = version;
    const parameter_entry_t *entry;
    for (uint32_t i = 0; (entry = parameters_entry(i)) != NULL; i++) {
        for (uint32_t row = 0; row < entry->rows; row++) {
            words[count++] = head_of(entry, row);
            for (uint32_t column = 0; column < entry->elements; column++) {
                words[count++] = parameters->bits[place++]; /* They are in the order of the table. */
            }
        }
    }
    return count;
}

bool parameter_set_holds(const parameters_t *parameters, uint32_t version, const uint32_t *words) {
    uint32_t count = BEFORE_RUNS, place = 0;
    uint32_t differ = (words[0] ^ (PARAMETER_SET_MARK | PARAMETER_SET_FORMAT)) | (words[1] ^ version);
    const parameter_entry_t *entry;
    for (uint32_t i = 0; (entry = parameters_entry(i)) != NULL; i++) {
        for (uint32_t row = 0; row < entry->rows; row++) {
            differ |= words[count++] ^ head_of(entry, row);
            for (uint32_t column = 0; column < entry->elements; column++) {
                differ |= words[count++] ^ parameters->bits[place++];
            }
        }
    }
    return differ == 0u && count == PARAMETER_SET_WORDS;
}

/* Whether the runs end where the words do. */
static bool adds_up(const uint32_t *words, uint32_t count) {
    uint32_t index = BEFORE_RUNS;
    while (index < count) {
        const uint32_t values = words[index] >> COUNT_SHIFT;
        if (values == 0u) {
            return false;
        }
        index += values + 1u;
    }
    return index == count;
}

parameter_set_t parameter_set_read(parameters_t *parameters, const uint32_t *words, uint32_t count, uint32_t *refused) {
    *refused = 0;
    if (count < BEFORE_RUNS || words[0] != (PARAMETER_SET_MARK | PARAMETER_SET_FORMAT)) {
        return PARAMETER_SET_OTHER;
    }
    if (!adds_up(words, count)) {
        return PARAMETER_SET_BAD;
    }
    for (uint32_t index = BEFORE_RUNS; index < count; index++) {
        const uint32_t head = words[index], values = head >> COUNT_SHIFT;
        /* The words lie in flash, where a head may read otherwise than it did a moment ago: their end is looked for
         * again. */
        for (uint32_t i = 0; i < values && index + 1u < count; i++) {
            index++;
            const parameter_value_t value = {(uint8_t)(head >> KIND_SHIFT & KIND_MASK), words[index]};
            if (parameters_set(parameters, (head & ID_MASK) + i, value) != PARAMETER_OK) {
                (*refused)++;
            }
        }
    }
    return PARAMETER_SET_LOADED;
}
