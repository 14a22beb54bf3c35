#include "core/link/parameters.h"

#include <stdbool.h>
#include <string.h>

#include "core/link/frame.h"
#include "parameter_table.h"

#define ENTRIES  (sizeof parameter_table / sizeof parameter_table[0])
#define DEFAULTS (sizeof parameter_defaults / sizeof parameter_defaults[0])

static float bits_float(uint32_t bits) {
    float value;
    /* cppcheck-suppress misra-c2012-21.15 ; a float is read from its bits */
    memcpy(&value, &bits, sizeof value);
    return value;
}

static int32_t bits_signed(uint32_t bits) {
    int32_t value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* The entry that holds an id, NULL if there is none, and the id's place in parameters_t.bits. */
static const parameter_entry_t *find(uint32_t id, uint32_t *place) {
    uint32_t first_place = 0;
    for (size_t i = 0; i < ENTRIES; i++) {
        const parameter_entry_t *entry = &parameter_table[i];
        const uint32_t distance = id - entry->first_id; /* It wraps below first_id, and is large. */
        const uint32_t row = entry->rows > 1u ? distance / entry->stride : 0u;
        const uint32_t column = entry->rows > 1u ? distance % entry->stride : distance;
        if (row < entry->rows && column < entry->elements) {
            *place = first_place + row * entry->elements + column;
            return entry;
        }
        first_place += (uint32_t)entry->elements * entry->rows;
    }
    return NULL;
}

static bool in_range(const parameter_entry_t *entry, uint32_t bits) {
    if (entry->kind == PARAMETER_FLOAT) {
        const float value = bits_float(bits);
        return value >= bits_float(entry->minimum) && value <= bits_float(entry->maximum); /* False for a NaN. */
    }
    if (entry->kind == PARAMETER_SIGNED) {
        const int32_t value = bits_signed(bits);
        return value >= bits_signed(entry->minimum) && value <= bits_signed(entry->maximum);
    }
    return bits >= entry->minimum && bits <= entry->maximum && (entry->excluded == 0u || bits != entry->excluded);
}

/* Returns what a value adds to the seal: neighbours that have changed places are seen, too. */
static uint32_t turned(uint32_t place, uint32_t bits) {
    const uint32_t by = place % 32u;
    const uint64_t wide = (uint64_t)bits << by;
    return (uint32_t)(wide & UINT32_MAX) | (uint32_t)(wide >> 32);
}

static uint32_t seal_of(const parameters_t *parameters) {
    uint32_t sum = PARAMETERS_COUNT; /* Memory that is 0 all over is not sealed. */
    for (uint32_t place = 0; place < PARAMETERS_COUNT; place++) {
        sum ^= turned(place, parameters->bits[place]);
    }
    return sum;
}

bool parameters_intact(const parameters_t *parameters) {
    return seal_of(parameters) == parameters->seal;
}

void parameters_init(parameters_t *parameters) {
    uint32_t place = 0;
    for (size_t i = 0; i < ENTRIES; i++) {
        for (uint32_t j = 0; j < (uint32_t)parameter_table[i].elements * parameter_table[i].rows; j++) {
            parameters->bits[place] = parameter_table[i].initial;
            place++;
        }
    }
    for (size_t i = 0; i < DEFAULTS; i++) {
        if (find(parameter_defaults[i].id, &place) != NULL) {
            parameters->bits[place] = parameter_defaults[i].bits;
        }
    }
    parameters->seal = seal_of(parameters);
}

const parameter_entry_t *parameters_entry(uint32_t index) {
    return index < ENTRIES ? &parameter_table[index] : NULL;
}

const parameter_entry_t *parameters_next(uint32_t id, uint32_t role) {
    for (size_t i = 0; i < ENTRIES; i++) {
        if (parameter_table[i].first_id >= id && (parameter_table[i].roles >> role & 1u) != 0) {
            return &parameter_table[i];
        }
    }
    return NULL;
}

parameter_status_t parameters_get(const parameters_t *parameters, uint32_t id, parameter_value_t *value) {
    uint32_t place;
    const parameter_entry_t *entry = find(id, &place);
    if (entry == NULL) {
        *value = (parameter_value_t){PARAMETER_UNSIGNED, 0};
        return PARAMETER_UNKNOWN;
    }
    *value = (parameter_value_t){entry->kind, parameters->bits[place]};
    return PARAMETER_OK;
}

parameter_status_t parameters_set(parameters_t *parameters, uint32_t id, parameter_value_t value) {
    uint32_t place;
    const parameter_entry_t *entry = find(id, &place);
    if (entry == NULL) {
        return PARAMETER_UNKNOWN;
    }
    if (value.kind != entry->kind) {
        return PARAMETER_WRONG_KIND;
    }
    if (!in_range(entry, value.bits)) {
        return PARAMETER_OUT_OF_RANGE;
    }
    /* The place is looked up anew for the seal: if one of both is wrong, the seal breaks. */
    uint32_t sealed = 0;
    if (find(id, &sealed) != entry) {
        return PARAMETER_UNKNOWN;
    }
    parameters->seal ^= turned(sealed, value.bits) ^ turned(sealed, parameters->bits[sealed]);
    parameters->bits[place] = value.bits;
    return PARAMETER_OK;
}

uint32_t parameters_unsigned(const parameters_t *parameters, uint32_t id) {
    parameter_value_t value;
    (void)parameters_get(parameters, id, &value);
    return value.kind == PARAMETER_UNSIGNED ? value.bits : 0u;
}

float parameters_float(const parameters_t *parameters, uint32_t id) {
    parameter_value_t value;
    (void)parameters_get(parameters, id, &value);
    return value.kind == PARAMETER_FLOAT ? bits_float(value.bits) : 0.0f;
}

static uint32_t read_u16(const uint8_t *bytes) {
    return bytes[0] | (uint32_t)bytes[1] << 8;
}

static uint32_t read_u32(const uint8_t *bytes) {
    return read_u16(bytes) | read_u16(bytes + 2) << 16;
}

parameters_page_t parameters_load(parameters_t *parameters, const uint8_t *page, size_t size, uint32_t *refused) {
    enum { MAGIC = 0x31504647, HEADER = 8, ENTRY = 8 };
    *refused = 0;
    if (size < HEADER) {
        return PARAMETERS_PAGE_BAD;
    }
    const uint32_t magic = read_u32(page), count = read_u16(page + 4);
    if (magic == UINT32_MAX) {
        return PARAMETERS_PAGE_EMPTY;
    }
    if (magic != MAGIC || count > (size - HEADER) / ENTRY ||
        frame_crc(page + HEADER, (size_t)count * ENTRY) != read_u16(page + 6)) {
        return PARAMETERS_PAGE_BAD;
    }
    for (uint32_t i = 0; i < count; i++) {
        const uint8_t *entry = page + HEADER + (size_t)i * ENTRY;
        const uint32_t kind = read_u16(entry + 2);
        const parameter_value_t value = {(uint8_t)(kind <= UINT8_MAX ? kind : UINT8_MAX), read_u32(entry + 4)};
        if (parameters_set(parameters, read_u16(entry), value) != PARAMETER_OK) {
            (*refused)++;
        }
    }
    return PARAMETERS_PAGE_LOADED;
}
