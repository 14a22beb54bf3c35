/* code_field.h: finds the field of every chip of the code, from a record whose code phase is known, and what the
 * record shows of the edge between two chips. It is a stage of acquire.h.
 *
 * Calls, in the order they are made
 *   1. code_field_start     with a record.
 *   2. code_field_subtract  for each code of the list; once more for each in a second pass.
 *   3. code_field_profile   for a sliding record, to be fitted by edge_fit.h; or
 *      code_field_present   for one that does not slide, and code_field_step for each look at its edge.
 *
 * Method. The amplitudes of the codes on three axes come by successive subtraction: what is left is correlated with
 * one code, the code is taken off, and the next one follows. Two passes are made where the record is not a whole
 * settled cycle (a third of a sliding record's samples lies on the ramp and does not count), one where it is, since
 * whole codes are orthogonal. The amplitudes give the field of every chip. The edge shows in two ways, both
 * proportional to the change that the codes make from chip to chip:
 *   share  how much of a change a sample has done; differences of successive samples are compared, which takes off
 *          earth and mains;
 *   step   late conversions of a burst minus early ones, which are free of earth, mains, and noise that a burst has in
 *          common.
 *
 * Memory: 27.8 kB. Time: acquire.h has it.
 */
#ifndef GOLDFIELD_CODE_FIELD_H
#define GOLDFIELD_CODE_FIELD_H

#include <stdbool.h>
#include <stdint.h>

#include "core/timing/acquire_record.h"
#include "core/timing/code_search.h"
#include "core/timing/edge_fit.h"

#define CODE_FIELD_CODES 16u /* Most codes that are estimated at a time; they bound memory and time of a record. */

/* How a record's chips lie to the code's. */
typedef struct {
    bool sliding;      /* The phase slides over the chip during the record. */
    uint32_t label;    /* Code chip of the record's first chip; in a sliding frame at its origin, before the edge. */
    float crossing;    /* Sliding: where the edge was first crossed, chips behind the origin. */
    float chip_length; /* Sliding: length of own chips, chips of the beacons. */
} code_frame_t;

/* Private but amplitude, which has the scale of the record. */
typedef struct {
    float amplitude[CODE_FIELD_CODES][ACQUIRE_AXES]; /* Amplitude of each code. */
    float variance;                                  /* Variance of the record, summed over the axes. */
    float expected[ACQUIRE_CHIPS][ACQUIRE_AXES];     /* Field of each code chip by the amplitudes so far. */
    union {
        float residual[ACQUIRE_CHIPS][ACQUIRE_AXES]; /* What the codes so far leave of the record. */
        edge_profile_t profile;                      /* After the last code: what code_field_profile returns. */
    };
    int8_t chips[ACQUIRE_CHIPS];    /* The code at work, chips of +-1. */
    uint16_t labels[ACQUIRE_CHIPS]; /* The code chip that each sample shows, and whether it is settled. */
} code_field_t;

/* Locate a sample of a sliding frame. *phase becomes how far behind the edge's first place it lies, -0.5..0.5 chip.
 * Returns the code chip before the edge near the sample. */
uint32_t code_frame_label(const code_frame_t *frame, uint32_t chip, float *phase);

/* Begin with a record, all amplitudes 0. */
void code_field_start(code_field_t *field, const acquire_record_t *record, const code_frame_t *frame);

/* Estimate one code, an index of gold.h at degree 10, as number 0..15 of the list, and take it off what is left. */
void code_field_subtract(code_field_t *field, uint32_t number, uint16_t code);

/* Returns true if the codes' share of the variance of a whole cycle is more than that of noise. */
bool code_field_present(const code_field_t *field, uint32_t codes);

/* Returns what a sliding record shows of the edge. The profile lies in *field until the next code_field_start. */
const edge_profile_t *code_field_profile(code_field_t *field, const acquire_record_t *record,
                                         const code_frame_t *frame);

/* Measure the step in chips first..end-1 of a record that does not slide and whose first chip is code chip label.
 * *variance becomes the variance that its residuals show. Returns the step as a share of the change. */
float code_field_step(const code_field_t *field, const acquire_record_t *record, uint32_t label, uint32_t first,
                      uint32_t end, float *variance);

#endif
