#include "world/sensing.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { AXES = 3, REST = 12, CUBIC = 4 }; /* Columns of the path beside the coils'; vectors of a cubic. */

static size_t columns(const sensing_t *sensing) {
    return (size_t)AXES * sensing->coils->count + REST;
}

/* Returns the vectors of an interval: a cubic of vectors a coil, and the cubics of the rest as they come. */
static size_t vectors(const sensing_t *sensing) {
    return (size_t)CUBIC * sensing->coils->count + REST;
}

bool sensing_init(sensing_t *sensing, const coils_t *coils, const ambient_t *ambient,
                  const front_end_config_t *front_end, uint64_t seed, unsigned board) {
    *sensing = (sensing_t){.coils = coils, .ambient = ambient, .field_time_ps = -1, .look_ps = INT64_MIN};
    front_end_init(&sensing->front_end, front_end, seed, board);
    sensing->lagged_A = calloc(coils->count + 1u, sizeof *sensing->lagged_A);
    sensing->view = calloc(coils->count + 1u, sizeof *sensing->view);
    return sensing->lagged_A != NULL && sensing->view != NULL;
}

void sensing_free(sensing_t *sensing) {
    free(sensing->coefficients);
    free(sensing->lagged_A);
    free(sensing->view);
}

/* Turns the cubics of the coils' columns into cubics of vectors. */
static void lay_out(const sensing_t *sensing, const path_t *path, sensing_four_t *to) {
    const size_t coils = sensing->coils->count;
    for (size_t interval = 0; interval < path->intervals; ++interval, to += vectors(sensing)) {
        const double *const from = path->coefficients + interval * path->columns * CUBIC;
        for (size_t coil = 0; coil < coils; ++coil) {
            for (size_t power = 0; power < CUBIC; ++power) {
                const double *const first = from + coil * AXES * CUBIC + power;
                to[CUBIC * coil + power] = (sensing_four_t){first[0], first[CUBIC], first[2 * CUBIC], 0.0};
            }
        }
        memcpy(to + CUBIC * coils, from + coils * AXES * CUBIC, REST * CUBIC * sizeof *from);
    }
}

bool sensing_set_path(sensing_t *sensing, const path_t *path) {
    if (path->columns != columns(sensing) || path->intervals == 0 || path->interval_ps <= 0) {
        return false;
    }
    sensing_four_t *const copy = aligned_alloc(sizeof *copy, path->intervals * vectors(sensing) * sizeof *copy);
    if (copy == NULL) {
        return false;
    }
    lay_out(sensing, path, copy);
    free(sensing->coefficients);
    sensing->coefficients = copy;
    sensing->path = *path;
    sensing->path.coefficients = NULL;
    return true;
}

/* Looks up what the coils do in the burst that begins. */
static void view_coils(sensing_t *sensing, int64_t time_ps) {
    const coils_t *const coils = sensing->coils;
    sensing->view_ps = time_ps;
    sensing->view_shown = coils->shown;
    sensing->view_lag_s = coils->count > 0 ? coils->coil[0].config.lag_s : 0.0;
    for (unsigned i = 0; i < coils->count; ++i) {
        coil_view_t *const view = &sensing->view[i];
        *view = coil_view(&coils->coil[i], coils->head[i], view->number, time_ps);
        const bool own = i - sensing->own_first < sensing->own_count;
        const bool other_lag = view->rest_A != 0.0 && coils->coil[i].config.lag_s != sensing->view_lag_s;
        view->until_ps = own || other_lag ? INT64_MIN : view->until_ps;
    }
}

static void look_at_coils(sensing_t *sensing, int64_t time_ps) {
    const coils_t *const coils = sensing->coils;
    if (sensing->view_shown != coils->shown || time_ps < sensing->view_ps ||
        time_ps >= sensing->look_ps + FRONT_END_BURST_PS) {
        view_coils(sensing, time_ps);
    }
    sensing->look_ps = time_ps;
    const double age_s = (double)(time_ps - sensing->view_ps) * 1e-12;
    const double decay = age_s > 0.0 && sensing->view_lag_s > 0.0 ? exp(-age_s / sensing->view_lag_s) : 1.0;
    for (unsigned i = 0; i < coils->count; ++i) {
        const coil_view_t *const view = &sensing->view[i];
        sensing->lagged_A[i] = view->limit_A + view->rest_A * decay;
        if (view->until_ps <= time_ps) {
            const bool own = i - sensing->own_first < sensing->own_count;
            coil_t *const coil = &coils->coil[i];
            sensing->lagged_A[i] = coil_lagged(coil, own ? coil_head(coil) : coils->head[i], time_ps);
        }
    }
}

void sensing_field(sensing_t *sensing, int64_t time_ps, double field_T[3]) {
    const unsigned coils = sensing->coils->count;
    double ambient_T[AXES], x, rest[REST];
    ambient_field(sensing->ambient, time_ps, ambient_T);
    const size_t interval = path_interval(&sensing->path, time_ps, &x);
    const sensing_four_t *c = sensing->coefficients + interval * vectors(sensing);
    path_columns((const double *)(c + CUBIC * coils), REST, x, rest);
    sensing_four_t sum_T = {0.0, 0.0, 0.0, 0.0};
    for (unsigned axis = 0; axis < AXES; ++axis) {
        sum_T[axis] = rest[3 * axis] * ambient_T[0] + rest[3 * axis + 1] * ambient_T[1] +
                      rest[3 * axis + 2] * ambient_T[2] + rest[9 + axis];
    }
    look_at_coils(sensing, time_ps);
    for (unsigned i = 0; i < coils; ++i, c += CUBIC) {
        sum_T += sensing->lagged_A[i] * (((c[3] * x + c[2]) * x + c[1]) * x + c[0]);
    }
    for (unsigned axis = 0; axis < AXES; ++axis) {
        field_T[axis] = sum_T[axis];
    }
}

double sensing_volts(sensing_t *sensing, unsigned axis, int64_t time_ps) {
    if (time_ps != sensing->field_time_ps) {
        sensing_field(sensing, time_ps, sensing->field_T);
        sensing->field_time_ps = time_ps;
    }
    return front_end_volts(&sensing->front_end, axis, sensing->field_T, time_ps);
}
