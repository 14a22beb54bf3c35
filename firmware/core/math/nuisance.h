/* nuisance.h: unknowns that nobody asks for, with a prior, eliminated from the rows of a least-squares problem as they
 * come. What is left of the rows goes into a triangle (core/math/triangle.h), whose solution is that of all unknowns
 * together; the sum of the squares of the right sides that are left is the cost with the best values of the nuisance.
 *
 * Calls: nuisance_init, nuisance_eliminate for each three rows; later nuisance_predict, which takes the final estimate
 * of the nuisance out of rows.
 *
 * Method. Six nuisance unknowns of unit variance; Householder reflections fold three rows at a time, as in triangle.h:
 * with S the effects of the nuisance and A the other rows, N'N = 1 + S'S and N'X = S'A.
 *
 * Time (Cortex-M4, -O3): nuisance_eliminate about 1,800 instructions, nuisance_predict 500. Memory: 312 bytes.
 */
#ifndef GOLDFIELD_NUISANCE_H
#define GOLDFIELD_NUISANCE_H

#include "core/math/triangle.h"

#define NUISANCE_UNKNOWNS 6u

typedef struct {
    float n[NUISANCE_UNKNOWNS][NUISANCE_UNKNOWNS]; /* N, an upper triangle. */
    float x[NUISANCE_UNKNOWNS][TRIANGLE_COLUMNS];  /* X. */
} nuisance_t;

/* Begin with the prior alone. */
void nuisance_init(nuisance_t *nuisance);

/* Eliminate the nuisance from three rows, which become what is left of them. effects is destroyed. */
void nuisance_eliminate(nuisance_t *nuisance, float effects[3][NUISANCE_UNKNOWNS], triangle_rows_t rows);

/* Take out of three rows what the nuisance explains of them once all rows are known: rows becomes A - S N^-1 X, and
 * effects S N^-1, the rows in units of the nuisance's own uncertainty. */
void nuisance_predict(const nuisance_t *nuisance, float effects[3][NUISANCE_UNKNOWNS], triangle_rows_t rows);

#endif
