#include "level_set.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "coils.h"

#define PI 3.14159265358979323846

/* Halvings of the logarithm of a distance whose ends are a ratio of 1e9 apart: 1e9^(2^-14) = 1.0013. */
#define HALVINGS      14
#define LEAST_PORTION 1e-9

static double magnitude_at(const gf_coils_t *coil, double rho, double z) {
    const double point[3] = {rho, 0.0, z};
    gf_sources_t sources;
    gf_sources(coil, point, &sources);
    return hypot(sources.field_T[0][0], sources.field_T[2][0]);
}

/* Distance along a ray from (rho, 0) at which the magnitude falls below the level; at most furthest. */
static double cross(const gf_coils_t *coil, double rho, double angle, double level, double furthest) {
    const double along = cos(angle);
    const double up = sin(angle);
    double near = LEAST_PORTION * furthest;
    double far = furthest;
    for (int halving = 0; halving < HALVINGS; ++halving) {
        const double middle = sqrt(near * far);
        /* On the wire itself the field is not finite: that counts as above the level. */
        if (magnitude_at(coil, rho + middle * along, middle * up) < level) {
            far = middle;
        } else {
            near = middle;
        }
    }
    return sqrt(near * far);
}

void gf_level_set(double moment_A_m2, double radius_m, double magnitude_T, gf_level_set_t *out) {
    gf_coils_t coil;
    memset(&coil, 0, sizeof coil);
    coil.count = 1;
    coil.axis[2][0] = 1.0;
    coil.moment_A_m2[0] = moment_A_m2;
    coil.radius_m[0] = radius_m;
    /* Beyond this the field is below the level in every direction: |B| <= 2 k/r^3 far away. */
    const double furthest = 2.0 * radius_m + 2.0 * cbrt(2.0 * GF_MU0_OVER_4PI * moment_A_m2 / magnitude_T);
    double last = 0.5 * PI;
    out->around = false;
    if (radius_m > 0.0) {
        out->around = magnitude_at(&coil, 0.0, 0.0) < magnitude_T;
        last = out->around ? PI : atan2(cross(&coil, 0.0, 0.5 * PI, magnitude_T, furthest), -radius_m);
    }
    const double step = last / GF_RAYS;
    for (size_t ray = 0; ray < GF_RAYS; ++ray) {
        const double angle = ((double)ray + 0.5) * step;
        const double inward = -cos(angle);
        const double axis = inward > 0.0 ? radius_m / inward : furthest; /* no further than the coil's axis */
        const double distance = cross(&coil, radius_m, angle, magnitude_T, fmin(axis, furthest));
        out->rho_m[ray] = radius_m - distance * inward;
        out->z_m[ray] = distance * sin(angle);
    }
    for (size_t ray = 0; ray < GF_RAYS; ++ray) {
        const size_t a = ray > 0 ? ray - 1 : 0;
        const size_t b = ray + 1 < GF_RAYS ? ray + 1 : ray;
        out->spacing_m[ray] = hypot(out->rho_m[a] - out->rho_m[b], out->z_m[a] - out->z_m[b]) / (double)(b - a);
    }
}
