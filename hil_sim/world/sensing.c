#include "world/sensing.h"

#include <stdlib.h>
#include <string.h>

static size_t columns(const sensing_t *sensing) {
    return (size_t)3 * sensing->coils->count + 12;
}

bool sensing_init(sensing_t *sensing, const coils_t *coils, const ambient_t *ambient,
                  const front_end_config_t *front_end, uint64_t seed, unsigned board) {
    *sensing = (sensing_t){.coils = coils, .ambient = ambient, .field_time_ps = -1};
    front_end_init(&sensing->front_end, front_end, seed, board);
    sensing->values = calloc(columns(sensing), sizeof *sensing->values);
    return sensing->values != NULL;
}

void sensing_free(sensing_t *sensing) {
    free(sensing->coefficients);
    free(sensing->values);
}

bool sensing_set_path(sensing_t *sensing, const path_t *path) {
    if (path->columns != columns(sensing) || path->intervals == 0 || path->interval_ps <= 0) {
        return false;
    }
    const size_t size = path->intervals * path->columns * 4 * sizeof(double);
    double *const copy = malloc(size);
    if (copy == NULL) {
        return false;
    }
    memcpy(copy, path->coefficients, size);
    free(sensing->coefficients);
    sensing->coefficients = copy;
    sensing->path = *path;
    sensing->path.coefficients = copy;
    return true;
}

void sensing_field(const sensing_t *sensing, int64_t time_ps, double field_T[3]) {
    const coils_t *const coils = sensing->coils;
    double ambient_T[3];
    ambient_field(sensing->ambient, time_ps, ambient_T);
    path_evaluate(&sensing->path, time_ps, sensing->values);
    const double *const rotation = sensing->values + (size_t)3 * coils->count;
    for (unsigned axis = 0; axis < 3; ++axis) {
        field_T[axis] = rotation[3 * axis] * ambient_T[0] + rotation[3 * axis + 1] * ambient_T[1] +
                        rotation[3 * axis + 2] * ambient_T[2] + rotation[9 + axis];
    }
    for (unsigned i = 0; i < coils->count; ++i) {
        const bool own = i - sensing->own_first < sensing->own_count;
        const double lagged_A = coil_lagged(&coils->coil[i], own ? coils->coil[i].head : coils->head[i], time_ps);
        for (unsigned axis = 0; axis < 3; ++axis) {
            field_T[axis] += lagged_A * sensing->values[3 * i + axis];
        }
    }
}

double sensing_volts(sensing_t *sensing, unsigned axis, int64_t time_ps) {
    if (time_ps != sensing->field_time_ps) {
        sensing_field(sensing, time_ps, sensing->field_T);
        sensing->field_time_ps = time_ps;
    }
    return front_end_volts(&sensing->front_end, axis, sensing->field_T, time_ps);
}
