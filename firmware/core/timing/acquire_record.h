/* acquire_record.h: the bursts of one code cycle, as acquire.h keeps them: two numbers for each burst and axis. It also
 * makes a chip's sample without the conversion that lies on the ramp.
 *
 * The two numbers are the mean of the burst's settled conversions (field), and the mean of its late conversions minus
 * that of its early ones (step). Without knowledge of the noise nothing is lost by that: noise that a burst has in
 * common is in the first alone, and noise of the single conversions is independent in the two. Both have the scale of
 * epoch_sample: 8 counts of the converter, relative to mid-scale. A burst is cut in one of two ways:
 *   RECORD_HALVES    four and four, all settled, while the edge is looked for;
 *   RECORD_TRACKING  seven and one: seven are settled, and the last one is on the ramp.
 */
#ifndef GOLDFIELD_ACQUIRE_RECORD_H
#define GOLDFIELD_ACQUIRE_RECORD_H

#include <stdint.h>

#define ACQUIRE_AXES  3u    /* Axes of the field: x, y, z. */
#define ACQUIRE_BURST 8u    /* Conversions in a burst. */
#define ACQUIRE_CHIPS 1023u /* Chips in a cycle of degree 10. */

/* How a burst is cut; the value is the number of early conversions. */
typedef enum { RECORD_HALVES = 4, RECORD_TRACKING = 7 } record_cut_t;

typedef struct {
    int16_t field[ACQUIRE_CHIPS][ACQUIRE_AXES];
    int16_t step[ACQUIRE_CHIPS][ACQUIRE_AXES];
} acquire_record_t;

/* Compute the mean and the variance of each axis of a whole record's field. Costs about 60,000 instructions. */
void record_statistics(const acquire_record_t *record, float mean[ACQUIRE_AXES], float variance[ACQUIRE_AXES]);

/* Keep a burst as a chip, 0..1022, of the record. Costs about 200 instructions. */
void record_burst(acquire_record_t *record, uint32_t chip, record_cut_t cut,
                  const uint16_t burst[ACQUIRE_BURST][ACQUIRE_AXES]);

/* Make the sample of a chip without its last conversion, at the scale of epoch_sample. Costs about 180 instructions. */
void acquire_sample(const uint16_t burst[ACQUIRE_BURST][ACQUIRE_AXES], int16_t sample[ACQUIRE_AXES]);

#endif
