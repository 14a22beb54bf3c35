/* epoch.h: turns raw conversions into one cycle's fields in tesla, and into the integers of FIELD and EPOCH_OFFSET. A
 * collector gathers labelled samples into whole cycles, one while main reads the one before.
 *
 * Calls, in the order they are made
 *   1. epoch_init     once; epoch_select when the list of codes changes.
 *   2. epoch_sample   interrupt, for the burst of each chip; then epoch_feed with the sample.
 *   3. epoch_ready    main, once a turn; then despread_transform, epoch_read and epoch_release.
 *   4. epoch_field    main, for each code of a report; epoch_offset for the mean; epoch_integer for what is sent.
 *
 * Scale. A chip's sample is the sum of its burst of EPOCH_BURST conversions relative to mid-scale: sum - 8 * 2048,
 * -16384..16376, so it fits the 16 bits of CHIP and of despread.h. counts, the mean of a burst, is sample / 8 + 2048.
 * The field is B = M (counts - zero), with the parameters zero_* and calibration. Since the field is linear in the
 * sample, the correlation of the field with a code c is
 *   sum_t c[t] B[t] / N = M (R / (8 N) - (zero - 2048) S / N),
 *   R = sum_t c[t] sample[t],   S = sum_t c[t],   N = 2^degree - 1,
 * and its mean is the same with c = 1. (A missing sample counts as mid-scale here, not as zero field.)
 *
 * Dropped cycles. If main has not released a cycle when the next one ends, that next cycle is dropped and counted.
 * Results are late by at most one cycle, or absent, never mixed.
 *
 * Contexts: epoch_feed is called from the sample interrupt, epoch_ready and epoch_release from main.
 */
#ifndef GOLDFIELD_EPOCH_H
#define GOLDFIELD_EPOCH_H

#include <stdbool.h>
#include <stdint.h>

#include "core/codes/despread.h"

#define EPOCH_AXES         DESPREAD_AXES
#define EPOCH_BURST        8u        /* Conversions in the burst of one chip and axis. */
#define EPOCH_SAMPLE_MAX   4095u     /* Largest count of a 12-bit conversion; 0 and 4095 are saturated. */
#define EPOCH_MID_SCALE    2048u     /* Count in the middle of the converter's range. */
#define EPOCH_CODES_MAX    64u       /* Most codes in a report: the length of the parameter code_list. */
#define EPOCH_OUT_OF_RANGE (-524288) /* Integer in the messages of an axis that was not measured. */

/* Sum a burst of 12-bit conversions, [conversion][axis], to a sample relative to mid-scale. A count above 4095, which
 * no 12-bit converter gives, makes the sample worthless. Costs about 115 instructions.
 * Returns true if a conversion was saturated. */
bool epoch_sample(const uint16_t burst[EPOCH_BURST][EPOCH_AXES], int16_t sample[EPOCH_AXES]);

/* ---- Collecting ---- */

typedef struct {
    despread_t despread;
    uint32_t cycle;      /* The cycle's number. */
    uint32_t first_chip; /* Absolute chip of the cycle's code chip 0. */
    uint16_t saturated;  /* Chips of it with a saturated conversion on any axis. */
    bool locked;         /* The chip clock was locked at every chip. */
} epoch_t;

typedef struct {
    epoch_t epochs[2];
    const gold_family_t *family;
    uint32_t dropped; /* Cycles that could not be reported: the chip clock jumped and cut them short though it was
                         locked when they began, or main was late. */
    /* Private. */
    uint8_t filling;   /* Which of the two the interrupt fills. */
    bool collecting;   /* The one being filled has seen chip 0. */
    bool began_locked; /* The chip clock was locked when the cycle being filled began. */
    uint8_t ready;     /* The other one is main's while this is 1. */
} epoch_collector_t;

/* Prepare to collect cycles of this family's codes. */
void epoch_init(epoch_collector_t *collector, const gold_family_t *family);

/* Take one sampled chip: its absolute number, what chip_clock_at says of it, and its sample. Chips come in order. A
 * gap inside a cycle counts as missing chips; a cycle whose chip 0 was not seen is not collected. Costs about 200
 * instructions, 60 more for each chip of a gap.
 * Returns true if a cycle is complete and main should look. */
bool epoch_feed(epoch_collector_t *collector, uint32_t absolute_chip, uint32_t cycle, uint16_t code_chip,
                const int16_t sample[EPOCH_AXES], bool saturated, bool locked);

/* Returns the complete cycle, not yet transformed, or NULL if there is none. It is main's until epoch_release. */
epoch_t *epoch_ready(epoch_collector_t *collector);

/* Give the cycle back to the collector. */
void epoch_release(epoch_collector_t *collector);

/* ---- Scaling ---- */

typedef struct {
    float zero[EPOCH_AXES];               /* Converter's counts at zero field. */
    float matrix[EPOCH_AXES][EPOCH_AXES]; /* M, T per count. */
} epoch_calibration_t;

/* The codes to report, with what despreading needs of them. */
typedef struct {
    uint32_t count; /* Codes in the selection. */
    struct {
        uint16_t code; /* Index of gold.h. */
        uint16_t word; /* Where its correlation is: despread_word. */
        int16_t sum;   /* Sum of its chips: gold_sum. */
    } codes[EPOCH_CODES_MAX];
} epoch_selection_t;

/* Choose the codes of the family to report. Codes above N + 1 and codes beyond the first 64 are left out. Costs with
 * degree 10 about 48,000 instructions a code (18 ms for 64 at an instruction a cycle): main calls it when the list
 * changes.
 * Returns how many codes are in. */
uint32_t epoch_select(epoch_selection_t *selection, const gold_family_t *family, const uint16_t *codes, uint32_t count);

/* What despreading tells of a cycle: exact sums in the samples' unit. */
typedef struct {
    int32_t correlation[EPOCH_CODES_MAX][EPOCH_AXES]; /* Correlations, by entry of the selection. */
    int32_t sum[EPOCH_AXES];                          /* Plain sums of the samples. */
    uint32_t cycle;                                   /* The cycle's number. */
    uint16_t chips;                                   /* N, the chips in a cycle. */
    uint16_t missing, saturated;                      /* Chips without a sample, and with a saturated one. */
    bool locked;                                      /* The chip clock was locked at every chip. */
} epoch_sums_t;

/* Read the sums of a complete cycle that has been transformed. Costs about 60 instructions for each code. */
void epoch_read(const epoch_t *epoch, const epoch_selection_t *selection, epoch_sums_t *sums);

/* Compute the field of entry index of the selection, index < count, in T: the correlation over N. Costs about
 * 160 instructions. */
void epoch_field(const epoch_sums_t *sums, const epoch_calibration_t *calibration, const epoch_selection_t *selection,
                 uint32_t index, float field_T[EPOCH_AXES]);

/* Compute the mean field of a cycle, T. */
void epoch_offset(const epoch_sums_t *sums, const epoch_calibration_t *calibration, float offset_T[EPOCH_AXES]);

/* Compute M (correlation / (8 chips) - (zero - 2048) code_sum / chips) of exact sums, in T: the formula above. Costs
 * about 150 instructions. */
void epoch_scale(const epoch_calibration_t *calibration, const int32_t correlation[EPOCH_AXES], float code_sum,
                 float chips, float field_T[EPOCH_AXES]);

/* Scale a value to the integer of a 20-bit signal. resolution is 1e-10 T for FIELD, 1e-9 T for EPOCH_OFFSET.
 * Returns value / resolution, rounded to the nearest; EPOCH_OUT_OF_RANGE beyond +-524287 and for a value that is not a
 * number. */
int32_t epoch_integer(float value, float resolution);

#endif
