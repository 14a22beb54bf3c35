/* triangle.h: linear least squares of six unknowns in square-root form. Rows are folded into a triangle as they come;
 * none is kept.
 *
 * Calls, in the order they are made: triangle_init, triangle_add for each three rows, then triangle_solve for the step
 * or triangle_invert for the covariance.
 *
 * Method. The triangle R and right side z satisfy R'R = A'A and R'z = A'y for the rows A, y folded so far (Householder
 * reflections of three rows at a time). The normal matrix is never formed: its condition is the square of A's, which
 * near a beacon is 1e4 and more, and single precision has 7 digits. Numbers of a column that are below 3e-18 are 0.
 *
 * Time (Cortex-M4, -O3): triangle_add 890 instructions, triangle_solve 1,700. Memory: 168 bytes.
 */
#ifndef GOLDFIELD_TRIANGLE_H
#define GOLDFIELD_TRIANGLE_H

#include <stdbool.h>

#define TRIANGLE_UNKNOWNS 6u
#define TRIANGLE_COLUMNS  7u /* Columns of a row: the unknowns, and the right side as the last. */

typedef float triangle_rows_t[3][TRIANGLE_COLUMNS];

typedef struct {
    float r[TRIANGLE_UNKNOWNS][TRIANGLE_COLUMNS]; /* R, an upper triangle, and z. */
} triangle_t;

/* Begin without rows. */
void triangle_init(triangle_t *triangle);

/* Fold in three rows, each already divided by its standard deviation. The call destroys rows. */
void triangle_add(triangle_t *triangle, triangle_rows_t rows);

/* Compute the step x that minimises |R x - z|^2 + damping |D x|^2, with D the norms of A's columns (Marquardt). An
 * unknown that no row tells of gets no step. */
void triangle_solve(const triangle_t *triangle, float damping, float step[TRIANGLE_UNKNOWNS]);

/* Compute L, the inverse of R, which is upper triangular: the covariance is L L'.
 * Returns false, with L not set, if the rows do not tell all unknowns. */
bool triangle_invert(const triangle_t *triangle, float l[TRIANGLE_UNKNOWNS][TRIANGLE_UNKNOWNS]);

#endif
