#include "coils.h"

#include <math.h>
#include <string.h>

#include "metal.h"

/* Enough steps of the arithmetic-geometric mean for points 1e-8 radii from a wire. */
#define MEAN_STEPS 9

/* Relative difference of the two means that one more step turns into rounding. */
#define NEARLY_EQUAL 1e-4

/* A function that is compiled a second time, for processors that work on four numbers at once; which of the two runs is
 * chosen as the library is loaded. Neither fuses or reorders operations, so that both compute the same to the last bit.
 * What such a function calls has to be compiled into it, or it would gain nothing. */
#if defined(__x86_64__) && defined(__GLIBC__) && !defined(__clang__)
#define WIDE         __attribute__((target_clones("avx2", "default")))
#define PART_OF_WIDE inline __attribute__((always_inline))
#else
#define WIDE
#define PART_OF_WIDE inline
#endif

/* Where a point is beside each coil, and what Gauss's mean starts from. */
typedef struct {
    double radial[3][GF_MOST_COILS]; /* From the coil's axis to the point. */
    double height[GF_MOST_COILS];    /* Along the axis. */
    double rho2[GF_MOST_COILS];
    double squares[GF_MOST_COILS];  /* Mean of the squares of greatest and least distance to the wire, */
    double product2[GF_MOST_COILS]; /* and product of those squares. */
    double mean_a[GF_MOST_COILS];   /* The two means, which meet. */
    double mean_b[GF_MOST_COILS];
    double quarter_w[GF_MOST_COILS];
    double c2[GF_MOST_COILS];
    double tau[GF_MOST_COILS]; /* Sum of 2^k c_k^2, from which the integral of the second kind follows. */
} gf_cylinders_t;

static PART_OF_WIDE void enter_cylinders(const gf_coils_t *coils, const double position_m[3], gf_cylinders_t *at) {
    const size_t n = coils->count;
    for (size_t i = 0; i < n; ++i) {
        const double x = position_m[0] - coils->centre_m[0][i];
        const double y = position_m[1] - coils->centre_m[1][i];
        const double z = position_m[2] - coils->centre_m[2][i];
        const double h = coils->axis[0][i] * x + coils->axis[1][i] * y + coils->axis[2][i] * z;
        const double rx = x - h * coils->axis[0][i];
        const double ry = y - h * coils->axis[1][i];
        const double rz = z - h * coils->axis[2][i];
        const double square = rx * rx + ry * ry + rz * rz;
        const double rho = sqrt(square);
        const double outer = rho + coils->radius_m[i];
        const double inner = rho - coils->radius_m[i];
        const double greatest2 = outer * outer + h * h;
        const double least2 = inner * inner + h * h;
        const double greatest = sqrt(greatest2);
        const double least = sqrt(least2);
        const double total = greatest + least;
        at->radial[0][i] = rx;
        at->radial[1][i] = ry;
        at->radial[2][i] = rz;
        at->height[i] = h;
        at->rho2[i] = square;
        at->squares[i] = 0.5 * (greatest2 + least2);
        at->product2[i] = greatest2 * least2;
        at->mean_a[i] = 0.5 * total;
        at->mean_b[i] = sqrt(greatest * least);
        at->quarter_w[i] = 0.125 * total * (greatest - least);
        at->c2[i] = 1.0 / (total * total);
        at->tau[i] = at->c2[i];
    }
}

/* Gauss's arithmetic-geometric mean of all coils at once: as many steps as the worst needs. */
static PART_OF_WIDE void converge_means(size_t n, gf_cylinders_t *at) {
    double difference = 0.0;
    for (size_t i = 0; i < n; ++i) {
        const double ratio = 1.0 - at->mean_b[i] / at->mean_a[i];
        difference = ratio > difference ? ratio : difference;
    }
    double power = 1.0;
    for (int step = 0; step < MEAN_STEPS; ++step) {
        power *= 2.0;
        for (size_t i = 0; i < n; ++i) {
            const double a = 0.5 * (at->mean_a[i] + at->mean_b[i]);
            const double c = at->quarter_w[i] * at->c2[i] / a;
            at->mean_b[i] = sqrt(at->mean_a[i] * at->mean_b[i]);
            at->mean_a[i] = a;
            at->c2[i] = c * c;
            at->tau[i] += power * at->c2[i];
        }
        if (difference <= NEARLY_EQUAL) {
            break;
        }
        difference = 1.0 - 2.0 * sqrt(1.0 - difference) / (2.0 - difference);
    }
}

/* In cylinder coordinates about a coil's axis a, with r the radial vector, the field is f a + g r. As curl and
 * divergence vanish, its gradient needs g, d = dg/dz and s = (dg/drho)/rho alone:
 *     d (a r' + r a') + s r r' + g I - (3 g + s rho^2) a a'.
 * f and g are means over a turn, and those follow from Gauss's mean of the greatest and the least distance to the
 * wire: goldfield/field/loop.py has the integrals; there the gradient is formed from all four derivatives. */
WIDE void gf_sources(const gf_coils_t *coils, const double position_m[3], gf_sources_t *out) {
    const size_t n = coils->count;
    gf_cylinders_t cylinders;
    gf_cylinders_t *const at = &cylinders;
    enter_cylinders(coils, position_m, at);
    converge_means(n, at);
    for (size_t i = 0; i < n; ++i) {
        const double u = at->squares[i];
        const double w2 = 4.0 * coils->radius_m[i] * coils->radius_m[i] * at->rho2[i];
        const double over = 1.0 / (0.5 * (at->mean_a[i] + at->mean_b[i]) * at->product2[i]);
        const double i10 = (u - at->tau[i] * w2) * over;
        const double j11 = (1.0 - at->tau[i] * u) * over;
        const double i20 = (u * i10 + (w2 / 3.0) * j11) / at->product2[i];
        const double q21 = (j11 / 3.0 + i20) / u;
        const double strength = 2.0 * GF_MU0_OVER_4PI * coils->moment_A_m2[i];
        const double h = at->height[i];
        const double f = strength * (i10 - 2.0 * at->rho2[i] * j11);
        const double g = strength * 2.0 * h * j11;
        const double d = strength * 2.0 * (j11 - 3.0 * q21 * h * h);
        /* Finite on the axis, where it multiplies two radial vectors: the tiny number only avoids 0/0. */
        const double s = strength * 2.0 * h * ((1.5 * i20 - 2.0 * j11) / (at->rho2[i] + 1e-300) - 3.0 * q21);
        const double t = 3.0 * g + s * at->rho2[i];
        const double ax = coils->axis[0][i];
        const double ay = coils->axis[1][i];
        const double az = coils->axis[2][i];
        const double rx = at->radial[0][i];
        const double ry = at->radial[1][i];
        const double rz = at->radial[2][i];
        out->field_T[0][i] = f * ax + g * rx;
        out->field_T[1][i] = f * ay + g * ry;
        out->field_T[2][i] = f * az + g * rz;
        out->gradient_T_m[0][i] = 2.0 * d * ax * rx + s * rx * rx - t * ax * ax + g;
        out->gradient_T_m[1][i] = 2.0 * d * ay * ry + s * ry * ry - t * ay * ay + g;
        out->gradient_T_m[2][i] = 2.0 * d * az * rz + s * rz * rz - t * az * az + g;
        out->gradient_T_m[3][i] = d * (ax * ry + rx * ay) + s * rx * ry - t * ax * ay;
        out->gradient_T_m[4][i] = d * (ax * rz + rx * az) + s * rx * rz - t * ax * az;
        out->gradient_T_m[5][i] = d * (ay * rz + ry * az) + s * ry * rz - t * ay * az;
    }
    if (coils->metal) {
        gf_add_metal(coils->metal, n, position_m, out->field_T, out->gradient_T_m);
    }
}

void gf_evaluate(const gf_coils_t *coils, size_t points, const double *position_m, double *field_T,
                 double *gradient_T_m) {
    static const size_t row_of[3][3] = {{0, 3, 4}, {3, 1, 5}, {4, 5, 2}}; /* of the symmetric gradient */
    const size_t bytes = coils->count * sizeof field_T[0];
    for (size_t p = 0; p < points; ++p) {
        gf_sources_t sources;
        gf_sources(coils, position_m + 3 * p, &sources);
        for (size_t i = 0; i < 3; ++i) {
            memcpy(field_T + (i * points + p) * coils->count, sources.field_T[i], bytes);
            for (size_t j = 0; j < 3; ++j) {
                double *const out = gradient_T_m + ((3 * i + j) * points + p) * coils->count;
                memcpy(out, sources.gradient_T_m[row_of[i][j]], bytes);
            }
        }
    }
}

WIDE void gf_components(const gf_coils_t *coils, const gf_pose_t *pose, const double *weight, gf_components_t *out) {
    gf_sources_t sources;
    gf_sources(coils, pose->position_m, &sources);
    for (size_t i = 0; i < coils->count; ++i) {
        const double bx = sources.field_T[0][i];
        const double by = sources.field_T[1][i];
        const double bz = sources.field_T[2][i];
        for (size_t c = 0; c < 3; ++c) {
            /* h = e.B with e the sensor's axis in the site's frame; dh = e.(G dp) + (e x B).d_theta */
            const double w = weight[3 * i + c];
            const double x = w * pose->rotation[0][c];
            const double y = w * pose->rotation[1][c];
            const double z = w * pose->rotation[2][c];
            double *const slope = out->slope[3 * i + c];
            out->value[3 * i + c] = x * bx + y * by + z * bz;
            slope[0] = x * sources.gradient_T_m[0][i] + y * sources.gradient_T_m[3][i] + z * sources.gradient_T_m[4][i];
            slope[1] = x * sources.gradient_T_m[3][i] + y * sources.gradient_T_m[1][i] + z * sources.gradient_T_m[5][i];
            slope[2] = x * sources.gradient_T_m[4][i] + y * sources.gradient_T_m[5][i] + z * sources.gradient_T_m[2][i];
            slope[3] = y * bz - z * by;
            slope[4] = z * bx - x * bz;
            slope[5] = x * by - y * bx;
        }
    }
}

void gf_weights(size_t coils, const double *field_T, const double *sigma_T, double model_error, double *weight) {
    for (size_t i = 0; i < coils; ++i) {
        double square = 0.0;
        for (size_t c = 0; c < 3; ++c) {
            const double b = field_T[3 * i + c];
            square += isfinite(b) ? b * b : 0.0;
        }
        const double w = 1.0 / sqrt(sigma_T[i] * sigma_T[i] + model_error * model_error * square);
        for (size_t c = 0; c < 3; ++c) {
            weight[3 * i + c] = isfinite(field_T[3 * i + c]) ? w : 0.0;
        }
    }
}

void gf_turn(double rotation[3][3], const double vector[3]) {
    const double angle2 = vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2];
    const double angle = sqrt(angle2);
    const double half = 0.5 * angle;
    /* A unit quaternion, whose sine over angle loses nothing at small angles. */
    const double ratio = half < 1e-4 ? 0.5 * (1.0 - half * half / 6.0) : sin(half) / angle;
    const double w = cos(half);
    const double x = ratio * vector[0];
    const double y = ratio * vector[1];
    const double z = ratio * vector[2];
    for (size_t c = 0; c < 3; ++c) {
        const double vx = rotation[0][c];
        const double vy = rotation[1][c];
        const double vz = rotation[2][c];
        const double tx = 2.0 * (y * vz - z * vy);
        const double ty = 2.0 * (z * vx - x * vz);
        const double tz = 2.0 * (x * vy - y * vx);
        rotation[0][c] = vx + w * tx + (y * tz - z * ty);
        rotation[1][c] = vy + w * ty + (z * tx - x * tz);
        rotation[2][c] = vz + w * tz + (x * ty - y * tx);
    }
}
