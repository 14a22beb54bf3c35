/* epoch.h: from raw conversions to one cycle's fields in tesla, and to the integers of FIELD and EPOCH_OFFSET.
 *
 * A chip's sample is the sum of its burst of EPOCH_BURST conversions, relative to mid-scale: sum - 8 * 2048, -16384..16376, so it fits the 16 bits of CHIP and of
 * despread.h. counts, the mean of a burst, is sample / 8 + 2048; the field is B = M (counts - zero), parameters zero_* and calibration.
 * Since the field is linear in the sample, the correlation of the field with a code c is
 *   sum_t c[t] B[t] / N = M ( R / (8 N) - (zero - 2048) S / N ),   R = sum_t c[t] sample[t],  S = sum_t c[t],  N = 1023,
 * and its mean is the same with c = 1. (A missing sample counts as mid-scale here, not as zero field.)
 *
 * The collector turns a stream of labelled samples into whole cycles. It owns one despread_t at a time: while one cycle is read by main, the next is collected into the other. If
 * main has not released it when the next cycle ends, that next cycle is dropped and counted: results are late by at most one cycle, or absent, never mixed.
 *
 * Contexts: epoch_feed from the sample interrupt; epoch_ready, epoch_release from main.
 */
#ifndef GOLDFIELD_EPOCH_H
#define GOLDFIELD_EPOCH_H

#include <stdbool.h>
#include <stdint.h>

#include "despread.h"

#define EPOCH_AXES DESPREAD_AXES
#define EPOCH_BURST 8u
#define EPOCH_SAMPLE_MAX 4095u     /* A conversion of 0 or 4095 is saturated. */
#define EPOCH_MID_SCALE 2048u
#define EPOCH_CODES_MAX 64u
#define EPOCH_OUT_OF_RANGE (-524288) /* The message's integer of an axis that was not measured. */

/* Sum a burst of 12-bit conversions, [conversion][axis], to a sample relative to mid-scale. True: a conversion was saturated. A count above 4095, which no
 * 12-bit converter gives, makes the sample worthless. About 115 instructions. */
bool epoch_sample(const uint16_t burst[EPOCH_BURST][EPOCH_AXES], int16_t sample[EPOCH_AXES]);

/* ---- Collecting ---- */

typedef struct {
    despread_t despread;
    uint32_t cycle;
    uint32_t first_chip; /* Absolute chip of code chip 0. */
    uint16_t saturated;  /* Chips with a saturated conversion on any axis. */
    bool locked;         /* The chip clock was locked at every chip. */
} epoch_t;

typedef struct {
    epoch_t epochs[2];
    uint32_t dropped;  /* Cycles that began but could not be reported: cut short by a jump of the chip clock, or main was late. */
    uint8_t filling;   /* Private from here: which one the interrupt fills; */
    bool collecting;   /* it has seen chip 0; */
    uint8_t ready;     /* the other is main's while this is 1. */
} epoch_collector_t;

void epoch_init(epoch_collector_t *collector);

/* One sampled chip: its absolute number and what chip_clock_at says of it. Call in order. A gap inside a cycle counts as missing chips; a cycle whose chip 0 was not seen is
 * not collected. True: a cycle is complete and main should look. About 195 instructions, more by 60 for each chip of a gap. */
bool epoch_feed(epoch_collector_t *collector, uint32_t absolute_chip, uint32_t cycle, uint16_t code_chip, const int16_t sample[EPOCH_AXES],
                bool saturated, bool locked);

/* Main: the complete cycle, not yet transformed (call despread_transform); NULL if there is none. It is main's until epoch_release. */
epoch_t *epoch_ready(epoch_collector_t *collector);
void epoch_release(epoch_collector_t *collector);

/* ---- Scaling ---- */

typedef struct {
    float zero[EPOCH_AXES];                /* Counts at zero field. */
    float matrix[EPOCH_AXES][EPOCH_AXES];  /* T per count. */
} epoch_calibration_t;

/* Codes to report, with what despreading needs of them. */
typedef struct {
    uint32_t count;
    struct {
        uint16_t code;
        uint16_t word; /* despread_word(code) */
        int16_t sum;   /* gold_sum(10, code) */
    } codes[EPOCH_CODES_MAX];
} epoch_selection_t;

/* Choose the codes to report. Codes above 1024 and codes beyond the first 64 are left out; returns how many are in.
 * About 48,000 instructions a code (18 ms for 64 at an instruction a cycle): in main, when the list changes. */
uint32_t epoch_select(epoch_selection_t *selection, const uint16_t *codes, uint32_t count);

/* The field of entry index of the selection, T, from a transformed cycle. index < count. About 225 instructions. */
void epoch_field(const despread_t *despread, const epoch_calibration_t *calibration, const epoch_selection_t *selection, uint32_t index,
                 float field_T[EPOCH_AXES]);

/* The mean field of a cycle, T. */
void epoch_offset(const despread_t *despread, const epoch_calibration_t *calibration, float offset_T[EPOCH_AXES]);

/* The integer of a 20-bit signal: value / resolution, rounded to the nearest; EPOCH_OUT_OF_RANGE beyond +-524287 and for a value that is not a number.
 * resolution is 1e-10 T for FIELD, 1e-9 T for EPOCH_OFFSET. */
int32_t epoch_integer(float value, float resolution);

#endif
