#include "world/path.h"

void path_evaluate(const path_t *path, int64_t time_ps, double *values) {
    int64_t interval = (time_ps - path->start_ps) / path->interval_ps;
    if (interval < 0) {
        interval = 0;
    }
    if (interval >= (int64_t)path->intervals) {
        interval = (int64_t)path->intervals - 1;
    }
    const double x = (double)(time_ps - path->start_ps - interval * path->interval_ps) / (double)path->interval_ps;
    const double *c = path->coefficients + (size_t)interval * path->columns * 4u;
    for (size_t column = 0; column < path->columns; ++column, c += 4) {
        values[column] = ((c[3] * x + c[2]) * x + c[1]) * x + c[0];
    }
}
