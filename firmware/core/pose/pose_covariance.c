#include "core/pose/pose_covariance.h"

#include <string.h>

#include "core/math/quaternion.h"

#define N      TRIANGLE_UNKNOWNS
#define BEYOND 1e12f /* Largest variance, m^2: a position within a thousand kilometres is no knowledge. */

typedef float square_t[N][N];
typedef float second_t[N][N][N]; /* [axis][unknown i][component k along the ridge's own axes] */

/* Multiplies rows by L, which is upper triangular. */
static void principal(const float rows[3][TRIANGLE_COLUMNS], const square_t l, float result[3][N]) {
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < N; column++) {
            float sum = 0.0f;
            for (uint32_t k = 0; k <= column; k++) {
                sum += rows[row][k] * l[k][column];
            }
            result[row][column] = sum;
        }
    }
}

/* Computes the rows at the pose moved by sign times a column of L. turn is the rotation of that column: seen in a
 * frame that turns with the sensor the noise stays as it is. */
static void moved(const pose_heard_t *heard, const pose_fit_t *fit, const square_t l, uint32_t axis, float sign,
                  const float turn[3][3], triangle_rows_t back) {
    float position[3], field[3];
    triangle_rows_t rows;
    for (uint32_t i = 0; i < 3u; i++) {
        position[i] = fit->position_m[i] + sign * l[i][axis];
    }
    pose_fit_model(heard, position, rows, field);
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < N; column++) {
            back[row][column] = turn[0][row] * rows[0][column] + turn[1][row] * rows[1][column] +
                                turn[2][row] * rows[2][column];
        }
    }
    for (uint32_t column = 0; column < N; column++) {
        pose_weights_whiten(heard, &back[0][column], &back[1][column], &back[2][column]);
    }
}

/* Computes the rotations by the turn in each column of L, or with sign -1 the opposite ones. */
static void turns_of(const square_t l, float sign, float turns[N][3][3]) {
    for (uint32_t axis = 0; axis < N; axis++) {
        const float turn[3] = {sign * l[3][axis], sign * l[4][axis], sign * l[5][axis]};
        float quaternion[4] = {0.0f, 0.0f, 0.0f, 1.0f};
        quaternion_turn(quaternion, turn);
        quaternion_matrix(quaternion, turns[axis]);
    }
}

/* Adds one beacon's part to q. rows are its own, without what the sensor's errors explain. */
static void add_beacon(const pose_heard_t *heard, const pose_fit_t *fit, const float rows[3][TRIANGLE_COLUMNS],
                       const square_t l, const float there[N][3][3], const float opposite[N][3][3], second_t q) {
    triangle_rows_t ahead, behind;
    float along[3][N], change[3][N];
    principal(rows, l, along);
    for (uint32_t axis = 0; axis < N; axis++) {
        moved(heard, fit, l, axis, 1.0f, there[axis], ahead);
        moved(heard, fit, l, axis, -1.0f, opposite[axis], behind);
        for (uint32_t row = 0; row < 3u; row++) {
            for (uint32_t column = 0; column < N; column++) {
                ahead[row][column] = 0.5f * (ahead[row][column] - behind[row][column]);
            }
        }
        principal((const float(*)[TRIANGLE_COLUMNS])ahead, l, change);
        for (uint32_t i = 0; i < N; i++) {
            for (uint32_t k = 0; k < N; k++) {
                q[axis][i][k] += change[0][i] * along[0][k] + change[1][i] * along[1][k] + change[2][i] * along[2][k];
            }
        }
    }
}

/* Computes I + (m m' + 2 sum q q') / 4, with q made symmetric in axis and unknown. */
static void inflation(second_t q, square_t result) {
    float mean[N] = {0};
    for (uint32_t a = 0; a < N; a++) {
        for (uint32_t i = 0; i < a; i++) {
            for (uint32_t k = 0; k < N; k++) {
                q[a][i][k] = q[i][a][k] = 0.5f * (q[a][i][k] + q[i][a][k]);
            }
        }
        for (uint32_t k = 0; k < N; k++) {
            mean[k] += q[a][a][k];
        }
    }
    for (uint32_t k = 0; k < N; k++) {
        for (uint32_t m = 0; m <= k; m++) {
            float sum = 0.0f;
            for (uint32_t a = 0; a < N; a++) {
                for (uint32_t i = 0; i < N; i++) {
                    sum += q[a][i][k] * q[a][i][m];
                }
            }
            result[k][m] = result[m][k] = (k == m ? 1.0f : 0.0f) + 0.25f * (mean[k] * mean[m] + 2.0f * sum);
        }
    }
}

/* Computes L inner L' with turn_rad2 on the variances of the attitude. Returns whether it is any knowledge. */
static bool sandwich(const square_t l, const square_t inner, float turn_rad2, square_t covariance) {
    square_t half;
    bool told = true;
    for (uint32_t row = 0; row < N; row++) {
        for (uint32_t column = 0; column < N; column++) {
            float sum = 0.0f;
            for (uint32_t k = row; k < N; k++) {
                sum += l[row][k] * inner[k][column];
            }
            half[row][column] = sum;
        }
    }
    for (uint32_t row = 0; row < N; row++) {
        for (uint32_t column = 0; column < N; column++) {
            float sum = 0.0f;
            for (uint32_t k = column; k < N; k++) {
                sum += half[row][k] * l[column][k];
            }
            covariance[row][column] = sum + (row == column && row >= 3u ? turn_rad2 : 0.0f);
        }
        /* The comparisons are false for what is not a number. */
        told = told && covariance[row][row] > 0.0f && covariance[row][row] < BEYOND;
    }
    return told;
}

bool pose_covariance(pose_problem_t *problem, const pose_fit_t *fit, square_t covariance) {
    square_t l, inner;
    if (!triangle_invert(&fit->triangle, l)) {
        return false;
    }
    float there[N][3][3], opposite[N][3][3], attitude[3][3];
    turns_of((const float(*)[N])l, 1.0f, there);
    turns_of((const float(*)[N])l, -1.0f, opposite);
    second_t q;
    memset(q, 0, sizeof q);
    quaternion_matrix(fit->quaternion, attitude);
    pose_weights_at(problem, fit->position_m);
    for (uint32_t i = 0; i < problem->count; i++) {
        const pose_heard_t *heard = &problem->heard[i];
        triangle_rows_t rows;
        float effects[3][NUISANCE_UNKNOWNS], field[3];
        pose_fit_rows(problem, heard, fit->position_m, (const float(*)[3])attitude, rows, effects, field);
        nuisance_predict(&fit->sensor, effects, rows);
        add_beacon(heard, fit, (const float(*)[TRIANGLE_COLUMNS])rows, (const float(*)[N])l,
                   (const float(*)[3][3])there, (const float(*)[3][3])opposite, q);
    }
    inflation(q, inner);
    /* All axes that lean alike are a turn of the sensor: nothing but the attitude tells of it. */
    return sandwich((const float(*)[N])l, (const float(*)[N])inner, 0.5f * problem->axis_sd_rad * problem->axis_sd_rad,
                    covariance);
}
