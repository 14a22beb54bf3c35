#include "around.h"

#include <math.h>
#include <string.h>

#include "linear.h"

void gf_split(const double information[6][6], double least_eigenvalue, double root[6][6], double free[6][6]) {
    double scale[6];
    double scaled[6][6];
    double vector[6][6];
    for (size_t k = 0; k < 6; ++k) {
        scale[k] = 1.0 / sqrt(information[k][k] + 1e-300);
    }
    for (size_t k = 0; k < 6; ++k) {
        for (size_t l = 0; l < 6; ++l) {
            scaled[k][l] = information[k][l] * scale[k] * scale[l];
        }
    }
    gf_eigen(6, scaled, vector);
    memset(free, 0, 6 * sizeof free[0]);
    for (size_t l = 0; l < 6; ++l) {
        const bool seen = scaled[l][l] > least_eigenvalue;
        const double stretch = seen ? 1.0 / sqrt(scaled[l][l]) : 0.0;
        double length2 = 0.0;
        for (size_t k = 0; k < 6; ++k) {
            const double along = scale[k] * vector[k][l];
            root[k][l] = along * stretch;
            length2 += along * along;
        }
        for (size_t k = 0; !seen && k < 6; ++k) {
            free[k][l] = scale[k] * vector[k][l] / sqrt(length2);
        }
    }
}

void gf_inform(size_t components, double slope[][6], double weighted[][6], double information[6][6]) {
    memset(information, 0, 6 * sizeof information[0]);
    for (size_t c = 0; c < components; ++c) {
        for (size_t k = 0; k < 6; ++k) {
            for (size_t l = 0; l < 6; ++l) {
                information[k][l] += slope[c][k] * weighted[c][l];
            }
        }
    }
}

void gf_transform(size_t components, double slope[][6], const double by[6][6], double out[][6]) {
    for (size_t c = 0; c < components; ++c) {
        double sum[6] = {0.0};
        for (size_t k = 0; k < 6; ++k) {
            for (size_t l = 0; l < 6; ++l) {
                sum[l] += slope[c][k] * by[k][l];
            }
        }
        memcpy(out[c], sum, sizeof sum);
    }
}

gf_pose_t gf_pose_of(const double *position_m, const double *rotation) {
    gf_pose_t pose;
    memcpy(pose.position_m, position_m, sizeof pose.position_m);
    memcpy(pose.rotation, rotation, sizeof pose.rotation);
    return pose;
}

void gf_look(const gf_coils_t *coils, const gf_errors_t *errors, const gf_around_t *around, const gf_pose_t *pose,
             gf_components_t *out) {
    gf_components(coils, pose, around->whitening.weight, out);
    if (errors != NULL) {
        gf_whitened(coils->count, &around->whitening, out);
    }
}

void gf_look_around(const gf_coils_t *coils, const gf_errors_t *errors, const double *field_T, const double *sigma_T,
                    const gf_pose_t *pose, gf_around_t *out) {
    const size_t rows = 3 * coils->count;
    if (errors == NULL) {
        memset(out->whitening.shared, 0, rows * sizeof out->whitening.shared[0]);
        out->whitening.is_shared = false;
        gf_weights(coils->count, field_T, sigma_T, 0.0, out->whitening.weight);
    } else {
        gf_whiten(coils, errors, field_T, sigma_T, pose, &out->whitening);
    }
    gf_look(coils, errors, out, pose, &out->components);
    memcpy(out->weighted, out->components.slope, rows * sizeof out->weighted[0]);
    gf_unshare_slopes(coils->count, &out->whitening, out->weighted);
}
