#include "rest.h"

#include <math.h>
#include <string.h>

#include "dense.h"

#define ERRORS   18u  /* What is off of a motion: position, rotation, velocity, turn rate, ambient field, offset. */
#define SEEN     9u   /* Those of them that fields depend on, columns of a jacobian. */
#define MOVING   6u   /* Position and rotation, or velocity and turn rate. */
#define ROUNDING 1e-9 /* A scale below this part of the largest is none: `PIVOT` of equations.py. */

/* Write fields, how fast they change, and derivatives, as `reference` of update.py does. */
static void refer(const gf_moving_t *moving, double *fields, double *slope, double *jacobian) {
    const size_t n = moving->beacons;
    memset(jacobian, 0, sizeof(double) * (n + 1u) * 3u * SEEN);
    for (size_t i = 0; i <= n; i++) {
        double *const field = &fields[3u * i], (*const rows)[SEEN] = (double(*)[SEEN]) & jacobian[i * 3u * SEEN];
        for (size_t a = 0; a < 3u; a++) {
            field[a] = i < n ? moving->field[a * n + i] : moving->ambient[a];
            for (size_t b = 0; i < n && b < 3u; b++) {
                rows[a][b] = moving->gradient[(3u * a + b) * n + i];
            }
            rows[a][6u + a] = i < n ? 0.0 : 1.0;
        }
        rows[0][4] = -field[2];
        rows[0][5] = field[1];
        rows[1][3] = field[2];
        rows[1][5] = -field[0];
        rows[2][3] = -field[1];
        rows[2][4] = field[0];
        for (size_t a = 0; a < 3u; a++) {
            double sum = 0.0;
            for (size_t b = 0; b < 3u; b++) {
                sum += rows[a][b] * moving->velocity[b] + rows[a][3u + b] * moving->rate[b];
            }
            slope[3u * i + a] = sum;
        }
    }
    for (size_t a = 0; a < 3u; a++) {
        for (size_t b = 0; b < 3u; b++) {
            fields[3u * n + a] += moving->rotation[3u * a + b] * moving->offset[b];
        }
    }
}

/* Returns a third of the variance that errors, whose covariance begins at a place of the whole one, give a field. */
static double variance_of(const double *jacobian, const double *covariance) {
    double sum = 0.0;
    for (size_t axis = 0; axis < 3u; axis++) {
        const double *const row = &jacobian[SEEN * axis];
        for (size_t p = 0; p < MOVING; p++) {
            double through = 0.0;
            for (size_t q = 0; q < MOVING; q++) {
                through += covariance[ERRORS * p + q] * row[q];
            }
            sum += row[p] * through;
        }
    }
    return sum / 3.0;
}

/* Write what errors that change from block to block leak from field to field: `_blur` of rest.py. */
static void leak(const gf_moving_t *moving, const gf_block_sums_t *block, const double *jacobian, double *memory,
                 double *blur) {
    const size_t n = moving->beacons, columns = n + 1u;
    double *const still = memory, *const drifting = &memory[columns];
    for (size_t i = 0; i < columns; i++) {
        still[i] = variance_of(&jacobian[i * 3u * SEEN], moving->covariance);
        drifting[i] = variance_of(&jacobian[i * 3u * SEEN], &moving->covariance[(size_t)MOVING * (ERRORS + 1u)]);
    }
    const double *const last_gram = &block->gram[n * columns], *const last_moment = &block->moment[n * columns];
    for (size_t i = 0; i < n; i++) {
        const double share = block->gram[i * columns + n] / last_gram[n];
        double sum = 0.0;
        for (size_t j = 0; j < columns; j++) {
            const double leaks = i == j ? 0.0 : block->gram[i * columns + j] - share * last_gram[j];
            const double slopes = block->moment[i * columns + j] - share * last_moment[j];
            sum += leaks * leaks * still[j] + slopes * slopes * drifting[j];
        }
        blur[i] = sum;
    }
}

void gf_rest(const gf_moving_t *moving, const gf_block_sums_t *block, double *memory, double *fields, double *slope,
             double *jacobian, double *left, double *blur) {
    const size_t columns = moving->beacons + 1u;
    const double *const rotation = moving->rotation;
    refer(moving, fields, slope, jacobian);
    for (size_t i = 0; i < columns; i++) {
        double expected[3] = {0.0, 0.0, 0.0};
        for (size_t j = 0; j < columns; j++) {
            for (size_t a = 0; a < 3u; a++) {
                expected[a] += block->gram[i * columns + j] * fields[3u * j + a] +
                               block->moment[i * columns + j] * slope[3u * j + a];
            }
        }
        for (size_t a = 0; a < 3u; a++) {
            double seen = 0.0;
            for (size_t b = 0; b < 3u; b++) {
                seen += rotation[3u * b + a] * expected[b];
            }
            left[3u * i + a] = block->sums[3u * i + a] - seen;
        }
    }
    leak(moving, block, jacobian, memory, blur);
}

size_t gf_cost_memory(size_t beacons) {
    return beacons * (2u * beacons + 2u * beacons + 5u);
}

/* Add up the beacons' normal matrix and right sides, each block with an ambient field of its own. */
static void add_up(size_t blocks, size_t n, const double *gram, const double *sums, double *normal, double *right) {
    const size_t columns = n + 1u;
    memset(normal, 0, sizeof(double) * n * n);
    memset(right, 0, sizeof(double) * n * 3u);
    for (size_t block = 0; block < blocks; block++) {
        const double *const all = &gram[block * columns * columns], *const sum = &sums[block * columns * 3u];
        const double *const last = &all[n * columns];
        for (size_t i = 0; i < n; i++) {
            const double share = all[i * columns + n] / last[n];
            for (size_t j = 0; j < n; j++) {
                normal[i * n + j] += all[i * columns + j] - share * last[j];
            }
            for (size_t a = 0; a < 3u; a++) {
                right[3u * i + a] += sum[3u * i + a] - share * sum[3u * n + a];
            }
        }
    }
}

/* Write which beacons are heard, by their numbers, with the roots of their diagonal; returns how many. */
static size_t heard_of(size_t n, const double *normal, double *rows, double *scale) {
    double largest = 0.0;
    size_t heard = 0;
    for (size_t i = 0; i < n; i++) {
        largest = fmax(largest, sqrt(fmax(normal[i * n + i], 0.0)));
    }
    for (size_t i = 0; i < n; i++) {
        const double root = sqrt(fmax(normal[i * n + i], 0.0));
        if (root > 0.0 && !(root < ROUNDING * largest)) {
            rows[heard] = (double)i;
            scale[heard++] = root;
        }
    }
    return heard;
}

bool gf_cost(size_t blocks, size_t beacons, const double *gram, const double *sums, const double *blur,
             const double *weight, double separable, double *memory, double cost[2]) {
    const size_t n = beacons;
    double *const normal = memory, *const root = &normal[n * n], *const half = &root[n * n];
    double *const inverse = &half[n * n], *const right = &inverse[n * n];
    double *const rows = &right[3u * n], *const scale = &rows[n];
    add_up(blocks, n, gram, sums, normal, right);
    const size_t heard = heard_of(n, normal, rows, scale);
    for (size_t i = 0; i < heard; i++) {
        for (size_t j = 0; j < heard; j++) {
            const double part = normal[(size_t)rows[i] * n + (size_t)rows[j]] / (scale[i] * scale[j]);
            root[i * heard + j] = part;
            half[i * heard + j] = part - (i == j ? separable : 0.0);
        }
    }
    if (!gf_upper_root(heard, half) || !gf_upper_root(heard, root)) {
        return false;
    }
    for (size_t i = 0; i < heard; i++) {
        for (size_t j = 0; j < heard; j++) {
            half[i * heard + j] = i == j ? 1.0 : 0.0;
        }
    }
    gf_whiten(heard, root, heard, half); /* U'^-1, whose columns' products are the inverse */
    memset(inverse, 0, sizeof(double) * heard * heard);
    for (size_t k = 0; k < heard; k++) {
        for (size_t i = 0; i <= k; i++) {
            for (size_t j = 0; j <= k; j++) {
                inverse[i * heard + j] += half[k * heard + i] * half[k * heard + j] / (scale[i] * scale[j]);
            }
        }
    }
    cost[0] = 0.0;
    cost[1] = 3.0 * (double)heard;
    for (size_t i = 0; i < heard; i++) {
        double field[3] = {0.0, 0.0, 0.0}, variance = inverse[i * heard + i];
        for (size_t j = 0; j < heard; j++) {
            const double part = inverse[i * heard + j];
            variance += part * part * blur[(size_t)rows[j]];
            for (size_t a = 0; a < 3u; a++) {
                field[a] += part * right[3u * (size_t)rows[j] + a];
            }
        }
        for (size_t a = 0; a < 3u; a++) {
            for (size_t b = 0; b < 3u; b++) {
                cost[0] += field[a] * weight[3u * a + b] * field[b] / variance;
            }
        }
    }
    return true;
}
