#include "core/pose/pose_faults.h"

#include <string.h>

#include "core/math/chi_square.h"
#include "core/math/quaternion.h"
#include "core/math/roots.h"
#include "core/math/vector3.h"

#define N               TRIANGLE_UNKNOWNS
#define ALL             (N + NUISANCE_UNKNOWNS) /* Pose, then the sensor's errors. */
#define WHOLE_DEVIATE   3.81f                   /* Normal deviate of the whole cost's share of the false alarms. */
#define LIMIT_BEACON    25.34f                  /* Chi-squares of the others' shares, as pose_faults.h lists them. */
#define LIMIT_STRENGTH  19.77f
#define LIMIT_COMMON    14.50f
#define LIMIT_AXES      21.85f
#define LIMIT_SKEWED    28.68f
#define ROUNDING_MARGIN 0.3f  /* Variance of a direction that is tested, over that of the bound on rounding. */
#define ENDLESS         1e30f /* Level if a fault cannot show. */
#define MISSED          3.09f /* Normal deviate of POSE_FAULTS_MISSED. */
#define UNLUCKY         5.20f /* Normal deviate of POSE_FAULTS_UNLUCKY. */

typedef float square_t[N][N];

/* Sums for changes of the sensor's gains: one strength, two differences of its axes, three skews. */
typedef struct {
    square_t information; /* Gains by gains, and gains by what is fitted (in units of its uncertainty). */
    float cross[N][ALL];
    float score[N];
} gains_t;

/* One beacon at the fit: whitened residuals after the fit, its rows in units of the uncertainty of all that is fitted,
 * and its field, as the model has it, in the site's frame. */
typedef struct {
    float r[3], tangent[3][ALL], field_uT[3];
} seen_t;

/* How the first three changes act on the three axes. */
static const float DIAGONALS[3][3] = {{0.57735027f, 0.57735027f, 0.57735027f},
                                      {0.70710678f, -0.70710678f, 0.0f},
                                      {0.40824829f, 0.40824829f, -0.81649658f}};

/* Computes how the six changes, symmetric matrices, act on a field in the sensor's frame. */
static void changed(const float b[3], float columns[N][3]) {
    const float skews[3][3] = {{0.0f, b[2], b[1]}, {b[2], 0.0f, b[0]}, {b[1], b[0], 0.0f}};
    for (uint32_t axis = 0; axis < 3u; axis++) {
        for (uint32_t a = 0; a < 3u; a++) {
            columns[a][axis] = DIAGONALS[a][axis] * b[axis];
            columns[3u + a][axis] = skews[a][axis];
        }
    }
}

/* Computes a 3 x 3 Cholesky factor in place, in the lower triangle. Directions with less than least of variance get a
 * diagonal of 0. Returns whether there are none. */
static bool factor(float s[3][3], float least) {
    bool shown = true;
    for (uint32_t j = 0; j < 3u; j++) {
        float pivot = s[j][j];
        for (uint32_t k = 0; k < j; k++) {
            pivot -= s[j][k] * s[j][k];
        }
        const bool seen = pivot > least;
        shown = shown && seen;
        s[j][j] = seen ? square_root(pivot) : 0.0f;
        for (uint32_t i = j + 1u; i < 3u; i++) {
            float sum = s[i][j];
            for (uint32_t k = 0; k < j; k++) {
                sum -= s[i][k] * s[j][k];
            }
            s[i][j] = seen ? sum / s[j][j] : 0.0f;
        }
    }
    return shown;
}

/* Solves G x = y in place, G the factor, with 0 in the directions left out. */
static void forward(const float g[3][3], float x[3]) {
    for (uint32_t i = 0; i < 3u; i++) {
        float sum = x[i];
        for (uint32_t k = 0; k < i; k++) {
            sum -= g[i][k] * x[k];
        }
        x[i] = g[i][i] > 0.0f ? sum / g[i][i] : 0.0f;
    }
}

/* Returns the length that a normal vector exceeds with the probability of a normal deviate: its square taken for a
 * chi-square, scaled and shifted, of the same first three cumulants. */
static float radius(const float mean[3], const float covariance[3][3], float deviate) {
    const float size = vector3_dot(mean, mean) + covariance[0][0] + covariance[1][1] + covariance[2][2];
    float part[3][3], along[3], second = 0.0f, third = 0.0f; /* All over the size, or squares would underflow. */
    for (uint32_t i = 0; i < 3u; i++) {
        along[i] = vector3_dot(covariance[i], mean) / size;
        for (uint32_t j = 0; j < 3u; j++) {
            part[i][j] = covariance[i][j] / size;
        }
    }
    for (uint32_t i = 0; i < 3u; i++) {
        second += 2.0f * mean[i] * along[i] / size;
        third += 3.0f * along[i] * along[i] / size;
        for (uint32_t j = 0; j < 3u; j++) {
            second += part[i][j] * part[i][j];
            third += part[i][j] * vector3_dot(part[i], part[j]);
        }
    }
    const float freedom = second * second * second / (third * third);
    const float above = chi_square_limit(freedom, deviate) - freedom;
    return square_root(size * (1.0f + square_root(second / freedom) * above));
}

/* Adds one beacon's part to the sums for the sensor's gains. */
static void add_gains(const pose_heard_t *heard, const seen_t *seen, const float attitude[3][3], gains_t *gains) {
    float sensor[3], columns[N][3], site[N][3];
    for (uint32_t axis = 0; axis < 3u; axis++) {
        sensor[axis] = attitude[0][axis] * seen->field_uT[0] + attitude[1][axis] * seen->field_uT[1] +
                       attitude[2][axis] * seen->field_uT[2];
    }
    changed(sensor, columns);
    for (uint32_t a = 0; a < N; a++) {
        for (uint32_t axis = 0; axis < 3u; axis++) {
            site[a][axis] = vector3_dot(attitude[axis], columns[a]);
        }
        pose_weights_whiten(heard, &site[a][0], &site[a][1], &site[a][2]);
        gains->score[a] += vector3_dot(site[a], seen->r);
        for (uint32_t k = 0; k < ALL; k++) {
            gains->cross[a][k] += site[a][0] * seen->tangent[0][k] + site[a][1] * seen->tangent[1][k] +
                                  site[a][2] * seen->tangent[2][k];
        }
        for (uint32_t b = 0; b <= a; b++) {
            gains->information[a][b] += vector3_dot(site[a], site[b]);
        }
    }
}

/* Returns whether another strength, other gains or skewed axes would take away more of the cost than chance does. */
static bool gains_alarm(gains_t *gains, float least) {
    float drop = 0.0f;
    bool alarm = false;
    for (uint32_t a = 0; a < N; a++) {
        const float all = gains->information[a][a];
        for (uint32_t b = 0; b <= a; b++) {
            float sum = gains->information[a][b];
            for (uint32_t k = 0; k < ALL; k++) {
                sum -= gains->cross[a][k] * gains->cross[b][k];
            }
            for (uint32_t k = 0; k < b; k++) {
                sum -= gains->information[a][k] * gains->information[b][k];
            }
            const float diagonal = gains->information[b][b];
            gains->information[a][b] = a == b            ? (sum > least * all ? square_root(sum) : 0.0f)
                                       : diagonal > 0.0f ? sum / diagonal
                                                         : 0.0f;
        }
        float score = gains->score[a];
        for (uint32_t k = 0; k < a; k++) {
            score -= gains->information[a][k] * gains->score[k];
        }
        const float pivot = gains->information[a][a];
        gains->score[a] = pivot > 0.0f ? score / pivot : 0.0f;
        drop += gains->score[a] * gains->score[a];
        /* The sum only grows: what is beyond the limit before all of a test's changes are in is so with them, too. */
        alarm = alarm || drop > (a == 0u ? LIMIT_COMMON : a <= 2u ? LIMIT_AXES : LIMIT_SKEWED);
    }
    return alarm;
}

/* Computes the gains that take away most of the cost, after gains_alarm. */
static void best_gains(const gains_t *gains, float gain[3]) {
    float change[3] = {0};
    for (uint32_t a = 3; a-- > 0u;) {
        float sum = gains->score[a];
        for (uint32_t b = a + 1u; b < 3u; b++) {
            sum -= gains->information[b][a] * change[b];
        }
        change[a] = gains->information[a][a] > 0.0f ? sum / gains->information[a][a] : 0.0f;
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        gain[axis] = DIAGONALS[0][axis] * change[0] + DIAGONALS[1][axis] * change[1] + DIAGONALS[2][axis] * change[2];
    }
}

/* Computes S_i = 1 - T T', and what the whitened components do to the position, a row for each of its axes. */
static void spread_and_influence(const seen_t *seen, const square_t l, float s[3][3], float influence[3][3]) {
    for (uint32_t i = 0; i < 3u; i++) {
        for (uint32_t j = 0; j < 3u; j++) {
            float sum = i == j ? 1.0f : 0.0f, moves = 0.0f;
            for (uint32_t k = 0; k < ALL; k++) {
                sum -= seen->tangent[i][k] * seen->tangent[j][k];
            }
            for (uint32_t k = 0; k < N; k++) {
                moves += l[i][k] * seen->tangent[j][k];
            }
            s[i][j] = sum;
            influence[i][j] = moves;
        }
    }
}

/* Tests one beacon. covariance is that of the position; *drop becomes what leaving the beacon out would take away of
 * the cost. */
static void test_beacon(const pose_heard_t *heard, const seen_t *seen, const square_t l, const float covariance[3][3],
                        float least, float *drop, pose_faults_t *faults) {
    float s[3][3], e[3], influence[3][3], separation[3], without[3][3];
    float modelled[3] = {seen->field_uT[0], seen->field_uT[1], seen->field_uT[2]};
    pose_weights_whiten(heard, &modelled[0], &modelled[1], &modelled[2]);
    spread_and_influence(seen, l, s, influence);
    float spread = 0.0f;
    for (uint32_t i = 0; i < 3u; i++) {
        spread += modelled[i] * vector3_dot(s[i], modelled);
    }
    const float along = vector3_dot(modelled, seen->r);
    if (spread > least * vector3_dot(modelled, modelled) && along * along > LIMIT_STRENGTH * spread) {
        faults->alarm = true;
    }
    const bool shown = factor(s, least);
    memcpy(e, seen->r, sizeof e);
    forward((const float(*)[3])s, e);
    *drop = vector3_dot(e, e);
    faults->alarm = faults->alarm || *drop > LIMIT_BEACON;
    for (uint32_t i = 0; i < 3u; i++) {
        forward((const float(*)[3])s, influence[i]);
    }
    for (uint32_t i = 0; i < 3u; i++) {
        separation[i] = vector3_dot(influence[i], e);
        for (uint32_t j = 0; j < 3u; j++) {
            without[i][j] = covariance[i][j] + vector3_dot(influence[i], influence[j]);
        }
    }
    const float level = shown ? radius(separation, (const float(*)[3])without, MISSED) : ENDLESS;
    faults->level_m = level > faults->level_m ? level : faults->level_m;
}

/* Looks at one beacon: see seen_t. */
static void look(const pose_problem_t *problem, const pose_heard_t *heard, const pose_fit_t *fit,
                 const float attitude[3][3], const square_t l, seen_t *seen) {
    triangle_rows_t rows;
    float effects[3][NUISANCE_UNKNOWNS];
    pose_fit_rows(problem, heard, fit->position_m, attitude, rows, effects, seen->field_uT);
    nuisance_predict(&fit->sensor, effects, rows);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        seen->r[axis] = rows[axis][N];
        for (uint32_t column = 0; column < N; column++) {
            float sum = 0.0f;
            for (uint32_t k = 0; k <= column; k++) {
                sum += rows[axis][k] * l[k][column];
            }
            seen->tangent[axis][column] = sum;
            seen->r[axis] -= sum * fit->triangle.r[column][N]; /* What one more step would take away. */
        }
        memcpy(&seen->tangent[axis][N], effects[axis], sizeof effects[axis]);
    }
}

bool pose_faults(pose_problem_t *problem, const pose_fit_t *fit, pose_faults_t *faults) {
    square_t l;
    float attitude[3][3], covariance[3][3];
    if (!triangle_invert(&fit->triangle, l)) {
        return false;
    }
    gains_t gains;
    memset(&gains, 0, sizeof gains);
    quaternion_matrix(fit->quaternion, attitude);
    pose_weights_at(problem, fit->position_m);
    const float least = POSE_FAULTS_SHOWN + ROUNDING_MARGIN * fit->rounding * fit->rounding;
    faults->alarm = !(fit->cost <= chi_square_limit((float)pose_problem_freedom(problem), WHOLE_DEVIATE));
    for (uint32_t i = 0; i < 3u; i++) {
        for (uint32_t j = 0; j < 3u; j++) {
            covariance[i][j] = 0.0f;
            for (uint32_t k = 0; k < N; k++) {
                covariance[i][j] += l[i][k] * l[j][k];
            }
        }
    }
    const float none[3] = {0};
    faults->level_m = radius(none, (const float(*)[3])covariance, UNLUCKY);
    for (uint32_t i = 0; i < problem->count; i++) {
        const pose_heard_t *heard = &problem->heard[i];
        seen_t seen;
        look(problem, heard, fit, (const float(*)[3])attitude, (const float(*)[N])l, &seen);
        add_gains(heard, &seen, (const float(*)[3])attitude, &gains);
        test_beacon(heard, &seen, (const float(*)[N])l, (const float(*)[3])covariance, least, &faults->drop[i], faults);
    }
    faults->alarm = gains_alarm(&gains, least) || faults->alarm;
    best_gains(&gains, faults->gain);
    return true;
}
