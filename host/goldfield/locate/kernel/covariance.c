#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "around.h"

/* q = half the second difference of the model along one principal axis and each other, as a pose error. */
static void curve(const gf_coils_t *coils, const gf_errors_t *errors, const gf_pose_t *pose, const gf_around_t *around,
                  const double root[6][6], double back[][6], size_t axis, double q[6][6]) {
    gf_components_t ahead;
    gf_components_t behind;
    double step[6];
    gf_pose_t moved = *pose;
    for (size_t k = 0; k < 6; ++k) {
        step[k] = root[k][axis];
    }
    for (size_t k = 0; k < 3; ++k) {
        moved.position_m[k] += step[k];
    }
    gf_turn(moved.rotation, step + 3);
    gf_look(coils, errors, around, &moved, &ahead);
    moved = *pose;
    for (size_t k = 0; k < 6; ++k) {
        step[k] = -step[k];
    }
    for (size_t k = 0; k < 3; ++k) {
        moved.position_m[k] += step[k];
    }
    gf_turn(moved.rotation, step + 3);
    gf_look(coils, errors, around, &moved, &behind);

    double change[6][6] = {{0.0}}; /* difference of the Jacobians, transposed, onto the tangent space */
    for (size_t c = 0; c < 3 * coils->count; ++c) {
        for (size_t k = 0; k < 6; ++k) {
            const double d = 0.5 * (ahead.slope[c][k] - behind.slope[c][k]);
            for (size_t l = 0; l < 6; ++l) {
                change[k][l] += d * back[c][l];
            }
        }
    }
    memset(q, 0, 6 * sizeof q[0]);
    for (size_t k = 0; k < 6; ++k) {
        for (size_t i = 0; i < 6; ++i) {
            for (size_t l = 0; l < 6; ++l) {
                q[i][l] += root[k][i] * change[k][l];
            }
        }
    }
}

/* 1 + (m m' + 2 sum q q')/4 with q made symmetric in its two axes, m the sum of q over equal axes. */
static void second_order(double q[6][6][6], double out[6][6]) {
    double mean[6] = {0.0};
    memset(out, 0, 6 * sizeof out[0]);
    for (size_t i = 0; i < 6; ++i) {
        for (size_t j = 0; j < 6; ++j) {
            double both[6];
            for (size_t k = 0; k < 6; ++k) {
                both[k] = 0.5 * (q[i][j][k] + q[j][i][k]);
                mean[k] += i == j ? both[k] : 0.0;
            }
            for (size_t k = 0; k < 6; ++k) {
                for (size_t l = 0; l < 6; ++l) {
                    out[k][l] += 0.5 * both[k] * both[l];
                }
            }
        }
    }
    for (size_t k = 0; k < 6; ++k) {
        for (size_t l = 0; l < 6; ++l) {
            out[k][l] += 0.25 * mean[k] * mean[l] + (k == l ? 1.0 : 0.0);
        }
    }
}

/* Tell nothing of a pose whose covariance is not finite: the model is not one standard deviation away, as on a wire. */
static void free_what_is_not_told(const double free_root[6], double covariance[36]) {
    bool told = true;
    for (size_t k = 0; k < 36; ++k) {
        told = told && isfinite(covariance[k]);
    }
    for (size_t k = 0; !told && k < 36; ++k) {
        covariance[k] = k % 7 == 0 ? free_root[k / 7] * free_root[k / 7] : 0.0;
    }
}

void gf_covariance(const gf_coils_t *coils, const gf_errors_t *errors, size_t epochs, const double *field_T,
                   const double *sigma_T, const double *position_m, const double *rotation, double least_eigenvalue,
                   double free_m2, double free_rad2, double *covariance) {
    const size_t n = coils->count;
    const double free_root[6] = {sqrt(free_m2),   sqrt(free_m2),   sqrt(free_m2),
                                 sqrt(free_rad2), sqrt(free_rad2), sqrt(free_rad2)};
    /* All axes leaning alike are a turn of the sensor: nothing but the attitude tells of it. */
    const double common = errors != NULL ? 0.5 * errors->sensor_axis_sd_rad * errors->sensor_axis_sd_rad : 0.0;
    for (size_t e = 0; e < epochs; ++e) {
        const gf_pose_t pose = gf_pose_of(position_m + 3 * e, rotation + 9 * e);
        gf_around_t around;
        double information[6][6];
        double root[6][6];
        double free[6][6];
        double q[6][6][6];
        double middle[6][6];
        gf_look_around(coils, errors, field_T + 3 * n * e, sigma_T + n * e, &pose, &around);
        gf_inform(3 * n, around.components.slope, around.weighted, information);
        gf_split((const double(*)[6])information, least_eigenvalue, root, free);
        gf_transform(3 * n, around.weighted, (const double(*)[6])root, around.weighted);
        for (size_t axis = 0; axis < 6; ++axis) {
            curve(coils, errors, &pose, &around, (const double(*)[6])root, around.weighted, axis, q[axis]);
        }
        second_order(q, middle);
        double product[6][6];
        gf_transform(6, root, (const double(*)[6])middle, product);
        for (size_t k = 0; k < 6; ++k) {
            for (size_t l = 0; l < 6; ++l) {
                double sum = 0.0;
                for (size_t m = 0; m < 6; ++m) {
                    sum += product[k][m] * root[l][m] + free_root[k] * free_root[l] * free[k][m] * free[l][m];
                }
                covariance[36 * e + 6 * k + l] = sum;
            }
        }
        free_what_is_not_told(free_root, covariance + 36 * e);
        for (size_t k = 3; k < 6; ++k) {
            covariance[36 * e + 7 * k] += common;
        }
    }
}
