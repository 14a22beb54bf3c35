#include "wahba.h"

#include <math.h>
#include <string.h>

#include "linear.h"

#define NEWTON_STEPS 12

/* Sum of w B_site b', rows by the site's axes; returns the sum of w (|B|^2 + |b|^2). */
static double profile(size_t coils, const gf_sources_t *sources, const double *field_T, const double *weight,
                      double h[3][3]) {
    double energy = 0.0;
    memset(h, 0, 9 * sizeof h[0][0]);
    for (size_t i = 0; i < coils; ++i) {
        if (!(weight[i] > 0.0)) {
            continue;
        }
        const double *const b = field_T + 3 * i;
        double square = b[0] * b[0] + b[1] * b[1] + b[2] * b[2];
        for (size_t row = 0; row < 3; ++row) {
            const double modelled = sources->field_T[row][i];
            square += modelled * modelled;
            for (size_t column = 0; column < 3; ++column) {
                h[row][column] += weight[i] * modelled * b[column];
            }
        }
        energy += weight[i] * square;
    }
    return energy;
}

void gf_attitude(size_t coils, const gf_sources_t *sources, const double *field_T, const double *weight,
                 double rotation[3][3]) {
    double h[3][3];
    (void)profile(coils, sources, field_T, weight, h);
    const double trace = h[0][0] + h[1][1] + h[2][2];
    double k[4][6] = {
        {2.0 * h[0][0] - trace, h[0][1] + h[1][0], h[0][2] + h[2][0], h[2][1] - h[1][2]},
        {h[0][1] + h[1][0], 2.0 * h[1][1] - trace, h[1][2] + h[2][1], h[0][2] - h[2][0]},
        {h[0][2] + h[2][0], h[1][2] + h[2][1], 2.0 * h[2][2] - trace, h[1][0] - h[0][1]},
        {h[2][1] - h[1][2], h[0][2] - h[2][0], h[1][0] - h[0][1], trace},
    };
    double vectors[4][6];
    gf_eigen(4, k, vectors);
    size_t best = 0;
    for (size_t i = 1; i < 4; ++i) {
        best = k[i][i] > k[best][best] ? i : best;
    }
    const double x = vectors[0][best];
    const double y = vectors[1][best];
    const double z = vectors[2][best];
    const double w = vectors[3][best];
    const double turned[3][3] = {
        {1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)},
        {2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)},
        {2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)},
    };
    memcpy(rotation, turned, sizeof turned);
}

double gf_wahba_loss(size_t coils, const gf_sources_t *sources, const double *field_T, const double *weight) {
    double h[3][3];
    const double energy = profile(coils, sources, field_T, weight, h);
    const double scale = fmax(0.5 * energy, 1e-300);
    double trace = 0.0;
    double squares = 0.0;
    double s[3][3];
    for (size_t i = 0; i < 3; ++i) {
        for (size_t j = 0; j < 3; ++j) {
            s[i][j] = (h[i][j] + h[j][i]) / scale;
            squares += s[i][j] * s[i][j];
        }
        trace += h[i][i] / scale;
    }
    const double z[3] = {(h[1][2] - h[2][1]) / scale, (h[2][0] - h[0][2]) / scale, (h[0][1] - h[1][0]) / scale};
    const double determinant = s[0][0] * (s[1][1] * s[2][2] - s[1][2] * s[2][1]) -
                               s[0][1] * (s[1][0] * s[2][2] - s[1][2] * s[2][0]) +
                               s[0][2] * (s[1][0] * s[2][1] - s[1][1] * s[2][0]);
    double a = trace * trace - 0.5 * (4.0 * trace * trace - squares);
    double b = trace * trace;
    double c = determinant;
    double d = 0.0;
    for (size_t i = 0; i < 3; ++i) {
        const double sz = s[i][0] * z[0] + s[i][1] * z[1] + s[i][2] * z[2];
        b += z[i] * z[i];
        c += z[i] * sz;
        d += sz * sz;
    }
    double root = 1.0;
    for (int step = 0; step < NEWTON_STEPS; ++step) {
        const double value = ((root * root - a - b) * root - c) * root + a * b + c * trace - d;
        const double slope = (4.0 * root * root - 2.0 * (a + b)) * root - c;
        root -= fmax(value, 0.0) / fmax(slope, 1e-12);
    }
    return energy - 2.0 * scale * root;
}
