#include "world/path.h"

size_t path_interval(const path_t *path, int64_t time_ps, double *x) {
    int64_t interval = (time_ps - path->start_ps) / path->interval_ps;
    if (interval < 0) {
        interval = 0;
    }
    if (interval >= (int64_t)path->intervals) {
        interval = (int64_t)path->intervals - 1;
    }
    *x = (double)(time_ps - path->start_ps - interval * path->interval_ps) / (double)path->interval_ps;
    return (size_t)interval;
}

void path_columns(const double *coefficients, size_t columns, double x, double *values) {
    const double *c = coefficients;
    for (size_t column = 0; column < columns; ++column, c += 4) {
        values[column] = ((c[3] * x + c[2]) * x + c[1]) * x + c[0];
    }
}
