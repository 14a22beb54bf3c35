#include "dense.h"

#include <math.h>

bool gf_upper_root(size_t n, double *a) {
    for (size_t i = 0; i < n; i++) {
        double *const row = &a[i * n];
        if (!(row[i] > 0.0 && isfinite(row[i]))) {
            return false;
        }
        const double scale = 1.0 / sqrt(row[i]);
        for (size_t k = i; k < n; k++) {
            row[k] *= scale;
        }
        for (size_t j = i + 1; j < n; j++) {
            const double part = row[j];
            double *const rest = &a[j * n];
            for (size_t k = j; k < n; k++) {
                rest[k] -= part * row[k];
            }
        }
    }
    return true;
}

void gf_whiten(size_t n, const double *upper, size_t columns, double *b) {
    for (size_t i = 0; i < n; i++) {
        double *const row = &b[i * columns];
        for (size_t j = 0; j < i; j++) {
            const double part = upper[j * n + i];
            const double *const done = &b[j * columns];
            for (size_t k = 0; k < columns; k++) {
                row[k] -= part * done[k];
            }
        }
        const double scale = 1.0 / upper[i * n + i];
        for (size_t k = 0; k < columns; k++) {
            row[k] *= scale;
        }
    }
}

/* Reflect the rows from the step-th on so that its column becomes zero below the diagonal: the elements there are the
 * mirror's normal but for the first, `head`, and stay as they are. */
static void reflect(size_t n, size_t columns, size_t step, double *a, double head, double over) {
    double along[GF_MOST_COLUMNS];
    for (size_t k = step + 1; k < columns; k++) {
        along[k] = head * a[step * columns + k];
    }
    for (size_t i = step + 1; i < n; i++) {
        const double part = a[i * columns + step];
        for (size_t k = step + 1; k < columns; k++) {
            along[k] += part * a[i * columns + k];
        }
    }
    for (size_t k = step + 1; k < columns; k++) {
        along[k] *= over;
        a[step * columns + k] -= along[k] * head;
    }
    for (size_t i = step + 1; i < n; i++) {
        const double part = a[i * columns + step];
        for (size_t k = step + 1; k < columns; k++) {
            a[i * columns + k] -= along[k] * part;
        }
    }
}

void gf_triangular(size_t n, size_t columns, size_t steps, double *a) {
    for (size_t step = 0; step < steps && step < n; step++) {
        double below = 0.0;
        for (size_t i = step + 1; i < n; i++) {
            below += a[i * columns + step] * a[i * columns + step];
        }
        const double first = a[step * columns + step], length = sqrt(first * first + below);
        if (!(below > 0.0)) {
            continue;
        }
        const double head = first + copysign(length, first);
        reflect(n, columns, step, a, head, 2.0 / (head * head + below));
        a[step * columns + step] = -copysign(length, first);
    }
}
