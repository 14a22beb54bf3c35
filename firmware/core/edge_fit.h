/* edge_fit.h: where in the chip the beacons' field begins to change, and how long it takes, from samples whose phase slid over the chip.
 *
 * Model. The field goes from one chip's value to the next's on a ramp that begins at the onset x and lasts the rise L (a driver that slews its coil at constant
 * voltage); a sample is the mean over a burst of width w. With F(t) = 0, t^2 / 2L, t - L/2 before, on and behind the ramp, a burst centred t after the
 * onset has done the fraction g(t) = (F(t + w/2) - F(t - w/2)) / w of the change. The onset moves linearly with time: two clocks of different rate.
 *
 * Method. Least squares by Gauss and Newton in (x, slip, L) on the fractions seen in 3 sweeps of 32 bins, each weighted as its variance asks for.
 * Bound: 20 steps of 96 bins, about 150,000 instructions. Nothing is kept.
 */
#ifndef GOLDFIELD_EDGE_FIT_H
#define GOLDFIELD_EDGE_FIT_H

#include <stdbool.h>
#include <stdint.h>

#define EDGE_FIT_SWEEPS 3u
#define EDGE_FIT_BINS 32u

/* Of a bin: sum of (change seen) times (change of the whole edge), sum of (whole edge) squared, and that times the chip at which it was seen. Bin b is centred at
 * (b + 1/2 - 16) bin_ticks from the middle of the frame. */
typedef struct {
    float product[EDGE_FIT_SWEEPS][EDGE_FIT_BINS];
    float weight[EDGE_FIT_SWEEPS][EDGE_FIT_BINS];
    float moment[EDGE_FIT_SWEEPS][EDGE_FIT_BINS];
} edge_profile_t;

typedef struct {
    float onset_ticks;         /* From the middle of the frame, at chip 511 of the record. */
    float slip_ticks_per_chip; /* Of the onset: the beacons' chip minus the frame's. */
    float rise_ticks;
} edge_fit_t;

/* False: the profile shows no edge (half its variance is unexplained, or bins without weight abound); *fit is then worthless. */
bool edge_fit(const edge_profile_t *profile, float bin_ticks, float burst_ticks, edge_fit_t *fit);

#endif
