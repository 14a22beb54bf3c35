/* Small symmetric matrices: equations and eigenvalues. Matrices have six columns, of which the first n are used. */
#ifndef GF_LOCATE_LINEAR_H
#define GF_LOCATE_LINEAR_H

#include <stdbool.h>
#include <stddef.h>

#define GF_MOST_UNKNOWNS 6 /* A pose's; n is at most this. */

/* Solve a x = b for a positive definite n x n matrix (Cholesky, without roots). Returns false if it is not positive
 * definite or not finite. */
bool gf_solve(size_t n, const double a[][6], const double b[], double x[]);

/* b' x of that equation alone, which takes less: how much the cost would fall by the step x. */
bool gf_promise(size_t n, const double a[][6], const double b[], double *out);

/* The same in two steps, for several right-hand sides: the factors L D L' of a, L with ones on its diagonal, which the
 * inverse of D takes, and x by substitution. */
bool gf_factor(size_t n, const double a[][6], double l[][6]);
void gf_substitute(size_t n, const double l[][6], const double b[], double x[]);

/* Eigenvalues and eigenvectors of a symmetric n x n matrix by Jacobi's rotations: afterwards the diagonal of a holds
 * the values, the columns of v the vectors. At most 20 sweeps; six are usual. */
void gf_eigen(size_t n, double a[][6], double v[][6]);

#endif
