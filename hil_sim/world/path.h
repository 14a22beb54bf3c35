/* path.h: what the sensor's motion does to the field: for every source the field per unit, in the sensor's frame, as a
 * function of time.
 *
 * A column is one component of that; Python computes the columns on equidistant knots with magpylib and hands over the
 * cubic of each interval (world/path.py says how fine). Columns: 3 c + a for axis a (sensor frame) of coil c, tesla per
 * ampere; then 3 coils + 3 a + s, the rotation from site axis s to sensor axis a; last 3 coils + 9 + a, the field of
 * magnets, tesla. In interval k with x = (t -
 * start)/interval - k:  value = ((c3 x + c2) x + c1) x + c0. Before the first and after the last interval its cubic
 * goes on (a converter may look a few microseconds ahead); a still sensor is one interval with c1 = c2 = c3 = 0.
 */
#ifndef GOLDFIELD_WORLD_PATH_H
#define GOLDFIELD_WORLD_PATH_H

#include <stddef.h>
#include <stdint.h>

typedef struct {
    int64_t start_ps;
    int64_t interval_ps; /* Length of an interval, above 0. */
    size_t intervals, columns;
    const double *coefficients; /* [interval][column][4]: c0..c3; the caller's. */
} path_t;

/* Returns the interval that a time is in, or the one that goes on there; *x is where in it. */
size_t path_interval(const path_t *path, int64_t time_ps, double *x);

/* Compute the values of some columns of one interval: 3 multiplications a column. */
void path_columns(const double *coefficients, size_t columns, double x, double *values);

#endif
