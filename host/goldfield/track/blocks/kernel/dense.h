/* dense.h: matrices of any size, row by row without gaps, in the caller's memory: what watch.c and rest.c solve with.
 *
 * Loops run along rows, which the compiler takes several numbers of at a time.
 */
#ifndef GOLDFIELD_DENSE_H
#define GOLDFIELD_DENSE_H

#include <stdbool.h>
#include <stddef.h>

/* Replace the upper half of a symmetric n x n matrix by U with A = U' U; the lower half is neither read nor written.
 * Returns false if it is not positive definite, or not finite. */
bool gf_upper_root(size_t n, double *a);

/* Replace B, n x columns, by U'^-1 B. */
void gf_whiten(size_t n, const double *upper, size_t columns, double *b);

#define GF_MOST_COLUMNS 16u

/* Turn the rows of an n x columns matrix so that the first `steps` columns become upper triangular (Householder); the
 * elements below the diagonal are not written. A column of zeros takes its row all the same, as LAPACK's does.
 * At most GF_MOST_COLUMNS columns. */
void gf_triangular(size_t n, size_t columns, size_t steps, double *a);

#endif
