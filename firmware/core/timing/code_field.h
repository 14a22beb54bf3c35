/* code_field.h: the field of every chip of the code, from a record whose code phase is known, and what the record shows
 * of the edge between two chips.
 *
 * Amplitudes of the codes, three axes, by successive subtraction: correlate what is left with one code, take it off,
 * next code. Two passes where the record is not a whole settled cycle (a third of a sliding record's samples lies on
 * the ramp and does not count), one where it is, since whole codes are orthogonal. From them the field of every chip.
 * The edge shows in two ways, both proportional to the change that the codes make from chip to chip:
 *   the share of a change that a sample has done; differences of successive samples are compared, which takes off earth
 *     and mains;
 *   the step within a burst, late conversions minus early ones; earth, mains, and noise that a burst has in common are
 *     not in it.
 * Memory: 27.8 kB. Time: with acquire.h.
 */
#ifndef GOLDFIELD_CODE_FIELD_H
#define GOLDFIELD_CODE_FIELD_H

#include <stdbool.h>
#include <stdint.h>

#include "core/timing/acquire_record.h"
#include "core/timing/code_search.h"
#include "core/timing/edge_fit.h"

#define CODE_FIELD_CODES 16u

/* How a record's chips lie to the code's. */
typedef struct {
    bool sliding;
    uint32_t label;    /* Code chip of the record's first. Sliding: at its origin, before the edge; */
    float crossing;    /* where the edge was first crossed, chips; */
    float chip_length; /* length of own chips. */
} code_frame_t;

/* Private but amplitude, scale of the record. */
typedef struct {
    float amplitude[CODE_FIELD_CODES][ACQUIRE_AXES];
    float variance; /* Of the record, sum over the axes. */
    float expected[ACQUIRE_CHIPS][ACQUIRE_AXES];
    union {
        float residual[ACQUIRE_CHIPS][ACQUIRE_AXES];
        edge_profile_t profile; /* After the last code. */
    };
    int8_t chips[ACQUIRE_CHIPS];
    uint16_t labels[ACQUIRE_CHIPS]; /* Of each sample its code chip, and whether it is settled. */
} code_field_t;

/* Sliding frames: code chip before the edge near chip, and how far behind the edge's first place (-0.5..0.5 chip)
 * the sample lies. */
uint32_t code_frame_label(const code_frame_t *frame, uint32_t chip, float *phase);

void code_field_start(code_field_t *field, const acquire_record_t *record, const code_frame_t *frame);

/* One code, index of gold.h at degree 10, as number 0..15 of the list. */
void code_field_subtract(code_field_t *field, uint32_t number, uint16_t code);

/* True if the codes' share of the variance is more than that of noise, of a whole cycle. */
bool code_field_present(const code_field_t *field, uint32_t codes);

/* Of a sliding record. */
const edge_profile_t *code_field_profile(code_field_t *field, const acquire_record_t *record,
                                         const code_frame_t *frame);

/* Of chips first..end-1 of a record that does not slide and whose first chip is code chip label: the step as a share
 * of the change, and the variance that its residuals show. */
float code_field_step(const code_field_t *field, const acquire_record_t *record, uint32_t label, uint32_t first,
                      uint32_t end, float *variance);

#endif
