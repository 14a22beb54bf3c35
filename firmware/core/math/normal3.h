/* normal3.h: the normal equations of a weighted least-squares problem in three unknowns, summed row by row. They
 * minimise the sum of weight (error - slope . x)^2 over the rows.
 *
 * Calls, in the order they are made: normal3_add for each row, then normal3_solve; normal3_invert turns the matrix
 * into the covariance. The caller begins with zeros, or with a matrix of known information (inverse covariance): prior
 * knowledge.
 *
 * Method. Elimination without pivoting, as a symmetric positive matrix allows. An unknown that no row tells of gets x
 * = 0 and a huge variance. Time: a few divisions. Memory: 48 bytes.
 */
#ifndef GOLDFIELD_NORMAL3_H
#define GOLDFIELD_NORMAL3_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    float matrix[3][3], side[3]; /* Sums of weight slope slope', and of weight slope error. */
} normal3_t;

/* Add a row: its slope by the three unknowns, its error where x is 0, and its weight, the inverse of its variance. */
static inline void normal3_add(normal3_t *normal, const float slope[3], float error, float weight) {
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            normal->matrix[row][column] += weight * slope[row] * slope[column];
        }
        normal->side[row] += weight * slope[row] * error;
    }
}

/* Invert a symmetric positive matrix. */
void normal3_invert(const float matrix[3][3], float inverse[3][3]);

/* Compute the x that minimises the sum. */
void normal3_solve(const normal3_t *normal, float x[3]);

#endif
