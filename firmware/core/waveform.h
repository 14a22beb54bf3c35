/* waveform.h: what a beacon's bridge does in each chip of a cycle: +1, -1 or 0 (off).
 *
 * A bridge has two levels and off, switched by timer and DMA at the chip's edge. That settles what a board can drive:
 *   code  (CDMA): one Gold code, bit 0: +1. Several codes at once have more than two levels: not with this bridge.
 *   slot  (TDMA): +1 during one of `slots` equal slots of N / slots chips (integer division), off in all others. Chips that are left over after the last slot,
 *         and slots of no beacon, stay quiet: the host measures the ambient field there.
 *   tone  (FDMA): a square wave of whole periods in a cycle, +1 where cos(2 pi periods t / N) > 0 and -1 elsewhere; N is odd, so no cosine is 0. A sine would need
 *         a new set-point from the processor at each chip's edge, late by the latency of an interrupt; and at equal peak current the square wave carries twice
 *         the power. Its odd harmonics reach other beacons' lines; the host's least squares on the square waves themselves takes them apart exactly.
 *
 * Source: US patent 6,691,074 (CDMA, superposition); pulsed DC and AC as its prior art. The host's templates: host/goldfield/access/waveform.py.
 *
 * Contexts: one. Memory: 32 bytes, owned by the caller. Nothing fails silently: a waveform that does not exist is refused by waveform_start.
 */
#ifndef GOLDFIELD_WAVEFORM_H
#define GOLDFIELD_WAVEFORM_H

#include <stdbool.h>
#include <stdint.h>

#include "gold.h"

typedef enum { WAVEFORM_CODE = 0, WAVEFORM_SLOT = 1, WAVEFORM_TONE = 2 } waveform_kind_t;

typedef struct {
    uint32_t kind;        /* waveform_kind_t */
    uint32_t code;        /* Of WAVEFORM_CODE: index, 0..N+1. */
    uint32_t slots, slot; /* Of WAVEFORM_SLOT: 1..N, and 0..slots-1. */
    uint32_t periods;     /* Of WAVEFORM_TONE: 1..(N-1)/2. */
} waveform_config_t;

/* A waveform, chip after chip; fields are private. */
typedef struct {
    uint16_t kind, length;
    union {
        gold_generator_t code;
        struct {
            uint16_t chip, first, end;
        } slot;
        struct {
            uint16_t phase, step; /* periods t mod N, and periods. */
        } tone;
    } of;
} waveform_t;

/* Start at chip 0 of the cycle of N = 2^degree - 1 chips. False, and the waveform untouched, for a kind, degree or number that does not exist.
 * Bound: gold_start, about 3000 instructions. */
bool waveform_start(waveform_t *waveform, uint32_t degree, const waveform_config_t *config);

/* The present chip: +1, -1 or 0; moves on to the next, and after the last chip to chip 0. About 45 instructions. */
int8_t waveform_next(waveform_t *waveform);

#endif
