#include "watch.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "dense.h"
#include "linear.h"

#define TOLD_OF (GF_POSE + GF_DISTORTED)
#define SIGNALS (TOLD_OF + 1u) /* Pose, distortion, and what is left of the sums. */
#define SEEN    9u             /* Columns of a jacobian. */

/* The elements of a symmetric distortion off the diagonal: `BENDS` of goldfield.track.blocks.consider. */
static const size_t PAIRS[3][2] = {{0, 1}, {0, 2}, {1, 2}};

size_t gf_watch_memory(size_t heard, size_t measured, size_t errors) {
    const size_t size = heard * measured;
    return size * (2u * (TOLD_OF + errors) + size + SIGNALS);
}

/* Write what pose, distortions and errors of the site do to one component of a beacon's field. */
static void ways_of(const gf_watched_t *what, size_t beacon, size_t axis, double *ways) {
    double field[3] = {0.0, 0.0, 0.0};
    for (size_t b = 0; b < 3u; b++) {
        for (size_t a = 0; a < 3u; a++) {
            field[a] += what->rotation[3u * b + a] * what->field[3u * beacon + b];
        }
    }
    memset(ways, 0, sizeof(double) * (TOLD_OF + what->errors));
    for (size_t b = 0; b < 3u; b++) {
        const double turn = what->rotation[3u * b + axis];
        for (size_t k = 0; k < GF_POSE; k++) {
            ways[k] += turn * what->jacobian[(3u * beacon + b) * SEEN + k];
        }
        for (size_t k = 0; k < what->errors; k++) {
            ways[TOLD_OF + k] += turn * what->effects[(3u * beacon + b) * what->errors + k];
        }
        const size_t one = PAIRS[b][0], other = PAIRS[b][1];
        ways[GF_POSE + b] = b == axis ? field[axis] : 0.0;
        ways[GF_POSE + 3u + b] = axis == one ? field[other] : axis == other ? field[one] : 0.0;
    }
}

/* Write the covariance of the sums that are left, the upper half, and what each way does to them. */
static void noise_of(const gf_watched_t *what, const double *sums, const double *ways, double *seen, double *noise) {
    const size_t n = what->beacons, c = what->measured, size = what->heard * c, all = TOLD_OF + what->errors;
    memset(seen, 0, sizeof(double) * size * all);
    for (size_t i = 0; i < what->heard; i++) {
        const size_t row = (size_t)what->rows[i];
        for (size_t j = 0; j < what->heard; j++) {
            const double gram = sums[row * n + (size_t)what->rows[j]];
            const double spread = gram + (i == j ? sums[n * n + row] : 0.0);
            for (size_t a = 0; a < c; a++) {
                for (size_t b = 0; b < c; b++) {
                    noise[(i * c + a) * size + j * c + b] = spread * what->variance[a * c + b];
                }
                for (size_t k = 0; k < all; k++) {
                    seen[(i * c + a) * all + k] += gram * ways[(j * c + a) * all + k];
                }
            }
        }
    }
    for (size_t i = 0; what->errors != 0u && i < size; i++) {
        for (size_t j = i; j < size; j++) {
            double sum = 0.0;
            for (size_t k = TOLD_OF; k < all; k++) {
                sum += seen[i * all + k] * seen[j * all + k];
            }
            noise[i * size + j] += sum;
        }
    }
}

/* Returns whether all numbers of a distortion show, given their triangular form: the smallest of its six values is no
 * less than the product of all over that of the others, which is largest where these are alike. */
static bool all_shown(const double *white, double bent, double least) {
    double product = 1.0, others = 1.0;
    for (size_t i = 0; i < GF_DISTORTED; i++) {
        product *= fabs(white[(GF_POSE + i) * SIGNALS + GF_POSE + i]);
        others *= i > 0u ? sqrt(bent / (GF_DISTORTED - 1.0)) : 1.0;
    }
    return product > least * others;
}

/* Add up the parts of those numbers of a distortion that show. */
static void judge_parts(size_t size, const double *white, double least, double *told) {
    double inner[GF_DISTORTED][6] = {{0.0}}, ways[GF_DISTORTED][6], left[GF_DISTORTED] = {0.0};
    for (size_t i = 0; i < GF_DISTORTED && GF_POSE + i < size; i++) {
        const double *const row = &white[(GF_POSE + i) * SIGNALS + GF_POSE];
        for (size_t p = i; p < GF_DISTORTED; p++) {
            left[p] += row[p] * row[GF_DISTORTED];
            for (size_t q = i; q < GF_DISTORTED; q++) {
                inner[p][q] += row[p] * row[q];
            }
        }
    }
    gf_eigen(GF_DISTORTED, inner, ways);
    for (size_t k = 0; k < GF_DISTORTED; k++) {
        const double value = inner[k][k];
        if (!(value > least * least)) {
            continue;
        }
        double along = 0.0;
        for (size_t p = 0; p < GF_DISTORTED; p++) {
            along += ways[p][k] * left[p];
        }
        told[2] += along * along / value;
        told[3] += 1.0;
        told[4] += value;
    }
}

/* Judge white signals, of which the pose and the distortions are in triangular form; told is all zeros. */
static void judge(size_t size, const double *white, double least, double *told) {
    double part = 0.0, bent = 0.0;
    told[0] = 1.0;
    for (size_t i = GF_POSE; i < size; i++) {
        const double left = white[i * SIGNALS + TOLD_OF];
        told[1] += left * left;
        for (size_t k = i; k < TOLD_OF; k++) {
            bent += white[i * SIGNALS + k] * white[i * SIGNALS + k];
        }
        part += i < TOLD_OF ? left * left : 0.0;
    }
    if (size < TOLD_OF || !all_shown(white, bent, least)) {
        judge_parts(size, white, least, told);
        return;
    }
    told[2] = part;
    told[3] = GF_DISTORTED;
    told[4] = bent;
}

void gf_watch(const gf_watched_t *what, size_t windows, const double *sums, double shown, double *memory,
              double *told) {
    const size_t n = what->beacons, c = what->measured, size = what->heard * c, all = TOLD_OF + what->errors;
    double *const ways = memory, *const seen = &ways[size * all], *const noise = &seen[size * all];
    double *const white = &noise[size * size];
    for (size_t i = 0; i < size; i++) {
        ways_of(what, (size_t)what->rows[i / c], (size_t)what->axes[i % c], &ways[i * all]);
    }
    for (size_t window = 0; window < windows; window++) {
        const double *const given = &sums[window * (n * n + 4u * n)], *const left = &given[n * n + n];
        noise_of(what, given, ways, seen, noise);
        for (size_t i = 0; i < size; i++) {
            memcpy(&white[i * SIGNALS], &seen[i * all], sizeof(double) * TOLD_OF);
            white[i * SIGNALS + TOLD_OF] = left[3u * (size_t)what->rows[i / c] + (size_t)what->axes[i % c]];
        }
        memset(&told[window * GF_TOLD], 0, sizeof(double) * GF_TOLD);
        if (!gf_upper_root(size, noise)) {
            continue;
        }
        gf_whiten(size, noise, SIGNALS, white);
        double weight = 0.0;
        for (size_t i = 0; i < size; i++) {
            for (size_t k = GF_POSE; k < TOLD_OF; k++) {
                weight += white[i * SIGNALS + k] * white[i * SIGNALS + k];
            }
        }
        gf_triangular(size, SIGNALS, TOLD_OF, white);
        judge(size, white, shown * sqrt(weight), &told[window * GF_TOLD]);
    }
}
