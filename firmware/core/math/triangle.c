#include "core/math/triangle.h"

#include <stdint.h>

#include "core/math/roots.h"

#define N    TRIANGLE_UNKNOWNS
#define SEEN 1e-6f  /* Least share of a column's norm on the diagonal that is not rounding. */
#define LOST 1e-35f /* Square of three numbers that are as good as 0: below it squares lose their digits. */

void triangle_init(triangle_t *triangle) {
    *triangle = (triangle_t){0};
}

/* Column by column, (r[j][j], rows[0..2][j]) is reflected onto its first component. */
void triangle_add(triangle_t *triangle, triangle_rows_t rows) {
    for (uint32_t j = 0; j < N; j++) {
        float *const r = triangle->r[j];
        const float below = rows[0][j] * rows[0][j] + rows[1][j] * rows[1][j] + rows[2][j] * rows[2][j];
        if (!(below > LOST)) {
            continue;
        }
        const float norm = square_root(r[j] * r[j] + below);
        const float head = r[j] > 0.0f ? r[j] + norm : r[j] - norm; /* This sign does not cancel. */
        const float tau = 2.0f / (head * head + below);
        r[j] = r[j] > 0.0f ? -norm : norm;
        for (uint32_t k = j + 1u; k < TRIANGLE_COLUMNS; k++) {
            const float t = tau *
                            (head * r[k] + rows[0][j] * rows[0][k] + rows[1][j] * rows[1][k] + rows[2][j] * rows[2][k]);
            r[k] -= t * head;
            rows[0][k] -= t * rows[0][j];
            rows[1][k] -= t * rows[1][j];
            rows[2][k] -= t * rows[2][j];
        }
    }
}

static float column_norm2(const triangle_t *triangle, uint32_t column) {
    float sum = 0.0f;
    for (uint32_t row = 0; row <= column; row++) {
        sum += triangle->r[row][column] * triangle->r[row][column];
    }
    return sum;
}

void triangle_solve(const triangle_t *triangle, float damping, float step[TRIANGLE_UNKNOWNS]) {
    triangle_t damped = *triangle;
    for (uint32_t first = 0; first < N; first += 3u) {
        triangle_rows_t rows = {{0}};
        for (uint32_t i = 0; i < 3u; i++) {
            rows[i][first + i] = square_root(damping * column_norm2(triangle, first + i));
        }
        triangle_add(&damped, rows);
    }
    for (uint32_t j = N; j-- > 0u;) {
        const float diagonal = damped.r[j][j];
        float sum = damped.r[j][N];
        for (uint32_t k = j + 1u; k < N; k++) {
            sum -= damped.r[j][k] * step[k];
        }
        step[j] = diagonal > 0.0f || diagonal < 0.0f ? sum / diagonal : 0.0f;
    }
}

bool triangle_invert(const triangle_t *triangle, float l[TRIANGLE_UNKNOWNS][TRIANGLE_UNKNOWNS]) {
    for (uint32_t j = 0; j < N; j++) {
        const float diagonal = triangle->r[j][j];
        if (!(diagonal * diagonal > SEEN * SEEN * column_norm2(triangle, j))) {
            return false;
        }
        for (uint32_t i = 0; i < N; i++) {
            l[i][j] = i == j ? 1.0f / diagonal : 0.0f;
        }
        for (uint32_t i = j; i-- > 0u;) { /* Column j solves R l_j = e_j, from below upwards. */
            float sum = 0.0f;
            for (uint32_t k = i + 1u; k <= j; k++) {
                sum += triangle->r[i][k] * l[k][j];
            }
            l[i][j] = -sum / triangle->r[i][i];
        }
    }
    return true;
}
