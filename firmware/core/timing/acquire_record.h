/* acquire_record.h: the bursts of one code cycle, as acquire.h keeps them.
 *
 * Of each burst and axis two numbers: the mean of its settled conversions, and the mean of its late conversions minus
 * that of its early ones. Without knowledge of the noise nothing is lost by that: noise that a burst has in common is
 * in the first alone, noise of the single conversions is independent in the two. Scale: 8 counts of the converter,
 * relative to mid-scale, like epoch_sample's. Two ways to cut a burst: RECORD_HALVES, four and four, all settled: while
 * the edge is looked for; RECORD_TRACKING, seven and one, seven settled: the last one on the ramp.
 */
#ifndef GOLDFIELD_ACQUIRE_RECORD_H
#define GOLDFIELD_ACQUIRE_RECORD_H

#include <stdint.h>

#define ACQUIRE_AXES  3u
#define ACQUIRE_BURST 8u
#define ACQUIRE_CHIPS 1023u

/* The number of early conversions. */
typedef enum { RECORD_HALVES = 4, RECORD_TRACKING = 7 } record_cut_t;

typedef struct {
    int16_t field[ACQUIRE_CHIPS][ACQUIRE_AXES];
    int16_t step[ACQUIRE_CHIPS][ACQUIRE_AXES];
} acquire_record_t;

/* Of a whole record's field: mean of each axis, variance of each axis. About 60,000 instructions. */
void record_statistics(const acquire_record_t *record, float mean[ACQUIRE_AXES], float variance[ACQUIRE_AXES]);

/* Keep a burst as chip 0..1022. About 200 instructions. */
void record_burst(acquire_record_t *record, uint32_t chip, record_cut_t cut,
                  const uint16_t burst[ACQUIRE_BURST][ACQUIRE_AXES]);

/* The sample of a chip without its last conversion, at the scale of epoch_sample. About 180 instructions. */
void acquire_sample(const uint16_t burst[ACQUIRE_BURST][ACQUIRE_AXES], int16_t sample[ACQUIRE_AXES]);

#endif
