#include <math.h>
#include <string.h>

#include "coils.h"
#include "linear.h"
#include "whiten.h"

/* Split information into a root L of its inverse, L L' on what the measurements tell, and the directions that they
 * do not tell: those columns of root are zero and the unit vector is in free. */
static void split(const double information[6][6], double least_eigenvalue, double root[6][6], double free[6][6]) {
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

/* The information of whitened slopes; weighted are the same slopes, weighted for errors that components share. */
static void inform(size_t components, double slope[][6], double weighted[][6], double information[6][6]) {
    memset(information, 0, 6 * sizeof information[0]);
    for (size_t c = 0; c < components; ++c) {
        for (size_t k = 0; k < 6; ++k) {
            for (size_t l = 0; l < 6; ++l) {
                information[k][l] += slope[c][k] * weighted[c][l];
            }
        }
    }
}

/* Each row times a 6 x 6 matrix. */
static void transform(size_t components, double slope[][6], const double by[6][6], double out[][6]) {
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

static gf_pose_t pose_of(const double *position_m, const double *rotation) {
    gf_pose_t pose;
    memcpy(pose.position_m, position_m, sizeof pose.position_m);
    memcpy(pose.rotation, rotation, sizeof pose.rotation);
    return pose;
}

typedef struct {
    double drop;
    double scale;
    double slope;
    int32_t freedom;
} fault_t;

/* Largest eigenvalue of the covariance of the columns of move, 3 x k: the square of the longest way that a unit vector
 * of k elements moves the position. */
static double longest2(double move[3][3]) {
    double square[3][6] = {{0.0}};
    double vector[3][6];
    for (size_t i = 0; i < 3; ++i) {
        for (size_t j = 0; j < 3; ++j) {
            for (size_t k = 0; k < 3; ++k) {
                square[i][j] += move[i][k] * move[j][k];
            }
        }
    }
    gf_eigen(3, square, vector);
    return fmax(square[0][0], fmax(square[1][1], square[2][2]));
}

/* The statistics of one beacon from its residuals, the modelled components and the model's derivatives T along the
 * principal axes of the pose's error (tangent), all over the standard deviations. The covariance of its residuals is
 * 1 - T T'; residuals and T are weighted for what all components share, which takes V V' (shared) from it too. The
 * first three rows of root take the principal axes to the position. */
static fault_t fault_of(const double residual[3], const double modelled[3], const double tangent[3][6],
                        const double shared[3][GF_SHARED], const double root[6][6], const double measured[3],
                        double least_share) {
    double covariance[3][6];
    double vector[3][6];
    double move[3][3] = {{0.0}}; /* position by a fault of one in the cost, one column an eigenvector */
    fault_t fault = {0.0, 0.0, 0.0, 0};
    double along_field = 0.0;
    double shown = 0.0;
    double strength2 = 0.0;
    int32_t components = 0;
    for (size_t i = 0; i < 3; ++i) {
        components += measured[i] > 0.0 ? 1 : 0;
        for (size_t j = 0; j < 3; ++j) {
            double sum = i == j && measured[i] > 0.0 ? 1.0 : 0.0;
            for (size_t k = 0; k < 6; ++k) {
                sum -= tangent[i][k] * tangent[j][k];
            }
            for (size_t k = 0; k < GF_SHARED; ++k) {
                sum -= shared[i][k] * shared[j][k];
            }
            covariance[i][j] = sum;
        }
    }
    gf_eigen(3, covariance, vector);
    for (size_t k = 0; k < 3; ++k) {
        const double gain = covariance[k][k];
        const double r = vector[0][k] * residual[0] + vector[1][k] * residual[1] + vector[2][k] * residual[2];
        const double s = vector[0][k] * modelled[0] + vector[1][k] * modelled[1] + vector[2][k] * modelled[2];
        if (gain > least_share) {
            const double unit = 1.0 / sqrt(gain);
            fault.drop += r * r / gain;
            fault.freedom += 1;
            for (size_t l = 0; l < 6; ++l) {
                const double along = unit * (vector[0][k] * tangent[0][l] + vector[1][k] * tangent[1][l] +
                                             vector[2][k] * tangent[2][l]);
                for (size_t i = 0; i < 3; ++i) {
                    move[i][k] += root[i][l] * along;
                }
            }
        }
        along_field += s * r;
        shown += s * s * gain;
        strength2 += s * s;
    }
    if (shown > least_share * strength2) {
        fault.scale = along_field * along_field / shown;
    }
    fault.slope = fault.freedom < components ? INFINITY : sqrt(longest2(move));
    return fault;
}

/* What both statistics and covariance start from: whitened components around a pose, and the same slopes weighted
 * for what all components share. Without errors the whitening only has weights. */
typedef struct {
    gf_whitening_t whitening;
    gf_components_t components;
    double weighted[3 * GF_MOST_COILS][6];
} around_t;

static void look(const gf_coils_t *coils, const gf_errors_t *errors, const around_t *around, const gf_pose_t *pose,
                 gf_components_t *out) {
    gf_components(coils, pose, around->whitening.weight, out);
    if (errors != NULL) {
        gf_whitened(coils->count, &around->whitening, out);
    }
}

static void prepare(const gf_coils_t *coils, const gf_errors_t *errors, const double *field_T, const double *sigma_T,
                    const gf_pose_t *pose, around_t *out) {
    if (errors == NULL) {
        memset(out->whitening.shared, 0, sizeof out->whitening.shared);
        out->whitening.is_shared = false;
        gf_weights(coils->count, field_T, sigma_T, 0.0, out->whitening.weight);
    } else {
        gf_whiten(coils, errors, field_T, sigma_T, pose, &out->whitening);
    }
    look(coils, errors, out, pose, &out->components);
    memcpy(out->weighted, out->components.slope, sizeof out->weighted);
    gf_unshare_slopes(coils->count, &out->whitening, out->weighted);
}

/* Measured minus modelled components, weighted. */
static void compare(const gf_coils_t *coils, const gf_errors_t *errors, const double *field_T, const around_t *around,
                    double *residual) {
    const size_t n = coils->count;
    const double *const weight = around->whitening.weight;
    for (size_t c = 0; c < 3 * n; ++c) {
        residual[c] = weight[c] > 0.0 ? weight[c] * field_T[c] : 0.0;
    }
    if (errors != NULL) {
        gf_whiten_values(n, &around->whitening, residual);
    }
    for (size_t c = 0; c < 3 * n; ++c) {
        residual[c] = weight[c] > 0.0 ? residual[c] - around->components.value[c] : 0.0;
    }
    gf_unshare_values(n, &around->whitening, residual);
}

#define DISTORTIONS 6 /* Elements of a symmetric matrix. */

/* What a beacon's components change by with each element of S in b = (1 + S) R'B: one gain, two differences of gains,
 * three angles between axes. */
static void distort(const double modelled[3], const double measured[3], double column[3][DISTORTIONS]) {
    const double x = modelled[0];
    const double y = modelled[1];
    const double z = modelled[2];
    const double all[3][DISTORTIONS] = {
        {x, x, x, 0.0, z, y},
        {y, -y, y, z, 0.0, x},
        {z, 0.0, -2.0 * z, y, x, 0.0},
    };
    for (size_t c = 0; c < 3; ++c) {
        for (size_t k = 0; k < DISTORTIONS; ++k) {
            column[c][k] = measured[c] > 0.0 ? all[c][k] : 0.0;
        }
    }
}

/* Parts of the cost that the first, the first three and all distortions take away, by elimination one after another;
 * one that the pose or those before it explain does not count. shown is their covariance in the residuals, square what
 * it would be if the pose explained nothing of them, along their product with the residuals. */
static void eliminate(double shown[DISTORTIONS][DISTORTIONS], double along[DISTORTIONS],
                      const double square[DISTORTIONS], double least_share, double drop[3], int32_t freedom[3]) {
    static const size_t last[3] = {1, 3, DISTORTIONS};
    double sum = 0.0;
    int32_t count = 0;
    size_t group = 0;
    for (size_t k = 0; k < DISTORTIONS; ++k) {
        const double pivot = shown[k][k];
        if (pivot > least_share * square[k]) {
            sum += along[k] * along[k] / pivot;
            count += 1;
            for (size_t i = k + 1; i < DISTORTIONS; ++i) {
                const double part = shown[i][k] / pivot;
                along[i] -= part * along[k];
                for (size_t j = k + 1; j < DISTORTIONS; ++j) {
                    shown[i][j] -= part * shown[k][j];
                }
            }
        }
        if (k + 1 == last[group]) {
            drop[group] = sum;
            freedom[group] = count;
            group += 1;
        }
    }
}

/* The weighted columns of all distortions, one component a row, whitened as the residuals are. */
static void distort_all(const gf_coils_t *coils, const gf_errors_t *errors, const gf_pose_t *pose,
                        const around_t *around, double column[DISTORTIONS][3 * GF_MOST_COILS]) {
    const size_t n = coils->count;
    const double *const weight = around->whitening.weight;
    double whole[3 * GF_MOST_COILS]; /* as if all components had been measured: a distortion mixes them */
    gf_components_t plain;           /* weighted, not whitened: the components of one beacon have one weight */
    for (size_t c = 0; c < 3 * n; ++c) {
        const double *const of_one = weight + 3 * (c / 3);
        whole[c] = fmax(of_one[0], fmax(of_one[1], of_one[2]));
    }
    gf_components(coils, pose, whole, &plain);
    for (size_t i = 0; i < n; ++i) {
        double one[3][DISTORTIONS];
        distort(plain.value + 3 * i, weight + 3 * i, one);
        for (size_t c = 0; c < 3; ++c) {
            for (size_t k = 0; k < DISTORTIONS; ++k) {
                column[k][3 * i + c] = one[c][k];
            }
        }
    }
    for (size_t k = 0; errors != NULL && k < DISTORTIONS; ++k) {
        gf_whiten_values(n, &around->whitening, column[k]);
    }
}

/* The statistics of the sensor from all residuals, its columns and tangents. */
static void distortions_of(size_t components, const double *residual, double column[DISTORTIONS][3 * GF_MOST_COILS],
                           double tangent[][6], const double shared[][GF_SHARED], double least_share, double drop[3],
                           int32_t freedom[3]) {
    double shown[DISTORTIONS][DISTORTIONS];
    double explained[DISTORTIONS][6] = {{0.0}};
    double spread[DISTORTIONS][GF_SHARED] = {{0.0}};
    double along[DISTORTIONS] = {0.0};
    double square[DISTORTIONS];
    for (size_t k = 0; k < DISTORTIONS; ++k) {
        for (size_t c = 0; c < components; ++c) {
            along[k] += column[k][c] * residual[c];
            for (size_t l = 0; l < 6; ++l) {
                explained[k][l] += column[k][c] * tangent[c][l];
                spread[k][l] += column[k][c] * shared[c][l];
            }
        }
    }
    for (size_t k = 0; k < DISTORTIONS; ++k) {
        for (size_t l = 0; l < DISTORTIONS; ++l) {
            double sum = 0.0;
            for (size_t c = 0; c < components; ++c) {
                sum += column[k][c] * column[l][c];
            }
            for (size_t m = 0; m < GF_SHARED; ++m) {
                sum -= spread[k][m] * spread[l][m];
            }
            shown[k][l] = sum;
        }
        square[k] = shown[k][k];
    }
    for (size_t k = 0; k < DISTORTIONS; ++k) {
        for (size_t l = 0; l < DISTORTIONS; ++l) {
            for (size_t m = 0; m < 6; ++m) {
                shown[k][l] -= explained[k][m] * explained[l][m];
            }
        }
    }
    eliminate(shown, along, square, least_share, drop, freedom);
}

/* Make the tangents orthonormal to the last digit, which the eigenvalues of an ill-conditioned information do not, and
 * carry the change into the root: one Newton step, times (3 - T'W)/2, T whitened and W weighted besides. */
static void straighten(size_t components, double tangent[][6], double weighted[][6], double root[6][6]) {
    double by[6][6];
    inform(components, tangent, weighted, by);
    for (size_t k = 0; k < 6; ++k) {
        for (size_t l = 0; l < 6; ++l) {
            by[k][l] = (k == l ? 1.5 : 0.0) - 0.5 * by[k][l];
        }
    }
    transform(components, tangent, (const double(*)[6])by, tangent);
    transform(components, weighted, (const double(*)[6])by, weighted);
    transform(6, root, (const double(*)[6])by, root);
}

/* Take off what the pose explains: the fit has ended a little before the minimum. */
static void project(size_t components, double tangent[][6], double weighted[][6], double residual[]) {
    double along[6] = {0.0};
    for (size_t c = 0; c < components; ++c) {
        for (size_t k = 0; k < 6; ++k) {
            along[k] += tangent[c][k] * residual[c];
        }
    }
    for (size_t c = 0; c < components; ++c) {
        for (size_t k = 0; k < 6; ++k) {
            residual[c] -= weighted[c][k] * along[k];
        }
    }
}

void gf_faults(const gf_coils_t *coils, const gf_errors_t *errors, size_t epochs, const double *field_T,
               const double *sigma_T, const double *position_m, const double *rotation, double least_eigenvalue,
               double least_share, const gf_fault_tables_t *out) {
    const size_t n = coils->count;
    for (size_t e = 0; e < epochs; ++e) {
        const double *const field = field_T + 3 * n * e;
        const gf_pose_t pose = pose_of(position_m + 3 * e, rotation + 9 * e);
        around_t around;
        double information[6][6];
        double root[6][6];
        double free[6][6];
        double residual[3 * GF_MOST_COILS];
        prepare(coils, errors, field, sigma_T + n * e, &pose, &around);
        inform(3 * n, around.components.slope, around.weighted, information);
        split((const double(*)[6])information, least_eigenvalue, root, free);
        transform(3 * n, around.components.slope, (const double(*)[6])root, around.components.slope);
        transform(3 * n, around.weighted, (const double(*)[6])root, around.weighted);
        straighten(3 * n, around.components.slope, around.weighted, root);
        compare(coils, errors, field, &around, residual);
        project(3 * n, around.components.slope, around.weighted, residual);
        for (size_t i = 0; i < n; ++i) {
            const fault_t fault = fault_of(residual + 3 * i, around.components.value + 3 * i,
                                           (const double(*)[6])(around.weighted + 3 * i),
                                           (const double(*)[GF_SHARED])(around.whitening.shared + 3 * i),
                                           (const double(*)[6])root, around.whitening.weight + 3 * i, least_share);
            out->drop[n * e + i] = fault.drop;
            out->freedom[n * e + i] = fault.freedom;
            out->scale[n * e + i] = fault.scale;
            out->slope[n * e + i] = fault.slope;
        }
        double column[DISTORTIONS][3 * GF_MOST_COILS];
        distort_all(coils, errors, &pose, &around, column);
        distortions_of(3 * n, residual, column, around.weighted, (const double(*)[GF_SHARED])around.whitening.shared,
                       least_share, out->distortion + 3 * e, out->distortion_freedom + 3 * e);
    }
}

/* q = half the second difference of the model along one principal axis and each other, as a pose error. */
static void curve(const gf_coils_t *coils, const gf_errors_t *errors, const gf_pose_t *pose, const around_t *around,
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
    look(coils, errors, around, &moved, &ahead);
    moved = *pose;
    for (size_t k = 0; k < 6; ++k) {
        step[k] = -step[k];
    }
    for (size_t k = 0; k < 3; ++k) {
        moved.position_m[k] += step[k];
    }
    gf_turn(moved.rotation, step + 3);
    look(coils, errors, around, &moved, &behind);

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

void gf_covariance(const gf_coils_t *coils, const gf_errors_t *errors, size_t epochs, const double *field_T,
                   const double *sigma_T, const double *position_m, const double *rotation, double least_eigenvalue,
                   double free_m2, double free_rad2, double *covariance) {
    const size_t n = coils->count;
    const double free_root[6] = {sqrt(free_m2),   sqrt(free_m2),   sqrt(free_m2),
                                 sqrt(free_rad2), sqrt(free_rad2), sqrt(free_rad2)};
    /* All axes leaning alike are a turn of the sensor: nothing but the attitude tells of it. */
    const double common = errors != NULL ? 0.5 * errors->sensor_axis_sd_rad * errors->sensor_axis_sd_rad : 0.0;
    for (size_t e = 0; e < epochs; ++e) {
        const gf_pose_t pose = pose_of(position_m + 3 * e, rotation + 9 * e);
        around_t around;
        double information[6][6];
        double root[6][6];
        double free[6][6];
        double q[6][6][6];
        double middle[6][6];
        prepare(coils, errors, field_T + 3 * n * e, sigma_T + n * e, &pose, &around);
        inform(3 * n, around.components.slope, around.weighted, information);
        split((const double(*)[6])information, least_eigenvalue, root, free);
        transform(3 * n, around.weighted, (const double(*)[6])root, around.weighted);
        for (size_t axis = 0; axis < 6; ++axis) {
            curve(coils, errors, &pose, &around, (const double(*)[6])root, around.weighted, axis, q[axis]);
        }
        second_order(q, middle);
        double product[6][6];
        transform(6, root, (const double(*)[6])middle, product);
        for (size_t k = 0; k < 6; ++k) {
            for (size_t l = 0; l < 6; ++l) {
                double sum = 0.0;
                for (size_t m = 0; m < 6; ++m) {
                    sum += product[k][m] * root[l][m] + free_root[k] * free_root[l] * free[k][m] * free[l][m];
                }
                covariance[36 * e + 6 * k + l] = sum + (k == l && k >= 3 ? common : 0.0);
            }
        }
    }
}
