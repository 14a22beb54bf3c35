#include "core/math/nuisance.h"

#include <stdint.h>

#include "core/math/roots.h"

#define S NUISANCE_UNKNOWNS

void nuisance_init(nuisance_t *nuisance) {
    *nuisance = (nuisance_t){0};
    for (uint32_t j = 0; j < S; j++) {
        nuisance->n[j][j] = 1.0f;
    }
}

/* Reflects one column of n or x and of the three rows. */
static inline void reflect(float *top, float *a, float *b, float *c, const float v[4], float tau) {
    const float t = tau * (v[0] * *top + v[1] * *a + v[2] * *b + v[3] * *c);
    *top -= t * v[0];
    *a -= t * v[1];
    *b -= t * v[2];
    *c -= t * v[3];
}

void nuisance_eliminate(nuisance_t *nuisance, float effects[3][S], triangle_rows_t rows) {
    for (uint32_t j = 0; j < S; j++) {
        float *const n = nuisance->n[j], *const x = nuisance->x[j];
        const float below = effects[0][j] * effects[0][j] + effects[1][j] * effects[1][j] +
                            effects[2][j] * effects[2][j];
        if (!(below > 0.0f)) {
            continue;
        }
        const float norm = square_root(n[j] * n[j] + below);
        const float v[4] = {n[j] > 0.0f ? n[j] + norm : n[j] - norm, effects[0][j], effects[1][j], effects[2][j]};
        const float tau = 2.0f / (v[0] * v[0] + below);
        n[j] = n[j] > 0.0f ? -norm : norm;
        for (uint32_t k = j + 1u; k < S; k++) {
            reflect(&n[k], &effects[0][k], &effects[1][k], &effects[2][k], v, tau);
        }
        for (uint32_t k = 0; k < TRIANGLE_COLUMNS; k++) {
            reflect(&x[k], &rows[0][k], &rows[1][k], &rows[2][k], v, tau);
        }
    }
}

void nuisance_predict(const nuisance_t *nuisance, float effects[3][S], triangle_rows_t rows) {
    for (uint32_t j = 0; j < S; j++) {
        const float over = 1.0f / nuisance->n[j][j]; /* The prior keeps it from 0. */
        for (uint32_t row = 0; row < 3u; row++) {
            float *const t = effects[row];
            t[j] *= over;
            for (uint32_t k = j + 1u; k < S; k++) {
                t[k] -= t[j] * nuisance->n[j][k];
            }
            for (uint32_t k = 0; k < TRIANGLE_COLUMNS; k++) {
                rows[row][k] -= t[j] * nuisance->x[j][k];
            }
        }
    }
}
