#include "whiten.h"

#include <math.h>
#include <string.h>

/* Covariance that the errors of beacon i put on its field in the site's frame: with B the field, G its gradient and q
 * the point seen from the coil, a shift of the coil changes B by -G, a turn about its centre by -[B]x + G [q]x, and
 * the current by B. */
static void spread_of(const gf_coils_t *coils, const gf_errors_t *errors, const gf_sources_t *sources,
                      const double position_m[3], size_t i, double out[3][3]) {
    const double b[3] = {sources->field_T[0][i], sources->field_T[1][i], sources->field_T[2][i]};
    const double xx = sources->gradient_T_m[0][i];
    const double yy = sources->gradient_T_m[1][i];
    const double zz = sources->gradient_T_m[2][i];
    const double xy = sources->gradient_T_m[3][i];
    const double xz = sources->gradient_T_m[4][i];
    const double yz = sources->gradient_T_m[5][i];
    const double g[3][3] = {{xx, xy, xz}, {xy, yy, yz}, {xz, yz, zz}};
    const double b_cross[3][3] = {{0.0, -b[2], b[1]}, {b[2], 0.0, -b[0]}, {-b[1], b[0], 0.0}};
    const double q[3] = {position_m[0] - coils->centre_m[0][i], position_m[1] - coils->centre_m[1][i],
                         position_m[2] - coils->centre_m[2][i]};
    const double q_cross[3][3] = {{0.0, -q[2], q[1]}, {q[2], 0.0, -q[0]}, {-q[1], q[0], 0.0}};
    double effect[3][7]; /* by place, direction and current, each in standard deviations */
    for (size_t r = 0; r < 3; ++r) {
        for (size_t c = 0; c < 3; ++c) {
            double turn = -b_cross[r][c];
            for (size_t k = 0; k < 3; ++k) {
                turn += g[r][k] * q_cross[k][c];
            }
            effect[r][c] = errors->position_sd_m[i] * g[r][c];
            effect[r][3 + c] = errors->axis_sd_rad[i] * turn;
        }
        effect[r][6] = errors->current_sd[i] * b[r];
    }
    for (size_t r = 0; r < 3; ++r) {
        for (size_t c = 0; c < 3; ++c) {
            out[r][c] = 0.0;
            for (size_t k = 0; k < 7; ++k) {
                out[r][c] += effect[r][k] * effect[c][k];
            }
        }
    }
}

/* R' C R. */
static void into_sensor(const double rotation[3][3], double c[3][3]) {
    double half[3][3];
    for (size_t i = 0; i < 3; ++i) {
        for (size_t j = 0; j < 3; ++j) {
            half[i][j] = c[i][0] * rotation[0][j] + c[i][1] * rotation[1][j] + c[i][2] * rotation[2][j];
        }
    }
    for (size_t i = 0; i < 3; ++i) {
        for (size_t j = 0; j < 3; ++j) {
            c[i][j] = rotation[0][i] * half[0][j] + rotation[1][i] * half[1][j] + rotation[2][i] * half[2][j];
        }
    }
}

/* Inverse of the Cholesky factor of a 3 x 3 covariance among the measured components; other rows are 0. */
static void inverse_factor(const double covariance[3][3], const double measured[3], double out[3][3]) {
    double l[3][3] = {{0.0}};
    memset(out, 0, 3 * sizeof out[0]);
    for (size_t i = 0; i < 3; ++i) {
        if (!(measured[i] > 0.0)) {
            continue;
        }
        for (size_t j = 0; j <= i; ++j) {
            double sum = covariance[i][j];
            for (size_t k = 0; k < j; ++k) {
                sum -= l[i][k] * l[j][k];
            }
            if (j == i) {
                l[i][i] = sqrt(sum);
            } else if (measured[j] > 0.0) {
                l[i][j] = sum / l[j][j];
            }
        }
        out[i][i] = 1.0 / l[i][i];
        for (size_t j = 0; j < i; ++j) {
            double sum = 0.0;
            for (size_t k = j; k < i; ++k) {
                sum += l[i][k] * out[k][j];
            }
            out[i][j] = -sum * out[i][i];
        }
    }
}

/* V = S L^-T with L the Cholesky factor of 1 + S'S. */
static void share(size_t components, double s[][GF_SHARED]) {
    double l[GF_SHARED][GF_SHARED] = {{0.0}};
    for (size_t c = 0; c < components; ++c) {
        for (size_t i = 0; i < GF_SHARED; ++i) {
            for (size_t j = 0; j <= i; ++j) {
                l[i][j] += s[c][i] * s[c][j];
            }
        }
    }
    for (size_t i = 0; i < GF_SHARED; ++i) {
        for (size_t j = 0; j <= i; ++j) {
            double sum = l[i][j] + (i == j ? 1.0 : 0.0);
            for (size_t k = 0; k < j; ++k) {
                sum -= l[i][k] * l[j][k];
            }
            l[i][j] = i == j ? 1.0 / sqrt(sum) : sum * l[j][j]; /* the reciprocal on the diagonal */
        }
    }
    for (size_t c = 0; c < components; ++c) {
        for (size_t i = 0; i < GF_SHARED; ++i) {
            for (size_t k = 0; k < i; ++k) {
                s[c][i] -= l[i][k] * s[c][k];
            }
            s[c][i] *= l[i][i];
        }
    }
}

static void multiply(const double factor[3][3], double value[3]) {
    /* From below, since the factor is lower triangular. */
    value[2] = factor[2][0] * value[0] + factor[2][1] * value[1] + factor[2][2] * value[2];
    value[1] = factor[1][0] * value[0] + factor[1][1] * value[1];
    value[0] = factor[0][0] * value[0];
}

void gf_whiten(const gf_coils_t *coils, const gf_errors_t *errors, const double *field_T, const double *sigma_T,
               const gf_pose_t *pose, gf_whitening_t *out) {
    const size_t n = coils->count;
    const double gain = errors->gain_sd;
    const double lean = errors->sensor_axis_sd_rad * sqrt(0.5); /* of a pair of axes towards each other */
    gf_sources_t sources;
    gf_sources(coils, pose->position_m, &sources);
    out->is_shared = gain > 0.0 || lean > 0.0;
    for (size_t i = 0; i < n; ++i) {
        double covariance[3][3];
        double h[3];
        spread_of(coils, errors, &sources, pose->position_m, i, covariance);
        into_sensor((const double(*)[3])pose->rotation, covariance);
        for (size_t c = 0; c < 3; ++c) {
            const size_t row = 3 * i + c;
            out->weight[row] = isfinite(field_T[row]) ? 1.0 : 0.0;
            for (size_t k = 0; k < 3; ++k) {
                covariance[c][k] += errors->noise_shape[c][k] * (sigma_T[i] * sigma_T[i]);
            }
            h[c] = pose->rotation[0][c] * sources.field_T[0][i] + pose->rotation[1][c] * sources.field_T[1][i] +
                   pose->rotation[2][c] * sources.field_T[2][i];
        }
        inverse_factor((const double(*)[3])covariance, out->weight + 3 * i, out->beacon[i]);
        if (out->is_shared) {
            const double effect[3][GF_SHARED] = {
                {gain * h[0], 0.0, 0.0, lean * h[1], lean * h[2], 0.0},
                {0.0, gain * h[1], 0.0, lean * h[0], 0.0, lean * h[2]},
                {0.0, 0.0, gain * h[2], 0.0, lean * h[0], lean * h[1]},
            };
            for (size_t k = 0; k < GF_SHARED; ++k) {
                double column[3] = {effect[0][k], effect[1][k], effect[2][k]};
                multiply((const double(*)[3])out->beacon[i], column);
                for (size_t c = 0; c < 3; ++c) {
                    out->shared[3 * i + c][k] = column[c];
                }
            }
        }
    }
    if (out->is_shared) {
        share(3 * n, out->shared);
    } else {
        memset(out->shared, 0, sizeof out->shared);
    }
}

void gf_whiten_values(size_t coils, const gf_whitening_t *whitening, double *value) {
    for (size_t i = 0; i < coils; ++i) {
        multiply((const double(*)[3])whitening->beacon[i], value + 3 * i);
    }
}

void gf_whitened(size_t coils, const gf_whitening_t *whitening, gf_components_t *components) {
    gf_whiten_values(coils, whitening, components->value);
    for (size_t i = 0; i < coils; ++i) {
        const double(*const w)[3] = (const double(*)[3])whitening->beacon[i];
        double(*const slope)[6] = components->slope + 3 * i;
        for (size_t k = 0; k < 6; ++k) {
            slope[2][k] = w[2][0] * slope[0][k] + w[2][1] * slope[1][k] + w[2][2] * slope[2][k];
        }
        for (size_t k = 0; k < 6; ++k) {
            slope[1][k] = w[1][0] * slope[0][k] + w[1][1] * slope[1][k];
        }
        for (size_t k = 0; k < 6; ++k) {
            slope[0][k] *= w[0][0];
        }
    }
}

void gf_unshare_values(size_t coils, const gf_whitening_t *whitening, double *value) {
    double along[GF_SHARED] = {0.0};
    if (!whitening->is_shared) {
        return;
    }
    for (size_t c = 0; c < 3 * coils; ++c) {
        for (size_t k = 0; k < GF_SHARED; ++k) {
            along[k] += whitening->shared[c][k] * value[c];
        }
    }
    for (size_t c = 0; c < 3 * coils; ++c) {
        for (size_t k = 0; k < GF_SHARED; ++k) {
            value[c] -= whitening->shared[c][k] * along[k];
        }
    }
}

void gf_unshare_slopes(size_t coils, const gf_whitening_t *whitening, double slope[][6]) {
    double along[GF_SHARED][6] = {{0.0}};
    if (!whitening->is_shared) {
        return;
    }
    for (size_t c = 0; c < 3 * coils; ++c) {
        for (size_t k = 0; k < GF_SHARED; ++k) {
            for (size_t l = 0; l < 6; ++l) {
                along[k][l] += whitening->shared[c][k] * slope[c][l];
            }
        }
    }
    for (size_t c = 0; c < 3 * coils; ++c) {
        for (size_t k = 0; k < GF_SHARED; ++k) {
            for (size_t l = 0; l < 6; ++l) {
                slope[c][l] -= whitening->shared[c][k] * along[k][l];
            }
        }
    }
}
