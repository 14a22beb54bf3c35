/* epoch.h: from raw conversions to one cycle's fields in tesla, and to the integers of FIELD and EPOCH_OFFSET.
 *
 * A chip's sample is the sum of its burst of EPOCH_BURST conversions, relative to mid-scale: sum - 8 * 2048,
 * -16384..16376, so it fits the 16 bits of CHIP and of despread.h. counts, the mean of a burst, is sample / 8 + 2048;
 * the field is B = M (counts - zero), parameters zero_* and calibration. Since the field is linear in the sample, the
 * correlation of the field with a code c is
 *   sum_t c[t] B[t] / N = M ( R / (8 N) - (zero - 2048) S / N ),   R = sum_t c[t] sample[t],  S = sum_t c[t],  N =
 *     2^degree - 1,
 * and its mean is the same with c = 1. (A missing sample counts as mid-scale here, not as zero field.)
 *
 * The collector turns a stream of labelled samples into whole cycles. It owns one despread_t at a time: while one cycle
 * is read by main, the next is collected into the other. If main has not released it when the next cycle ends, that
 * next cycle is dropped and counted: results are late by at most one cycle, or absent, never mixed.
 *
 * Thirds, with degree 10 only (of the other lengths only 63 is a multiple of 3, and its thirds are shorter than a
 * block). For a moving sensor the collector hands over each third of a cycle (341 chips) as if it were a cycle: main
 * then has a third of the time. If one is dropped the cycle's later ones are not collected: after third 0 come 1 and 2
 * of the same cycle, or another third 0. epoch_add puts the exact sums of the thirds together to the cycle's: the same
 * integers as without thirds.
 *
 * Contexts: epoch_feed from the sample interrupt; epoch_ready, epoch_release from main.
 */
#ifndef GOLDFIELD_EPOCH_H
#define GOLDFIELD_EPOCH_H

#include <stdbool.h>
#include <stdint.h>

#include "core/codes/despread.h"

#define EPOCH_AXES         DESPREAD_AXES
#define EPOCH_BURST        8u
#define EPOCH_SAMPLE_MAX   4095u /* A conversion of 0 or 4095 is saturated. */
#define EPOCH_MID_SCALE    2048u
#define EPOCH_CODES_MAX    64u
#define EPOCH_THIRDS       3u
#define EPOCH_THIRD_CHIPS  341u
#define EPOCH_WHOLE        EPOCH_THIRDS /* In place of the number of a third: the whole cycle. */
#define EPOCH_OUT_OF_RANGE (-524288)    /* The message's integer of an axis that was not measured. */

/* Sum a burst of 12-bit conversions, [conversion][axis], to a sample relative to mid-scale. True: a conversion was
 * saturated. A count above 4095, which no 12-bit converter gives, makes the sample worthless. About 115
 * instructions. */
bool epoch_sample(const uint16_t burst[EPOCH_BURST][EPOCH_AXES], int16_t sample[EPOCH_AXES]);

/* ---- Collecting ---- */

typedef struct {
    despread_t despread;
    uint32_t cycle;
    uint32_t first_chip; /* Absolute chip of code chip 0. */
    uint8_t third;       /* 0, 1, 2: the samples are of this third of the cycle; EPOCH_WHOLE: of all of it. */
    uint16_t saturated;  /* Chips of it with a saturated conversion on any axis. */
    bool locked;         /* The chip clock was locked at every chip. */
} epoch_t;

typedef struct {
    epoch_t epochs[2];
    const gold_family_t *family;
    uint32_t dropped; /* Cycles that began but could not be reported: cut short by a jump of the chip clock, or main was
                         late. */
    bool thirds;      /* Main's wish, with degree 10 only: cycles that begin from now on come in thirds. */
    uint8_t filling;  /* Private from here: which one the interrupt fills; */
    bool collecting;  /* it has seen chip 0; */
    uint8_t ready;    /* the other is main's while this is 1. */
} epoch_collector_t;

/* For codes of this family. */
void epoch_init(epoch_collector_t *collector, const gold_family_t *family);

/* One sampled chip: its absolute number and what chip_clock_at says of it. Call in order. A gap inside a cycle
 * counts as missing chips; a cycle whose chip 0 was not seen is not collected. True: a cycle or third is complete
 * and main should look. About 200 instructions, more by 60 for each chip of a gap and 4,000 for each beginning
 * third. */
bool epoch_feed(epoch_collector_t *collector, uint32_t absolute_chip, uint32_t cycle, uint16_t code_chip,
                const int16_t sample[EPOCH_AXES], bool saturated, bool locked);

/* Main: the complete cycle or third, not yet transformed (epoch_read does that); NULL if there is none. It is main's
 * until epoch_release. */
epoch_t *epoch_ready(epoch_collector_t *collector);
void epoch_release(epoch_collector_t *collector);

/* ---- Scaling ---- */

typedef struct {
    float zero[EPOCH_AXES];               /* Counts at zero field. */
    float matrix[EPOCH_AXES][EPOCH_AXES]; /* T per count. */
} epoch_calibration_t;

/* Codes to report, with what despreading needs of them. */
typedef struct {
    uint32_t count;
    struct {
        uint16_t code;
        uint16_t word;                   /* despread_word */
        int16_t sum;                     /* gold_sum */
        int16_t third_sum[EPOCH_THIRDS]; /* The same over each third. */
    } codes[EPOCH_CODES_MAX];
} epoch_selection_t;

/* Choose the codes of the family to report. Codes above N + 1 and codes beyond the first 64 are left out; returns
 * how many are in. With degree 10 about 48,000 instructions a code (18 ms for 64 at an instruction a cycle): in
 * main, when the list changes. */
uint32_t epoch_select(epoch_selection_t *selection, const gold_family_t *family, const uint16_t *codes, uint32_t count);

/* What despreading tells of a cycle or of a third: exact sums in the samples' unit. */
typedef struct {
    int32_t correlation[EPOCH_CODES_MAX][EPOCH_AXES]; /* By entry of the selection. */
    int32_t sum[EPOCH_AXES];
    uint32_t cycle;
    uint16_t chips;              /* N, of a whole cycle; */
    uint16_t missing, saturated; /* of these. */
    uint8_t third;               /* As in epoch_t. */
    bool locked;
} epoch_sums_t;

/* Transform a complete cycle or third, once, and read its sums. As despread_transform, and about 60 instructions for
 * each code. */
void epoch_read(epoch_t *epoch, const epoch_selection_t *selection, epoch_sums_t *sums);

/* Add the next third to those of the same cycle before it; a third 0 or a whole cycle replaces what was there, a
 * third that does not follow is left out. count: of the selection; if that changes, set total->third to EPOCH_WHOLE:
 * the rest of the cycle is then left out. True: total is a whole cycle now. */
bool epoch_add(epoch_sums_t *total, const epoch_sums_t *part, uint32_t count);

/* The field of entry index of the selection, T: correlation over N, also that of a third. index < count. About 215
 * instructions. */
void epoch_field(const epoch_sums_t *sums, const epoch_calibration_t *calibration, const epoch_selection_t *selection,
                 uint32_t index, float field_T[EPOCH_AXES]);

/* The mean field of a cycle, T; of a third its sum over N. */
void epoch_offset(const epoch_sums_t *sums, const epoch_calibration_t *calibration, float offset_T[EPOCH_AXES]);

/* The integer of a 20-bit signal: value / resolution, rounded to the nearest; EPOCH_OUT_OF_RANGE beyond +-524287 and
 * for a value that is not a number. resolution is 1e-10 T for FIELD and PART, 1e-9 T for EPOCH_OFFSET. */
int32_t epoch_integer(float value, float resolution);

#endif
