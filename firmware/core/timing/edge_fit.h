/* edge_fit.h: finds where in the chip the beacons' field begins to change, and how long that takes, from bursts whose
 * phase slid over the chip. The one call is edge_fit, with the profile that code_field.h makes of a record.
 *
 * Model. The field goes from one chip's value to the next's on a ramp that begins at the onset x and lasts the rise L
 * (a driver that slews its coil at constant voltage), seen through a first-order low-pass. The integral and the height
 * of an endless ramp behind the low-pass are, both 0 before t = 0,
 *   S(t) = t^2 / 2 - lag R(t),   R(t) = t - lag (1 - exp(-t / lag)).
 * A(t) = (S(t) - S(t - L)) / L is the integral of the share of the change that is done. A burst of width w centred t
 * after the onset has
 *   level                     (A(t + w/2) - A(t - w/2)) / w,
 *   step between its halves   (A(t + w/2) - 2 A(t) + A(t - w/2)) 2 / w.
 * The onset moves linearly with time, since the two clocks have different rates.
 *
 * Method. Least squares by Gauss and Newton in (x, slip, L) on levels and steps of 3 sweeps of 32 bins. Levels and
 * steps are each weighted by the variance that their own residuals show, anew in each iteration, and these give the
 * covariance of the result: nothing is assumed of the noise but that bins have it alike. So a sensor whose bursts have
 * their noise in common is timed by the steps, one with noise of single conversions by both.
 *
 * Time: at most 8 iterations of 96 bins, about 450,000 instructions. Memory: nothing is kept.
 */
#ifndef GOLDFIELD_EDGE_FIT_H
#define GOLDFIELD_EDGE_FIT_H

#include <stdbool.h>
#include <stdint.h>

#define EDGE_FIT_SWEEPS 3u  /* Sweeps of the burst over the chip in a record. */
#define EDGE_FIT_BINS   32u /* Bins of a sweep: each is 3 us of a chip wide. */

/* What a bin has gathered. */
typedef struct {
    float product; /* Sum of (change seen) times (change of the whole edge). */
    float weight;  /* Sum of (change of the whole edge) squared. */
    float phase;   /* That sum, each term times where in the frame it was seen, -0.5..0.5 chip. */
    float chip;    /* That sum, each term times the chip of the record at which it was seen. */
} edge_bin_t;

typedef struct {
    edge_bin_t level[EDGE_FIT_SWEEPS][EDGE_FIT_BINS], step[EDGE_FIT_SWEEPS][EDGE_FIT_BINS];
} edge_profile_t;

/* The times that shape what a bin shows: a chip, a burst, and the low-pass's time constant. */
typedef struct {
    float chip_ticks, burst_ticks, lag_ticks;
} edge_shape_t;

typedef struct {
    float onset_ticks;         /* x: the onset after the middle of the frame, at chip 511 of the record, ticks. */
    float slip_ticks_per_chip; /* How far the onset moves in a chip: the beacons' chip minus the frame's, ticks. */
    float rise_ticks;          /* L: how long the ramp lasts, ticks. */
    float covariance[3][3];    /* Covariance of these three, in this order. */
} edge_fit_t;

/* Returns exp(-x) for x >= 0, within 0.011; within 0.0015 for x below 1. Costs about 15 instructions and a division. */
static inline float edge_decay(float x) {
    return 1.0f / (1.0f + x * (1.0f + x * (0.5f + x * (1.0f / 6.0f + x / 24.0f))));
}

/* Fit the edge. Returns false, with a worthless *fit, if the profile shows no edge: half the levels' variance is
 * unexplained, or bins without weight abound. */
bool edge_fit(const edge_profile_t *profile, const edge_shape_t *shape, edge_fit_t *fit);

#endif
