/* code_search.h: finds at which chip of the code a record begins, whatever the beacons' amplitudes. It is the first
 * stage of acquire.h.
 *
 * Calls, in the order they are made: code_search_start with a record, code_search_add for each code that may be on the
 * air, then code_search_peak.
 *
 * Method. Samples at their own times, in whole chips, are correlated with each known code at all 1023 phases by
 * Fourier transforms (fourier.h). Lines below 160 Hz are left out (earth, mains); of the three axes the two with most
 * variance are taken, as one complex number. |correlation|^2 is summed over the codes, since all beacons share the
 * phase. In a record with sliding phase half of each sweep sees the chip before the edge: two neighbouring phases
 * share the peak, and their shares tell the edge to a few us.
 *
 * Time: the start takes 470,000 instructions, each code 760,000. Memory: 28.7 kB; the record's spectrum is kept in 16
 * bits, 80 dB below its largest line.
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
    } signal[FOURIER_LENGTH];       /* Spectrum of the record. */
    fourier_t work[FOURIER_LENGTH]; /* The transform under way. */
    float metric[ACQUIRE_CHIPS];    /* |correlation|^2 at each phase, summed over the codes so far. */
} code_search_t;

typedef struct {
    uint32_t label; /* Code chip at the record's origin, before the edge. */
    float crossing; /* Where the edge was first crossed, 0..1 chips behind the origin. */
    float height;   /* Height of the peak, times the mean over all phases. */
} code_peak_t;

/* Begin with a record whose chips are chip_length times as long as the beacons'. */
void code_search_start(code_search_t *search, const acquire_record_t *record, float chip_length);

/* Correlate the record with one code, an index of gold.h at degree 10. */
void code_search_add(code_search_t *search, uint16_t code);

/* Returns, after all codes, the phase that together with the next has the largest sum. */
code_peak_t code_search_peak(const code_search_t *search);

#endif
