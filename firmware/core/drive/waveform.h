/* waveform.h: what a beacon's drives do in each chip of a cycle: a level from -1 to 1 for each channel. The bridge
 * gives the level its sign, the driver's set-point its size; both change at the chip's edge, by hardware.
 *
 * Calls, in the order they are made: waveform_start with a configuration, then waveform_next once for each chip;
 * waveform_channels tells how many channels a kind drives.
 *
 * Kinds, in chip t of N. Channel 1 is driven by the rotating one alone.
 *   code (CDMA)  One Gold code; its bit 0 is +1.
 *   slot (TDMA)  +1 during one of `slots` equal slots of N / slots chips (integer division), 0 in all others. Chips
 *                that are left over after the last slot, and slots of no beacon, stay quiet: the host measures the
 *                ambient field there.
 *   tone (FDMA)  A square wave of whole periods in a cycle, +1 where cos(2 pi periods t / N) > 0 and -1 elsewhere; N
 *                is odd, so no cosine is 0. At equal peak current it carries twice the power of a sine. Its odd
 *                harmonics reach other beacons' lines; the host's least squares on the square waves themselves takes
 *                them apart exactly.
 *   rotating     Channel 0 is cos(2 pi periods t / N), channel 1 is sin(2 pi periods t / N), held during the chip. Two
 *                crossed coils then make a field that turns.
 *   codes        The sum of K codes, K = 1..WAVEFORM_CODES, divided by K. Code i has a degree of its own, runs
 *                `offset` of its own chips ahead, and each of its chips lasts `hold` chips of the cycle. Its length
 *                times hold must divide N, so that every cycle is the same.
 *
 * Sources: US patent 6,691,074 (CDMA, superposition; pulsed DC and AC as its prior art); Zheng et al. (rotating
 * field). The host's templates are in host/goldfield/access/waveform.py.
 *
 * Contexts: one. Memory: 92 bytes, owned by the caller. Errors: nothing fails silently; waveform_start refuses a
 * waveform that does not exist.
 */
#ifndef GOLDFIELD_WAVEFORM_H
#define GOLDFIELD_WAVEFORM_H

#include <stdbool.h>
#include <stdint.h>

#include "core/codes/gold.h"

#define WAVEFORM_CHANNELS 2u    /* Channels of a board: a rotating field takes two. */
#define WAVEFORM_CODES    4u    /* Most codes that are superposed. */
#define WAVEFORM_ONE      16384 /* The level 1 as an integer. */

typedef enum {
    WAVEFORM_CODE = 0,
    WAVEFORM_SLOT = 1,
    WAVEFORM_TONE = 2,
    WAVEFORM_ROTATING = 3,
    WAVEFORM_SUPERPOSED = 4
} waveform_kind_t;

typedef struct {
    uint32_t degree; /* Degree of the code; 0: this place has none. */
    uint32_t index;  /* Index of gold.h, 0..length + 1. */
    uint32_t offset; /* How far it runs ahead, own chips, 0..length - 1. */
    uint32_t hold;   /* Chips of the cycle in one of its own, 1 or more. */
} waveform_code_t;

typedef struct {
    uint32_t kind;                         /* A waveform_kind_t; it decides which of the others count. */
    uint32_t code;                         /* WAVEFORM_CODE: index of gold.h, 0..N+1. */
    uint32_t slots, slot;                  /* WAVEFORM_SLOT: number of slots, 1..N, and the own one, 0..slots-1. */
    uint32_t periods;                      /* WAVEFORM_TONE and WAVEFORM_ROTATING: periods in a cycle, 1..(N-1)/2. */
    waveform_code_t codes[WAVEFORM_CODES]; /* WAVEFORM_SUPERPOSED: the codes. */
} waveform_config_t;

/* One of the superposed codes, chip after chip. */
typedef struct {
    gold_generator_t generator;
    uint16_t hold, left; /* Chips of the cycle in one of its own, and how many of them are still to come. */
    int8_t sign;         /* Sign of its present chip. */
} waveform_part_t;

/* A waveform, chip after chip; fields are private. */
typedef struct {
    uint16_t kind, length; /* The waveform_kind_t, and N. */
    union {
        struct {
            uint16_t count; /* K, the codes. */
            float share;    /* 1 / K. */
            waveform_part_t parts[WAVEFORM_CODES];
        } codes;
        struct {
            uint16_t chip, first, end; /* The present chip; the slot's first chip, and the one after its last. */
        } slot;
        struct {
            uint16_t phase, step; /* periods t mod N, and periods. */
        } tone;
    } of;
} waveform_t;

/* Returns how many channels a kind drives: 2 for WAVEFORM_ROTATING, 1 for all others. */
uint32_t waveform_channels(uint32_t kind);

/* Start at chip 0 of the cycle of N = 2^degree - 1 chips. Costs a gold_start for each code, about 3000 instructions.
 * Returns false, with the waveform untouched, for a kind, degree or number that does not exist, for codes that do not
 * fit the cycle, and for no code at all. */
bool waveform_start(waveform_t *waveform, uint32_t degree, const waveform_config_t *config);

/* Give the levels of the present chip, -WAVEFORM_ONE..WAVEFORM_ONE, and move on to the next, after the last to chip 0.
 * The error of a sinusoid is at most one unit. Costs about 96 instructions for one code, 273 for four, 110 for a
 * rotating field. */
void waveform_next(waveform_t *waveform, int16_t level[WAVEFORM_CHANNELS]);

#endif
