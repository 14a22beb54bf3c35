/* parameters.h: the node's parameters (protocol/framing.md, "Parameters"): typed, range-checked, loaded from the stored
 * page.
 *
 * A value is 32 bits of one of three kinds. Ranges (ends included) and defaults:
 *   node unsigned 1..4095 (1) · code unsigned 0..2048 (0) · amplitude float 0..15.9 A (0: off) · sync_master unsigned
 *     0..1 (0) ·
 *   stream unsigned 0..1 (0) · code_count unsigned 0..64 (0) · open_coil float 0..1 (0.5) · over_current float 0..15.9
 *     A (12) ·
 *   zero_x, _y, _z float 0..4095 counts (2048) · pose unsigned 0..1 (0) · noise float 0..1 T (2e-7) · waveform unsigned
 *     0..4 (0) ·
 *   slots unsigned 1..2047 (1) · slot unsigned 0..2046 (0) · calibration float -1..1 T per count (identity times 200 uT
 *     / 2048) ·
 *   periods unsigned 1..1023 (1) · sync_source unsigned 0..2 (0) · parts unsigned 1..3 (1; 2 counts as 1) · degree
 *     unsigned, one of gold.h (10) ·
 *   half_space float +-1e6 (0) · code_list unsigned 0..2048 (0) · codes unsigned 0..2048 (0) · beacons float +-1e6 (0)
 * A float that is not a number is out of range. Numbers that only fit together or not (slot and slots, a code and the
 * cycle) are the waveform's to judge. No parameter is read-only today; the status exists for those to come.
 *
 * Stored page, little-endian: magic u32 "GFP1", count u16, CRC-16/CCITT-FALSE of the entries u16; then entries: id u16,
 * kind u16, value u32. The page is trusted only after its magic, its count against its length, and its CRC; after that
 * each entry still passes the same checks as a PARAM_SET.
 *
 * Contexts: one. Reading a value from an interrupt while main sets it is safe: a value is one word. Memory: 2.5 kB.
 */
#ifndef GOLDFIELD_PARAMETERS_H
#define GOLDFIELD_PARAMETERS_H

#include <stddef.h>
#include <stdint.h>

#define PARAMETER_NODE             0u
#define PARAMETER_CODE             1u
#define PARAMETER_AMPLITUDE        2u
#define PARAMETER_SYNC_MASTER      3u
#define PARAMETER_STREAM           4u
#define PARAMETER_CODE_COUNT       5u
#define PARAMETER_OPEN_COIL        6u
#define PARAMETER_OVER_CURRENT     7u
#define PARAMETER_ZERO             8u /* 8..10: x, y, z. */
#define PARAMETER_POSE             11u
#define PARAMETER_NOISE            12u
#define PARAMETER_WAVEFORM         13u /* waveform_kind_t */
#define PARAMETER_SLOTS            14u
#define PARAMETER_SLOT             15u
#define PARAMETER_CALIBRATION      16u /* 16..24: row by row. */
#define PARAMETER_PERIODS          25u
#define PARAMETER_SYNC_SOURCE      26u
#define PARAMETER_PARTS            27u
#define PARAMETER_DEGREE           28u
#define PARAMETER_HALF_SPACE       32u  /* 32..37: point, normal. */
#define PARAMETER_CODE_LIST        256u /* 256..319. */
#define PARAMETER_CODE_LIST_LENGTH 64u
#define PARAMETER_CODES            320u /* + 8 * place + field. */
#define PARAMETER_CODES_LENGTH     4u
#define PARAMETER_CODES_STRIDE     8u
#define PARAMETER_CODES_FIELDS     4u   /* Degree, index, offset, hold. */
#define PARAMETER_BEACONS          512u /* + 16 * place in the code list + field. */
#define PARAMETER_BEACON_STRIDE    16u
#define PARAMETER_BEACON_FIELDS    8u /* Position, axis, moment, radius. */
#define PARAMETERS_COUNT           627u

typedef enum { PARAMETER_UNSIGNED = 0, PARAMETER_SIGNED = 1, PARAMETER_FLOAT = 2 } parameter_kind_t;

/* As in PARAM_VALUE. */
typedef enum {
    PARAMETER_OK = 0,
    PARAMETER_UNKNOWN = 1,
    PARAMETER_OUT_OF_RANGE = 2,
    PARAMETER_WRONG_KIND = 3,
    PARAMETER_READ_ONLY = 4
} parameter_status_t;

/* A value as it travels: kind and 32 bits. A float is its IEEE 754 bits. */
typedef struct {
    uint8_t kind; /* parameter_kind_t */
    uint32_t bits;
} parameter_value_t;

typedef struct {
    uint32_t bits[PARAMETERS_COUNT];
} parameters_t;

typedef enum {
    PARAMETERS_PAGE_LOADED = 0,
    PARAMETERS_PAGE_EMPTY = 1, /* Erased flash (all ones in the magic): the defaults hold. No error. */
    PARAMETERS_PAGE_BAD = 2    /* Wrong magic, length or CRC: ignored as a whole. */
} parameters_page_t;

/* Every parameter to its default. */
void parameters_init(parameters_t *parameters);

/* Read any parameter. PARAMETER_OK or PARAMETER_UNKNOWN (*value is then unsigned 0). About 60 instructions. */
parameter_status_t parameters_get(const parameters_t *parameters, uint32_t id, parameter_value_t *value);

/* Set a parameter. Anything but PARAMETER_OK leaves it as it was. About 80 instructions. */
parameter_status_t parameters_set(parameters_t *parameters, uint32_t id, parameter_value_t value);

/* For the application's own reading: the value of an unsigned parameter; of a float parameter. 0 for an id that does
 * not exist or has another kind. */
uint32_t parameters_unsigned(const parameters_t *parameters, uint32_t id);
float parameters_float(const parameters_t *parameters, uint32_t id);

/* Set parameters from a stored page of the given size. Entries that are refused (unknown, out of range, wrong kind)
 * are skipped and counted in *refused. A page that is not PARAMETERS_PAGE_LOADED changes nothing. Bound: size / 8
 * entries. */
parameters_page_t parameters_load(parameters_t *parameters, const uint8_t *page, size_t size, uint32_t *refused);

#endif
