#include <math.h>
#include <string.h>

#include "around.h"
#include "linear.h"

/* With a determinant of so many times the least share no eigenvalue of a covariance is near that share. */
#define WELL_SHOWN 1e3

typedef struct {
    double drop;
    double scale;
    int32_t freedom;
    double separation[3];
    double spread[3][3];
} fault_t;

/* One beacon: its residuals, the modelled components and the model's derivatives T along the principal axes of the
 * pose's error (tangent), all over the standard deviations. Residuals and T are weighted for what all components share,
 * which takes V V' (shared) from their covariance 1 - T T', too. The first three rows of root take the principal axes
 * to the position. */
typedef struct {
    const double *residual;
    const double *modelled;
    const double (*tangent)[6];
    const double (*root)[6];
    double covariance[3][6];
} beacon_t;

static void enter_covariance(const double shared[3][GF_SHARED], const double measured[3], beacon_t *beacon) {
    for (size_t i = 0; i < 3; ++i) {
        for (size_t j = 0; j < 3; ++j) {
            double sum = i == j && measured[i] > 0.0 ? 1.0 : 0.0;
            for (size_t k = 0; k < 6; ++k) {
                sum -= beacon->tangent[i][k] * beacon->tangent[j][k];
            }
            for (size_t k = 0; k < GF_SHARED; ++k) {
                sum -= shared[i][k] * shared[j][k];
            }
            beacon->covariance[i][j] = sum;
        }
    }
}

/* Add one of three independent parts of the residuals: along a vector that has the variance gain. A unit of it, over
 * its deviation, moves the position by a column; their sums are the separation from the pose without the beacon. */
static void add_part(const beacon_t *beacon, const double vector[3], double gain, fault_t *fault) {
    double move[3] = {0.0};
    double r = 0.0;
    double along[6] = {0.0};
    const double unit = 1.0 / sqrt(gain);
    for (size_t c = 0; c < 3; ++c) {
        r += vector[c] * beacon->residual[c];
        for (size_t l = 0; l < 6; ++l) {
            along[l] += unit * vector[c] * beacon->tangent[c][l];
        }
    }
    for (size_t i = 0; i < 3; ++i) {
        for (size_t l = 0; l < 6; ++l) {
            move[i] += beacon->root[i][l] * along[l];
        }
    }
    fault->drop += r * r / gain;
    fault->freedom += 1;
    for (size_t i = 0; i < 3; ++i) {
        fault->separation[i] += unit * r * move[i];
        for (size_t j = 0; j < 3; ++j) {
            fault->spread[i][j] += move[i] * move[j];
        }
    }
}

/* The part of the cost that another strength takes away. */
static double scale_of(const beacon_t *beacon, double least_share) {
    double along_field = 0.0;
    double shown = 0.0;
    double strength2 = 0.0;
    for (size_t i = 0; i < 3; ++i) {
        const double s = beacon->modelled[i];
        along_field += s * beacon->residual[i];
        strength2 += s * s;
        for (size_t j = 0; j < 3; ++j) {
            shown += s * beacon->covariance[i][j] * beacon->modelled[j];
        }
    }
    return shown > least_share * strength2 ? along_field * along_field / shown : 0.0;
}

/* Split the covariance, whose eigenvalues are 1 at most, into its independent parts: by elimination, where its
 * determinant says that all of them show, else by its eigenvectors, those that show. */
static fault_t fault_of(beacon_t *beacon, double least_share) {
    fault_t fault = {.scale = scale_of(beacon, least_share)};
    const double(*const c)[6] = (const double(*)[6])beacon->covariance;
    const double l10 = c[1][0] / c[0][0];
    const double l20 = c[2][0] / c[0][0];
    const double pivot1 = c[1][1] - l10 * c[1][0];
    const double l21 = (c[2][1] - l20 * c[1][0]) / pivot1;
    const double pivot2 = c[2][2] - l20 * c[2][0] - l21 * l21 * pivot1;
    if (c[0][0] > 0.0 && pivot1 > 0.0 && c[0][0] * pivot1 * pivot2 > WELL_SHOWN * least_share) {
        const double by[3][3] = {{1.0, 0.0, 0.0}, {-l10, 1.0, 0.0}, {l21 * l10 - l20, -l21, 1.0}};
        add_part(beacon, by[0], c[0][0], &fault);
        add_part(beacon, by[1], pivot1, &fault);
        add_part(beacon, by[2], pivot2, &fault);
        return fault;
    }
    double vector[3][6];
    gf_eigen(3, beacon->covariance, vector);
    for (size_t k = 0; k < 3; ++k) {
        if (beacon->covariance[k][k] > least_share) {
            const double by[3] = {vector[0][k], vector[1][k], vector[2][k]};
            add_part(beacon, by, beacon->covariance[k][k], &fault);
        }
    }
    return fault;
}

/* Measured minus modelled components, weighted. */
static void compare(const gf_coils_t *coils, const gf_errors_t *errors, const double *field_T,
                    const gf_around_t *around, double *residual) {
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

/* The largest part of the cost that the gain of one axis takes away; its degrees of freedom, 1 or 0. The gain of one
 * axis is a sum of the one gain and the two differences of gains; square2 is the square of the one gain's column, which
 * what shows of an axis is held against: an axis that is not there leaves rounding only. */
static double largest_of_axes(const double shown[DISTORTIONS][DISTORTIONS], const double along[DISTORTIONS],
                              double square2, double least_share, int32_t *freedom) {
    static const double axes[3][3] = {
        {1.0 / 3.0, 0.5, 1.0 / 6.0}, {1.0 / 3.0, -0.5, 1.0 / 6.0}, {1.0 / 3.0, 0.0, -1.0 / 3.0}};
    double largest = 0.0;
    *freedom = 0;
    for (size_t axis = 0; axis < 3; ++axis) {
        double product = 0.0;
        double left = 0.0;
        for (size_t k = 0; k < 3; ++k) {
            product += axes[axis][k] * along[k];
            for (size_t l = 0; l < 3; ++l) {
                left += axes[axis][k] * axes[axis][l] * shown[k][l];
            }
        }
        if (left > least_share * square2) {
            largest = fmax(largest, product * product / left);
            *freedom = 1;
        }
    }
    return largest;
}

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
                        const gf_around_t *around, double column[DISTORTIONS][3 * GF_MOST_COILS]) {
    const size_t n = coils->count;
    const double *const weight = around->whitening.weight;
    double whole[3 * GF_MOST_COILS]; /* as if all components had been measured: a distortion mixes them */
    gf_components_t plain;           /* weighted, not whitened: the components of one beacon have one weight */
    const double *value = around->components.value;
    bool complete = errors == NULL;
    for (size_t c = 0; c < 3 * n; ++c) {
        const double *const of_one = weight + 3 * (c / 3);
        whole[c] = fmax(of_one[0], fmax(of_one[1], of_one[2]));
        complete = complete && whole[c] <= weight[c];
    }
    if (!complete) {
        gf_components(coils, pose, whole, &plain);
        value = plain.value;
    }
    for (size_t i = 0; i < n; ++i) {
        double one[3][DISTORTIONS];
        distort(value + 3 * i, weight + 3 * i, one);
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
                           double tangent[][6], const gf_whitening_t *whitening, double least_share, double drop[4],
                           int32_t freedom[4]) {
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
            }
        }
    }
    for (size_t k = 0; k < DISTORTIONS && whitening->is_shared; ++k) {
        for (size_t c = 0; c < components; ++c) {
            for (size_t l = 0; l < GF_SHARED; ++l) {
                spread[k][l] += column[k][c] * whitening->shared[c][l];
            }
        }
    }
    for (size_t k = 0; k < DISTORTIONS; ++k) {
        for (size_t l = 0; l <= k; ++l) {
            double sum = 0.0;
            for (size_t c = 0; c < components; ++c) {
                sum += column[k][c] * column[l][c];
            }
            for (size_t m = 0; m < GF_SHARED; ++m) {
                sum -= spread[k][m] * spread[l][m];
            }
            square[k] = sum; /* at last that with itself */
            for (size_t m = 0; m < 6; ++m) {
                sum -= explained[k][m] * explained[l][m];
            }
            shown[k][l] = shown[l][k] = sum;
        }
    }
    drop[3] = largest_of_axes((const double(*)[DISTORTIONS])shown, along, square[0], least_share, &freedom[3]);
    eliminate(shown, along, square, least_share, drop, freedom);
}

/* Make the tangents orthonormal to the last digit, which the eigenvalues of an ill-conditioned information do not, and
 * carry the change into the root: one Newton step, times (3 - T'W)/2, T whitened and W weighted besides. */
static void straighten(size_t components, double tangent[][6], double weighted[][6], double root[6][6]) {
    double by[6][6];
    gf_inform(components, tangent, weighted, by);
    for (size_t k = 0; k < 6; ++k) {
        for (size_t l = 0; l < 6; ++l) {
            by[k][l] = (k == l ? 1.5 : 0.0) - 0.5 * by[k][l];
        }
    }
    gf_transform(components, tangent, (const double(*)[6])by, tangent);
    gf_transform(components, weighted, (const double(*)[6])by, weighted);
    gf_transform(6, root, (const double(*)[6])by, root);
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
        const gf_pose_t pose = gf_pose_of(position_m + 3 * e, rotation + 9 * e);
        gf_around_t around;
        double information[6][6];
        double root[6][6];
        double free[6][6];
        double residual[3 * GF_MOST_COILS];
        gf_look_around(coils, errors, field, sigma_T + n * e, &pose, &around);
        gf_inform(3 * n, around.components.slope, around.weighted, information);
        gf_split((const double(*)[6])information, least_eigenvalue, root, free);
        gf_transform(3 * n, around.components.slope, (const double(*)[6])root, around.components.slope);
        gf_transform(3 * n, around.weighted, (const double(*)[6])root, around.weighted);
        straighten(3 * n, around.components.slope, around.weighted, root);
        compare(coils, errors, field, &around, residual);
        project(3 * n, around.components.slope, around.weighted, residual);
        for (size_t i = 0; i < n; ++i) {
            beacon_t beacon = {.residual = residual + 3 * i,
                               .modelled = around.components.value + 3 * i,
                               .tangent = (const double(*)[6])(around.weighted + 3 * i),
                               .root = (const double(*)[6])root};
            enter_covariance((const double(*)[GF_SHARED])(around.whitening.shared + 3 * i),
                             around.whitening.weight + 3 * i, &beacon);
            const fault_t fault = fault_of(&beacon, least_share);
            out->drop[n * e + i] = fault.drop;
            out->freedom[n * e + i] = fault.freedom;
            out->scale[n * e + i] = fault.scale;
            memcpy(out->separation_m + 3 * (n * e + i), fault.separation, sizeof fault.separation);
            memcpy(out->separation_cov_m2 + 9 * (n * e + i), fault.spread, sizeof fault.spread);
        }
        double column[DISTORTIONS][3 * GF_MOST_COILS];
        distort_all(coils, errors, &pose, &around, column);
        distortions_of(3 * n, residual, column, around.weighted, &around.whitening, least_share,
                       out->distortion + 4 * e, out->distortion_freedom + 4 * e);
    }
}
