#include "even.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#define ERRORS 18u
#define TURN   3u  /* Where the attitude's errors begin, */
#define OFFSET 15u /* and those of the sensor's offset. */

static double dot(const double a[3], const double b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Write M v; the rows of M are so many numbers apart. */
static void times(const double *matrix, size_t apart, const double v[3], double result[3]) {
    for (size_t a = 0; a < 3u; a++) {
        result[a] = dot(&matrix[apart * a], v);
    }
}

/* Add M C M' with the covariance of three of the errors. */
static void add_spread(const double matrix[9], const double *covariance, double result[9]) {
    double half[9];
    for (size_t a = 0; a < 3u; a++) {
        for (size_t b = 0; b < 3u; b++) {
            half[3u * a + b] = 0.0;
            for (size_t k = 0; k < 3u; k++) {
                half[3u * a + b] += matrix[3u * a + k] * covariance[ERRORS * k + b];
            }
        }
    }
    for (size_t a = 0; a < 3u; a++) {
        for (size_t b = 0; b < 3u; b++) {
            result[3u * a + b] += dot(&half[3u * a], &matrix[3u * b]);
        }
    }
}

/* Widen what is told by the change and its error along a way of some length. */
static void look(const gf_even_limits_t *limits, const double way[3], double length, const double change[3],
                 const double variance[9], double *certain, double *beyond) {
    if (!(length > 0.0)) {
        return;
    }
    double through[3];
    times(variance, 3u, way, through);
    const double size = fabs(dot(way, change)) / length;
    const double error = sqrt(fmax(dot(way, through) / (length * length), 0.0));
    *certain = fmax(*certain, size - limits->certain * error);
    *beyond = fmax(*beyond, size * size - limits->likely * limits->likely * error * error);
}

void gf_even(const gf_even_limits_t *limits, const gf_attitude_t *known, const double seen_T[3], double seconds,
             double usual[GF_USUAL], double told[2]) {
    double now[GF_USUAL] = {0.0}, moved[9], field[3], change[3], variance[9];
    double *const seen = now, *const attitude = &now[3], *const doubt = &now[12];
    memcpy(attitude, known->rotation, sizeof(moved));
    times(attitude, 3u, seen_T, seen);
    times(attitude, 3u, known->offset, field);
    for (size_t a = 0; a < 3u; a++) {
        field[a] = seen[a] - field[a];
    }
    const double cross[9] = {0.0, -field[2], field[1], field[2], 0.0, -field[0], -field[1], field[0], 0.0};
    add_spread(cross, &known->covariance[(size_t)TURN * (ERRORS + 1u)], doubt);
    if (isnan(usual[0])) {
        memcpy(usual, now, sizeof(now));
    }
    for (size_t i = 0; i < 9u; i++) {
        moved[i] = attitude[i] - usual[3u + i];
        variance[i] = doubt[i] + usual[12u + i];
    }
    times(moved, 3u, known->offset, change); /* by the offset as it is now known */
    for (size_t a = 0; a < 3u; a++) {
        change[a] = seen[a] - usual[a] - change[a];
    }
    add_spread(moved, &known->covariance[(size_t)OFFSET * (ERRORS + 1u)], variance);
    const double whole = sqrt(dot(field, field)), size = sqrt(dot(change, change));
    if (!(whole > 0.0) && !(size > 0.0)) {
        return;
    }
    double certain = -INFINITY, beyond = -INFINITY;
    look(limits, field, whole, change, variance, &certain, &beyond);
    look(limits, change, size, change, variance, &certain, &beyond);
    told[0] = fmax(certain - limits->even_T, 0.0);
    told[1] = sqrt(fmax(beyond - limits->even_T * limits->even_T, 0.0)) / fmax(whole, size);
    const double own = doubt[0] + doubt[4] + doubt[8], before = usual[12] + usual[16] + usual[20];
    if (!(told[0] > 0.0) && limits->better * own < before) {
        memcpy(usual, now, sizeof(now));
        return;
    }
    const double speed = fmin(sqrt(dot(known->velocity, known->velocity)), limits->fastest_m_s);
    const double step = (limits->settling_T_s + limits->gradient_T_m * speed) * seconds;
    const double part = size > 0.0 ? fmin(step / size, 1.0) : 1.0;
    for (size_t a = 0; a < 3u; a++) {
        usual[a] += part * (seen[a] - usual[a]);
    }
    for (size_t i = 0; i < 9u; i++) {
        usual[3u + i] += part * moved[i];
    }
}
