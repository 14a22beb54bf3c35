/* normal3.h: normal equations of a weighted least-squares problem in three unknowns, summed row by row.
 *
 * Minimises sum of weight (error - slope . x)^2 over the rows. A matrix of known information (inverse covariance) may
 * stand in it from the start: prior knowledge. Elimination without pivoting, as a symmetric positive matrix allows; an
 * unknown that no row tells of gets x = 0 and a huge variance. Time: a few divisions. Memory: 48 bytes.
 */
#ifndef GOLDFIELD_NORMAL3_H
#define GOLDFIELD_NORMAL3_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    float matrix[3][3], side[3];
} normal3_t;

static inline void normal3_add(normal3_t *normal, const float slope[3], float error, float weight) {
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            normal->matrix[row][column] += weight * slope[row] * slope[column];
        }
        normal->side[row] += weight * slope[row] * error;
    }
}

/* inverse[3][3] of a symmetric positive matrix. */
void normal3_invert(const float matrix[3][3], float inverse[3][3]);

/* x that minimises. */
void normal3_solve(const normal3_t *normal, float x[3]);

#endif
