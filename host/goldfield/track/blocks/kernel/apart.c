#include "apart.h"

#include <math.h>
#include <stddef.h>

#include "linear.h"

#define POSE   6u
#define MOVED  12u /* Numbers of pose, velocity and turn rate. */
#define ERRORS 18u
#define SMALL2 1e-2 /* Squared angle below which the series' next terms are below 1e-9. */

/* Write the rotation vector of a rotation that is well below half a turn: `rotation_vector` of state.py. */
static void vector_of(const double rotation[9], double vector[3]) {
    vector[0] = 0.5 * (rotation[7] - rotation[5]);
    vector[1] = 0.5 * (rotation[2] - rotation[6]);
    vector[2] = 0.5 * (rotation[3] - rotation[1]);
    const double length = sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]);
    const double cosine = 0.5 * (rotation[0] + rotation[4] + rotation[8] - 1.0);
    const double scale = atan2(length, cosine) / fmax(length, 1e-300);
    for (size_t axis = 0; axis < 3u; axis++) {
        vector[axis] *= scale;
    }
}

/* Write the rotation by a rotation vector: `rotation_of` of state.py. */
static void rotation_of(const double v[3], double rotation[9]) {
    const double angle2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2], angle = sqrt(angle2);
    const double sine = angle2 < SMALL2 ? 1.0 + angle2 * (angle2 / 120.0 - 1.0 / 6.0) : sin(angle) / angle;
    const double versine = angle2 < SMALL2 ? 0.5 + angle2 * (angle2 / 720.0 - 1.0 / 24.0) : (1.0 - cos(angle)) / angle2;
    const double cross[9] = {0.0, -v[2], v[1], v[2], 0.0, -v[0], -v[1], v[0], 0.0};
    for (size_t a = 0; a < 3u; a++) {
        for (size_t b = 0; b < 3u; b++) {
            const double one = a == b ? 1.0 : 0.0;
            rotation[3u * a + b] = one + sine * cross[3u * a + b] + versine * (v[a] * v[b] - one * angle2);
        }
    }
}

static void error_of(const gf_estimate_t *seeing, const gf_estimate_t *alone, double error[MOVED]) {
    double turn[9];
    for (size_t a = 0; a < 3u; a++) {
        error[a] = alone->position[a] - seeing->position[a];
        error[6u + a] = alone->velocity[a] - seeing->velocity[a];
        error[9u + a] = alone->rate[a] - seeing->rate[a];
        for (size_t b = 0; b < 3u; b++) {
            turn[3u * a + b] = 0.0;
            for (size_t k = 0; k < 3u; k++) {
                turn[3u * a + b] += alone->rotation[3u * a + k] * seeing->rotation[3u * b + k];
            }
        }
    }
    vector_of(turn, &error[3]);
}

/* Replace the rows of B by C^-1 B, C C' the matrix of which gf_factor() has made L and, in its diagonal, D^-1. */
static void forward(const double factor[POSE][6], size_t columns, double *b) {
    for (size_t k = 0; k < columns; k++) {
        for (size_t i = 0; i < POSE; i++) {
            for (size_t j = 0; j < i; j++) {
                b[i * columns + k] -= factor[i][j] * b[j * columns + k];
            }
        }
        for (size_t i = 0; i < POSE; i++) {
            b[i * columns + k] *= sqrt(factor[i][i]);
        }
    }
}

bool gf_apart(const gf_estimate_t *seeing, const gf_estimate_t *alone, double least_share, double error[MOVED],
              double *distance2) {
    double own[POSE][6], factor[POSE][6], scaled[POSE][6], turned[POSE][6], vectors[POSE][6], white[POSE];
    error_of(seeing, alone, error);
    for (size_t i = 0; i < POSE; i++) {
        white[i] = error[i];
        for (size_t j = 0; j < POSE; j++) {
            own[i][j] = alone->covariance[ERRORS * i + j];
            scaled[i][j] = seeing->covariance[ERRORS * i + j];
        }
    }
    if (!gf_factor(POSE, (const double(*)[6])own, factor)) {
        return false;
    }
    forward((const double(*)[6])factor, 1u, white);
    forward((const double(*)[6])factor, POSE, &scaled[0][0]);
    for (size_t i = 0; i < POSE; i++) {
        for (size_t j = 0; j < POSE; j++) {
            turned[i][j] = scaled[j][i];
        }
    }
    forward((const double(*)[6])factor, POSE, &turned[0][0]);
    gf_eigen(POSE, turned, vectors);
    *distance2 = 0.0;
    for (size_t k = 0; k < POSE; k++) {
        double along = 0.0;
        for (size_t i = 0; i < POSE; i++) {
            along += vectors[i][k] * white[i];
        }
        *distance2 += along * along / fmax(1.0 - turned[k][k], least_share);
    }
    return true;
}

void gf_between(const gf_estimate_t *seeing, const gf_estimate_t *alone, const double error[MOVED], double weight,
                double *motion, double *covariance) {
    for (size_t i = 0; i < ERRORS; i++) {
        for (size_t j = 0; j < ERRORS; j++) {
            const size_t place = ERRORS * i + j;
            const double first = seeing->covariance[place], one = i < MOVED ? error[i] : 0.0;
            const double second = i < MOVED && j < MOVED     ? alone->covariance[place]
                                  : i >= MOVED && j >= MOVED ? first
                                                             : 0.0;
            const double other = j < MOVED ? error[j] : 0.0;
            covariance[place] = (1.0 - weight) * first + weight * second + weight * (1.0 - weight) * one * other;
        }
    }
    const double turned[3] = {weight * error[3], weight * error[4], weight * error[5]};
    double turn[9];
    rotation_of(turned, turn);
    for (size_t a = 0; a < 3u; a++) {
        motion[a] = seeing->position[a] + weight * error[a];
        motion[12u + a] = seeing->velocity[a] + weight * error[6u + a];
        motion[15u + a] = seeing->rate[a] + weight * error[9u + a];
        for (size_t b = 0; b < 3u; b++) {
            motion[3u + 3u * a + b] = 0.0;
            for (size_t k = 0; k < 3u; k++) {
                motion[3u + 3u * a + b] += turn[3u * a + k] * seeing->rotation[3u * k + b];
            }
        }
    }
}
