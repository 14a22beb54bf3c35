/* watch.h: what `goldfield.track.blocks.watch` computes of the blocks of each window, in double precision.
 *
 * The NumPy function `_found` of that module is its reference, and serves where this library is not built;
 * tests/host/track/blocks/test_kernel_double.py holds the two against each other.
 */
#ifndef GOLDFIELD_WATCH_H
#define GOLDFIELD_WATCH_H

#include <stddef.h>
#include <stdint.h>

#define GF_POSE      6u /* Numbers of a pose, */
#define GF_DISTORTED 6u /* and of a symmetric distortion. */
#define GF_TOLD      5u /* What is told of a window. */

/* What a track has left of blocks. n is the number of beacons; fields are in the site's frame, T. */
typedef struct {
    size_t beacons;
    size_t heard;           /* Those that the test takes, */
    const int64_t *rows;    /* and their numbers. */
    size_t measured;        /* Axes of the sensor that the test takes, */
    const int64_t *axes;    /* and their numbers. */
    const double *field;    /* (n + 1) x 3, the last row is not used. */
    const double *jacobian; /* (n + 1) x 3 x 9: by position, rotation, ambient field. */
    const double *rotation; /* 3 x 3, B_site = R B_sensor. */
    size_t errors;          /* Errors that the site declares, */
    const double *effects;  /* and what each, of one standard deviation, does: (n + 1) x 3 x errors. */
    const double *variance; /* A sample's, by components, measured x measured. */
} gf_watched_t;

/* Returns how many doubles of memory gf_watch() needs. */
size_t gf_watch_memory(size_t heard, size_t measured, size_t errors);

/* Test the sums of each window, (n^2 + n + 3 n) numbers: Gram matrix, what the track's error adds to its diagonal, and
 * the sums that are left, n x 3 in the sensor's frame.
 * told: of each window 1 if it tells its signals apart, else 0; chi-square of all that is left beside a pose, the part
 * that a distortion explains, the numbers of a distortion that show, and what they weigh. */
void gf_watch(const gf_watched_t *what, size_t windows, const double *sums, double shown, double *memory, double *told);

#endif
