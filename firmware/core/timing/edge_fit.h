/* edge_fit.h: where in the chip the beacons' field begins to change, and how long it takes, from bursts whose phase
 * slid over the chip.
 *
 * Model. The field goes from one chip's value to the next's on a ramp that begins at the onset x and lasts the rise L
 * (a driver that slews its coil at constant voltage), seen through a first-order low-pass. S(t) = t^2 / 2 - lag R(t),
 * R(t) = t - lag (1 - exp(-t / lag)), both 0 before t = 0, are the integral and the height of an endless ramp behind
 * the low-pass; A(t) = (S(t) - S(t - L)) / L is the integral of the share of the change that is done. A burst of width
 * w centred t after the onset has
 *     level (A(t + w/2) - A(t - w/2)) / w,   step between its halves (A(t + w/2) - 2 A(t) + A(t - w/2)) 2 / w.
 * The onset moves linearly with time: two clocks of different rate.
 *
 * Method. Least squares by Gauss and Newton in (x, slip, L) on levels and steps of 3 sweeps of 32 bins. Levels and
 * steps are each weighted by the variance that their own residuals show, anew in each step, and these give the
 * covariance of the result: nothing is assumed of the noise but that bins have it alike. So a sensor whose bursts have
 * their noise in common is timed by the steps, one with noise of single conversions by both. Bound: 8 steps of 96 bins,
 * about 450,000 instructions. Nothing is kept.
 */
#ifndef GOLDFIELD_EDGE_FIT_H
#define GOLDFIELD_EDGE_FIT_H

#include <stdbool.h>
#include <stdint.h>

#define EDGE_FIT_SWEEPS 3u
#define EDGE_FIT_BINS   32u

/* Sums of (change seen) times (change of the whole edge), of (whole edge) squared, and that times where in the frame
 * (-0.5..0.5 chip) and at which chip it was seen. */
typedef struct {
    float product, weight, phase, chip;
} edge_bin_t;

typedef struct {
    edge_bin_t level[EDGE_FIT_SWEEPS][EDGE_FIT_BINS], step[EDGE_FIT_SWEEPS][EDGE_FIT_BINS];
} edge_profile_t;

typedef struct {
    float chip_ticks, burst_ticks, lag_ticks;
} edge_shape_t;

typedef struct {
    float onset_ticks;         /* From the middle of the frame, at chip 511 of the record. */
    float slip_ticks_per_chip; /* Of the onset: the beacons' chip minus the frame's. */
    float rise_ticks;
    float covariance[3][3]; /* Of these three, in this order. */
} edge_fit_t;

/* exp(-x), x >= 0, within 0.011; within 0.0015 below 1. About 15 instructions and a division. */
static inline float edge_decay(float x) {
    return 1.0f / (1.0f + x * (1.0f + x * (0.5f + x * (1.0f / 6.0f + x / 24.0f))));
}

/* False: the profile shows no edge (half the levels' variance is unexplained, or bins without weight abound); *fit
 * is then worthless. */
bool edge_fit(const edge_profile_t *profile, const edge_shape_t *shape, edge_fit_t *fit);

#endif
