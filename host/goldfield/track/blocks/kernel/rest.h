/* rest.h: what a motion leaves of a block, and how far off several such blocks are, in double precision.
 *
 * The NumPy functions `left_by` and `cost_of` of `goldfield.track.blocks.rest` are the reference and serve where this
 * library is not built; tests/host/track/blocks/test_kernel_double.py holds them against these. n is the number of
 * beacons; matrices and sums have n + 1 rows, the last that of the ambient field.
 */
#ifndef GOLDFIELD_REST_H
#define GOLDFIELD_REST_H

#include <stdbool.h>
#include <stddef.h>

/* A motion in the middle of a block, and the fields of the beacons there, site's frame. */
typedef struct {
    size_t beacons;
    const double *field;    /* 3 x n */
    const double *gradient; /* 3 x 3 x n, by the coordinate in the second place */
    const double *rotation; /* 3 x 3, B_site = R B_sensor */
    const double *velocity;
    const double *rate;
    const double *ambient;
    const double *offset;
    const double *covariance; /* 18 x 18 */
} gf_moving_t;

/* A block: gram and moment, (n + 1) x (n + 1), and sums, (n + 1) x 3 in the sensor's frame. */
typedef struct {
    const double *gram;
    const double *moment;
    const double *sums;
} gf_block_sums_t;

/* Compute the fields as a `Reference` has them, (n + 1) x 3, how they change, (n + 1) x 3, their derivatives,
 * (n + 1) x 3 x 9, what is left of the sums in the sensor's frame, and what the track's error adds to the variance of
 * the beacons' sums, T^2, n numbers. memory: 2 (n + 1) doubles. */
void gf_rest(const gf_moving_t *moving, const gf_block_sums_t *block, double *memory, double *fields, double *slope,
             double *jacobian, double *left, double *blur);

/* Returns how many doubles of memory gf_cost() needs. */
size_t gf_cost_memory(size_t beacons);

/* Compute chi-square of the beacons' fields that several blocks leave, each with an ambient field of its own, and
 * about its mean. blur: n numbers over a sample's variance; weight: 3 x 3.
 * Returns false, and computes nothing, if the blocks do not tell all heard beacons apart: an eigenvalue of their Gram
 * matrix, its diagonal scaled to 1, is below `separable`. */
bool gf_cost(size_t blocks, size_t beacons, const double *gram, const double *sums, const double *blur,
             const double *weight, double separable, double *memory, double cost[2]);

#endif
