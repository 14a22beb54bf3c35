#include "core/link/parameters.h"

#include <stdbool.h>
#include <string.h>

#include "core/codes/gold.h"
#include "core/link/frame.h"

/* Parameters of one kind: rows of count successive ids, each row stride after the one before. The limits are exact
 * in a float. */
typedef struct {
    uint16_t first_id, count, rows, stride;
    parameter_kind_t kind;
    float minimum, maximum, initial;
} run_t;

static const run_t runs[] = {
    {PARAMETER_NODE, 1, 1, 0, PARAMETER_UNSIGNED, 1.0f, 4095.0f, 1.0f},
    {PARAMETER_CODE, 1, 1, 0, PARAMETER_UNSIGNED, 0.0f, 2048.0f, 0.0f},
    {PARAMETER_AMPLITUDE, 1, 1, 0, PARAMETER_FLOAT, 0.0f, 15.9f, 0.0f},
    {PARAMETER_SYNC_MASTER, 1, 1, 0, PARAMETER_UNSIGNED, 0.0f, 1.0f, 0.0f},
    {PARAMETER_STREAM, 1, 1, 0, PARAMETER_UNSIGNED, 0.0f, 1.0f, 0.0f},
    {PARAMETER_CODE_COUNT, 1, 1, 0, PARAMETER_UNSIGNED, 0.0f, 64.0f, 0.0f},
    {PARAMETER_OPEN_COIL, 1, 1, 0, PARAMETER_FLOAT, 0.0f, 1.0f, 0.5f},
    {PARAMETER_OVER_CURRENT, 1, 1, 0, PARAMETER_FLOAT, 0.0f, 15.9f, 12.0f},
    {PARAMETER_ZERO, 3, 1, 0, PARAMETER_FLOAT, 0.0f, 4095.0f, 2048.0f},
    {PARAMETER_POSE, 1, 1, 0, PARAMETER_UNSIGNED, 0.0f, 1.0f, 0.0f},
    {PARAMETER_NOISE, 1, 1, 0, PARAMETER_FLOAT, 0.0f, 1.0f, 2e-7f},
    {PARAMETER_WAVEFORM, 1, 1, 0, PARAMETER_UNSIGNED, 0.0f, 4.0f, 0.0f},
    {PARAMETER_SLOTS, 1, 1, 0, PARAMETER_UNSIGNED, 1.0f, 2047.0f, 1.0f},
    {PARAMETER_SLOT, 1, 1, 0, PARAMETER_UNSIGNED, 0.0f, 2046.0f, 0.0f},
    {PARAMETER_CALIBRATION, 9, 1, 0, PARAMETER_FLOAT, -1.0f, 1.0f, 0.0f},
    {PARAMETER_PERIODS, 1, 1, 0, PARAMETER_UNSIGNED, 1.0f, 1023.0f, 1.0f},
    {PARAMETER_SYNC_SOURCE, 1, 1, 0, PARAMETER_UNSIGNED, 0.0f, 2.0f, 0.0f},
    {PARAMETER_PARTS, 1, 1, 0, PARAMETER_UNSIGNED, 1.0f, 3.0f, 1.0f},
    {PARAMETER_DEGREE, 1, 1, 0, PARAMETER_UNSIGNED, 5.0f, 11.0f, 10.0f},
    {PARAMETER_HALF_SPACE, 6, 1, 0, PARAMETER_FLOAT, -1e6f, 1e6f, 0.0f},
    {PARAMETER_CODE_LIST, PARAMETER_CODE_LIST_LENGTH, 1, 0, PARAMETER_UNSIGNED, 0.0f, 2048.0f, 0.0f},
    {PARAMETER_CODES, PARAMETER_CODES_FIELDS, PARAMETER_CODES_LENGTH, PARAMETER_CODES_STRIDE, PARAMETER_UNSIGNED, 0.0f,
     2048.0f, 0.0f},
    {PARAMETER_BEACONS, PARAMETER_BEACON_FIELDS, PARAMETER_CODE_LIST_LENGTH, PARAMETER_BEACON_STRIDE, PARAMETER_FLOAT,
     -1e6f, 1e6f, 0.0f},
};
#define RUNS                (sizeof runs / sizeof runs[0])
#define NOMINAL_T_PER_COUNT (200e-6f / 2048.0f) /* +-200 uT over the converter's range. */

static uint32_t float_bits(float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static float bits_float(uint32_t bits) {
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* The run that holds an id, NULL if none, and the id's place in parameters_t.bits. */
static const run_t *find(uint32_t id, uint32_t *place) {
    uint32_t first_place = 0;
    for (size_t i = 0; i < RUNS; i++) {
        const uint32_t distance = id - runs[i].first_id; /* Wraps below first_id, and is large. */
        const uint32_t row = runs[i].rows > 1u ? distance / runs[i].stride : 0u,
                       column = distance - row * runs[i].stride;
        if (row < runs[i].rows && column < runs[i].count) {
            *place = first_place + row * runs[i].count + column;
            return &runs[i];
        }
        first_place += (uint32_t)runs[i].count * runs[i].rows;
    }
    return NULL;
}

static bool in_range(const run_t *run, uint32_t bits) {
    if (run->first_id == PARAMETER_DEGREE) {
        return gold_family(bits) != NULL;
    }
    if (run->kind == PARAMETER_FLOAT) {
        const float value = bits_float(bits);
        return value >= run->minimum && value <= run->maximum; /* False for what is not a number. */
    }
    return bits >= (uint32_t)run->minimum && bits <= (uint32_t)run->maximum;
}

void parameters_init(parameters_t *parameters) {
    uint32_t place = 0;
    for (size_t i = 0; i < RUNS; i++) {
        const uint32_t initial = runs[i].kind == PARAMETER_FLOAT ? float_bits(runs[i].initial)
                                                                 : (uint32_t)runs[i].initial;
        for (uint32_t j = 0; j < (uint32_t)runs[i].count * runs[i].rows; j++) {
            parameters->bits[place] = initial;
            place++;
        }
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const parameter_value_t nominal = {PARAMETER_FLOAT, float_bits(NOMINAL_T_PER_COUNT)};
        (void)parameters_set(parameters, PARAMETER_CALIBRATION + 4u * axis, nominal);
    }
}

parameter_status_t parameters_get(const parameters_t *parameters, uint32_t id, parameter_value_t *value) {
    uint32_t place;
    const run_t *run = find(id, &place);
    if (run == NULL) {
        *value = (parameter_value_t){PARAMETER_UNSIGNED, 0};
        return PARAMETER_UNKNOWN;
    }
    *value = (parameter_value_t){(uint8_t)run->kind, parameters->bits[place]};
    return PARAMETER_OK;
}

parameter_status_t parameters_set(parameters_t *parameters, uint32_t id, parameter_value_t value) {
    uint32_t place;
    const run_t *run = find(id, &place);
    if (run == NULL) {
        return PARAMETER_UNKNOWN;
    }
    if (value.kind != run->kind) {
        return PARAMETER_WRONG_KIND;
    }
    if (!in_range(run, value.bits)) {
        return PARAMETER_OUT_OF_RANGE;
    }
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
