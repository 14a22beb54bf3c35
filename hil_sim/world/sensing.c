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
    sensing->view = calloc(coils->count + 1u, sizeof *sensing->view);
    sensing->view_made = calloc(coils->count + 1u, sizeof *sensing->view_made);
    sensing->limit_A = calloc(coils->count + 1u, sizeof *sensing->limit_A);
    sensing->other = calloc(coils->count + 1u, sizeof *sensing->other);
    return sensing->view != NULL && sensing->view_made != NULL && sensing->limit_A != NULL && sensing->other != NULL;
}

void sensing_free(sensing_t *sensing) {
    free(sensing->coefficients);
    free(sensing->view);
    free(sensing->view_made);
    free(sensing->limit_A);
    free(sensing->other);
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
    sensing->look_ps = INT64_MIN; /* The sums are of the path before. */
    return true;
}

static bool is_own(const sensing_t *sensing, unsigned coil) {
    return coil - sensing->own_first < sensing->own_count;
}

/* Sees to it that the view of a coil holds from a time on, if its current has that form. Own coils have none: they may
 * change amid a burst. */
static void view_coil(sensing_t *sensing, unsigned i, bool anew, int64_t time_ps) {
    const coils_t *const coils = sensing->coils;
    coil_view_t *const view = &sensing->view[i];
    const uint64_t made = coils->head[i].made;
    const bool open_end = view->until_ps == INT64_MAX;
    if (!anew && view->rest_A == 0.0 && time_ps < view->until_ps && (!open_end || sensing->view_made[i] == made)) {
        return;
    }
    *view = coil_view(&coils->coil[i], coils->head[i].number, view->number, time_ps);
    const bool other_lag = view->rest_A != 0.0 && coils->coil[i].config.lag_s != sensing->sum_lag_s;
    view->until_ps = is_own(sensing, i) || other_lag ? INT64_MIN : view->until_ps;
    sensing->view_made[i] = made;
}

/* Adds a coil's cubic times a current to a sum. */
static void add_cubic(sensing_four_t sum[CUBIC], const sensing_four_t cubic[CUBIC], double current_A) {
    for (unsigned power = 0; power < CUBIC; ++power) {
        sum[power] += current_A * cubic[power];
    }
}

/* Adds a cubic's value at x, times a weight. */
static void add_value(sensing_four_t *sum, double weight, const sensing_four_t cubic[CUBIC], double x) {
    *sum += weight * (((cubic[3] * x + cubic[2]) * x + cubic[1]) * x + cubic[0]);
}

/* Sums the cubics c of the coils in the burst that begins. */
static void sum_coils(sensing_t *sensing, const sensing_four_t *c, int64_t time_ps) {
    const coils_t *const coils = sensing->coils;
    const bool anew = time_ps < sensing->sum_ps;
    sensing->sum_ps = time_ps;
    sensing->sum_until_ps = INT64_MAX;
    sensing->sum_shown = coils->shown;
    sensing->sum_lag_s = coils->count > 0 ? coils->coil[0].config.lag_s : 0.0;
    sensing->others = 0;
    memset(sensing->rest_sum, 0, sizeof sensing->rest_sum);
    for (unsigned i = 0; i < coils->count; ++i) {
        view_coil(sensing, i, anew, time_ps);
        const coil_view_t *const view = &sensing->view[i];
        sensing->limit_A[i] = view->limit_A;
        if (view->until_ps <= time_ps) {
            sensing->other[sensing->others++] = i;
            sensing->limit_A[i] = 0.0;
            continue;
        }
        sensing->sum_until_ps = view->until_ps < sensing->sum_until_ps ? view->until_ps : sensing->sum_until_ps;
        if (view->rest_A != 0.0) {
            add_cubic(sensing->rest_sum, c + (size_t)CUBIC * i, view->rest_A);
        }
    }
    sensing_four_t sum[CUBIC] = {{0.0}};
    for (unsigned i = 0; i < coils->count; ++i) {
        add_cubic(sum, c + (size_t)CUBIC * i, sensing->limit_A[i]);
    }
    memcpy(sensing->limit_sum, sum, sizeof sum);
}

/* Adds the field of all coils at a place x of an interval with the coils' cubics c. */
static void add_coils(sensing_t *sensing, sensing_four_t *field_T, size_t interval, const sensing_four_t *c, double x,
                      int64_t time_ps) {
    const coils_t *const coils = sensing->coils;
    if (sensing->look_ps == INT64_MIN || time_ps >= sensing->look_ps + FRONT_END_BURST_PS ||
        sensing->sum_shown != coils->shown || interval != sensing->sum_interval || time_ps < sensing->sum_ps ||
        time_ps >= sensing->sum_until_ps) {
        sum_coils(sensing, c, time_ps);
        sensing->sum_interval = interval;
    }
    sensing->look_ps = time_ps;
    const double age_s = (double)(time_ps - sensing->sum_ps) * 1e-12;
    const double decay = age_s > 0.0 && sensing->sum_lag_s > 0.0 ? exp(-age_s / sensing->sum_lag_s) : 1.0;
    add_value(field_T, 1.0, sensing->limit_sum, x);
    add_value(field_T, decay, sensing->rest_sum, x);
    for (unsigned k = 0; k < sensing->others; ++k) {
        const unsigned i = sensing->other[k];
        coil_t *const coil = &coils->coil[i];
        const uint64_t head = is_own(sensing, i) ? coil_head(coil) : coils->head[i].number;
        add_value(field_T, coil_lagged(coil, head, time_ps), c + (size_t)CUBIC * i, x);
    }
}

void sensing_field(sensing_t *sensing, int64_t time_ps, double field_T[3]) {
    const unsigned coils = sensing->coils->count;
    double ambient_T[AXES], x, rest[REST];
    ambient_field(sensing->ambient, time_ps, ambient_T);
    const size_t interval = path_interval(&sensing->path, time_ps, &x);
    const sensing_four_t *const c = sensing->coefficients + interval * vectors(sensing);
    path_columns((const double *)(c + CUBIC * coils), REST, x, rest);
    sensing_four_t sum_T = {0.0, 0.0, 0.0, 0.0};
    add_coils(sensing, &sum_T, interval, c, x, time_ps);
    for (unsigned axis = 0; axis < AXES; ++axis) {
        field_T[axis] = sum_T[axis] + rest[3 * axis] * ambient_T[0] + rest[3 * axis + 1] * ambient_T[1] +
                        rest[3 * axis + 2] * ambient_T[2] + rest[9 + axis];
    }
}

double sensing_volts(sensing_t *sensing, unsigned axis, int64_t time_ps) {
    if (time_ps != sensing->field_time_ps) {
        sensing_field(sensing, time_ps, sensing->field_T);
        sensing->field_time_ps = time_ps;
    }
    return front_end_volts(&sensing->front_end, axis, sensing->field_T, time_ps);
}
