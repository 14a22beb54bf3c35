/* code_search.h: at which chip of the code a record begins, whatever the beacons' amplitudes.
 *
 * Samples at their own times, in whole chips, are correlated with each known code at all 1023 phases by Fourier
 * transforms (fourier.h; below 160 Hz is left out: earth, mains; of the three axes the two with most variance, as one
 * complex number). |correlation|^2 is summed over the codes, since all beacons share the phase. In a record with
 * sliding phase half of each sweep sees the chip before the edge: two neighbouring phases share the peak, and their
 * shares tell the edge to a few us. Time: start 470,000, each code 760,000 instructions. Memory: 28.7 kB; the record's
 * spectrum is kept in 16 bits, 80 dB below its largest line.
 */
#ifndef GOLDFIELD_CODE_SEARCH_H
#define GOLDFIELD_CODE_SEARCH_H

#include <stdint.h>

#include "core/math/fourier.h"
#include "core/timing/acquire_record.h"

/* Private. */
typedef struct {
    struct {
        int16_t re, im;
    } signal[FOURIER_LENGTH];
    fourier_t work[FOURIER_LENGTH];
    float metric[ACQUIRE_CHIPS];
} code_search_t;

typedef struct {
    uint32_t label; /* Code chip at the record's origin, before the edge. */
    float crossing; /* Where the edge was first crossed, 0..1 chips behind the origin. */
    float height;   /* Of the peak, times the mean. */
} code_peak_t;

/* A new record, whose chips are chip_length of the beacons' long. */
void code_search_start(code_search_t *search, const acquire_record_t *record, float chip_length);

/* One code, index of gold.h at degree 10. */
void code_search_add(code_search_t *search, uint16_t code);

/* After all codes: the phase that with the next has the largest sum. */
code_peak_t code_search_peak(const code_search_t *search);

#endif
