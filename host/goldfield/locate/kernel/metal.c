#include "metal.h"

#include <math.h>

#define MOST_TERMS (GF_MOST_DEGREE * GF_MOST_DEGREE)

/* Place of the real part of a harmonic among all: degree l, order m. The imaginary part follows. */
static size_t place_of(size_t l, size_t m) {
    return l * l + (m > 0 ? 2 * m - 1 : 0);
}

/* Regular solid harmonics up to a degree below GF_MOST_DEGREE (goldfield.field.harmonics.harmonic_values). */
static void harmonics(const double p[3], size_t degree, double out[MOST_TERMS]) {
    const double square = p[0] * p[0] + p[1] * p[1] + p[2] * p[2];
    double real = 1.0;
    double imaginary = 0.0;
    for (size_t m = 0; m <= degree; ++m) {
        if (m > 0) {
            const double over = 0.5 / (double)m;
            const double turned = over * (p[0] * real - p[1] * imaginary);
            imaginary = over * (p[0] * imaginary + p[1] * real);
            real = turned;
            out[place_of(m, m) + 1] = imaginary;
        }
        out[place_of(m, m)] = real;
        for (size_t part = 0; part <= (m > 0 ? 1U : 0U); ++part) {
            for (size_t l = m + 1; l <= degree; ++l) {
                const double lower = l >= m + 2 ? out[place_of(l - 2, m) + part] : 0.0;
                out[place_of(l, m) + part] = ((double)(2 * l - 1) * p[2] * out[place_of(l - 1, m) + part] -
                                              square * lower) /
                                             (double)((l + m) * (l - m));
            }
        }
    }
}

static void add_polynomials(const gf_metal_t *metal, size_t n, const double position_m[3],
                            double field_T[3][GF_MOST_COILS], double gradient_T_m[6][GF_MOST_COILS]) {
    double at[3];
    for (size_t c = 0; c < 3; ++c) {
        at[c] = (position_m[c] - metal->centre_m[c]) / metal->radius_m;
    }
    double value[MOST_TERMS] = {0};
    harmonics(at, metal->degree - 1, value);
    const size_t terms = metal->degree * metal->degree;
    for (size_t c = 0; c < 9; ++c) {
        double *const sum = c < 3 ? field_T[c] : gradient_T_m[c - 3];
        for (size_t t = 0; t < terms; ++t) {
            const double *const row = &metal->sums[(c * terms + t) * n];
            for (size_t i = 0; i < n; ++i) {
                sum[i] += value[t] * row[i];
            }
        }
    }
}

/* The field of dipoles m at distance r: K (3 (m.r) r/r^2 - m)/r^3, and its gradient 3 K (m r' + r m' + (m.r)(I - 5 r
 * r'/r^2))/r^5. */
static void add_body(const double body_m[3], const double *moment_A_m2, size_t n, const double position_m[3],
                     double field_T[3][GF_MOST_COILS], double gradient_T_m[6][GF_MOST_COILS]) {
    const double x = position_m[0] - body_m[0];
    const double y = position_m[1] - body_m[1];
    const double z = position_m[2] - body_m[2];
    const double over = 1.0 / (x * x + y * y + z * z);
    const double k3 = GF_MU0_OVER_4PI * over * sqrt(over);
    const double k5 = 3.0 * k3 * over;
    for (size_t i = 0; i < n; ++i) {
        const double mx = moment_A_m2[i];
        const double my = moment_A_m2[n + i];
        const double mz = moment_A_m2[2 * n + i];
        const double along = mx * x + my * y + mz * z;
        const double radial = k5 * along;
        const double bent = -5.0 * over * along;
        field_T[0][i] += radial * x - k3 * mx;
        field_T[1][i] += radial * y - k3 * my;
        field_T[2][i] += radial * z - k3 * mz;
        gradient_T_m[0][i] += k5 * (2.0 * mx * x + along + bent * x * x);
        gradient_T_m[1][i] += k5 * (2.0 * my * y + along + bent * y * y);
        gradient_T_m[2][i] += k5 * (2.0 * mz * z + along + bent * z * z);
        gradient_T_m[3][i] += k5 * (mx * y + my * x + bent * x * y);
        gradient_T_m[4][i] += k5 * (mx * z + mz * x + bent * x * z);
        gradient_T_m[5][i] += k5 * (my * z + mz * y + bent * y * z);
    }
}

void gf_add_metal(const gf_metal_t *metal, size_t n, const double position_m[3], double field_T[3][GF_MOST_COILS],
                  double gradient_T_m[6][GF_MOST_COILS]) {
    if (metal->degree > 0) {
        add_polynomials(metal, n, position_m, field_T, gradient_T_m);
    }
    for (size_t k = 0; k < metal->bodies; ++k) {
        add_body(metal->body_m[k], &metal->moment_A_m2[k * 3 * n], n, position_m, field_T, gradient_T_m);
    }
}
