/* waveform.h: what a beacon's drives do in each chip of a cycle: a level from -1 to 1 for each channel.
 *
 * The bridge gives the level its sign, the driver's set-point its size; both change at the chip's edge, by hardware.
 * Channel 1 is driven by WAVEFORM_ROTATING alone. In chip t of N:
 *   code     (CDMA): one Gold code, bit 0: +1.
 *   slot     (TDMA): +1 during one of `slots` equal slots of N / slots chips (integer division), 0 in all others. Chips
 *            that are left over after the last slot, and slots of no beacon, stay quiet: the host measures the ambient
 *            field there.
 *   tone     (FDMA): a square wave of whole periods in a cycle, +1 where cos(2 pi periods t / N) > 0 and -1 elsewhere;
 *            N is odd, so no cosine is 0. At equal peak current it carries twice the power of a sine. Its odd harmonics
 *            reach other beacons' lines; the host's least squares on the square waves themselves takes them apart
 *            exactly.
 *   rotating: channel 0 cos(2 pi periods t / N), channel 1 sin(2 pi periods t / N), held during the chip. Two crossed
 *     coils then make a field that turns.
 *   codes:   the sum of K codes, K = 1..WAVEFORM_CODES, divided by K. Code i has a degree of its own, runs `offset` of
 *            its own chips ahead, and each of its chips lasts `hold` chips of the cycle. Its length times hold must
 *            divide N, so that every cycle is the same.
 *
 * Sources: US patent 6,691,074 (CDMA, superposition; pulsed DC and AC as its prior art); Zheng et al. (rotating field).
 * The host's templates: host/goldfield/access/waveform.py.
 *
 * Contexts: one. Memory: 116 bytes, owned by the caller. Nothing fails silently: a waveform that does not exist is
 * refused by waveform_start.
 */
#ifndef GOLDFIELD_WAVEFORM_H
#define GOLDFIELD_WAVEFORM_H

#include <stdbool.h>
#include <stdint.h>

#include "core/codes/gold.h"

#define WAVEFORM_CHANNELS 2u
#define WAVEFORM_CODES    4u
#define WAVEFORM_ONE      16384 /* The level 1. */

typedef enum {
    WAVEFORM_CODE = 0,
    WAVEFORM_SLOT = 1,
    WAVEFORM_TONE = 2,
    WAVEFORM_ROTATING = 3,
    WAVEFORM_SUPERPOSED = 4
} waveform_kind_t;

typedef struct {
    uint32_t degree; /* 0: no code. */
    uint32_t index;  /* 0..length + 1 */
    uint32_t offset; /* 0..length - 1 */
    uint32_t hold;   /* 1.. */
} waveform_code_t;

typedef struct {
    uint32_t kind;                         /* waveform_kind_t */
    uint32_t code;                         /* Of WAVEFORM_CODE: index, 0..N+1. */
    uint32_t slots, slot;                  /* Of WAVEFORM_SLOT: 1..N, and 0..slots-1. */
    uint32_t periods;                      /* Of WAVEFORM_TONE and WAVEFORM_ROTATING: 1..(N-1)/2. */
    waveform_code_t codes[WAVEFORM_CODES]; /* Of WAVEFORM_SUPERPOSED. */
} waveform_config_t;

/* One of the codes, chip after chip. */
typedef struct {
    gold_generator_t generator;
    uint16_t hold, left; /* Chips of the cycle in one of its own, and how many of them are still to come. */
    int8_t sign;         /* Of its present chip. */
} waveform_part_t;

/* A waveform, chip after chip; fields are private. */
typedef struct {
    uint16_t kind, length;
    union {
        struct {
            uint16_t count;
            float share; /* 1 / count */
            waveform_part_t parts[WAVEFORM_CODES];
        } codes;
        struct {
            uint16_t chip, first, end;
        } slot;
        struct {
            uint16_t phase, step; /* periods t mod N, and periods. */
        } tone;
    } of;
} waveform_t;

/* How many channels a kind drives: 2 for WAVEFORM_ROTATING, 1 for all others. */
uint32_t waveform_channels(uint32_t kind);

/* Start at chip 0 of the cycle of N = 2^degree - 1 chips. False, and the waveform untouched, for a kind, degree or
 * number that does not exist, for codes that do not fit the cycle, and for none at all. Bound: gold_start for each
 * code, about 3000 instructions. */
bool waveform_start(waveform_t *waveform, uint32_t degree, const waveform_config_t *config);

/* Levels of the present chip, -WAVEFORM_ONE..WAVEFORM_ONE; moves on to the next, and after the last chip to chip 0.
 * Error of a sinusoid at most one unit. About 96 instructions of one code, 273 of four, 110 of a rotating field. */
void waveform_next(waveform_t *waveform, int16_t level[WAVEFORM_CHANNELS]);

#endif
