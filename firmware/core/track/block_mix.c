#include "core/track/block_mix.h"

#include <stdbool.h>
#include <string.h>

#include "core/math/logarithm.h"

#define LEAST 1e-9f /* Least probability of a filter. */

typedef float errors_t[BLOCK_FILTERS][BLOCK_STATES];

static void differ(const block_kalman_t filters[BLOCK_FILTERS], uint32_t best, errors_t errors) {
    for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
        if (k == best) {
            memset(errors[k], 0, sizeof errors[k]);
        } else {
            block_state_subtract(&filters[k].state, &filters[best].state, errors[k]);
        }
    }
}

/* How the filters are mixed: each takes its part of what all together give away, and keeps a part of its own. */
typedef struct {
    float given[BLOCK_FILTERS], taken[BLOCK_FILTERS], kept[BLOCK_FILTERS];
} shares_t;

/* Mixes an element of all covariances; errors and means are those of its row and of its column. */
static inline void mix_element(block_kalman_t filters[BLOCK_FILTERS], const shares_t *shares, const errors_t errors,
                               const errors_t means, uint32_t row, uint32_t column, bool mirror) {
    float spread[BLOCK_FILTERS], together = 0.0f;
    for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
        spread[k] = filters[k].covariance[row][column] + errors[k][row] * errors[k][column];
        together += shares->given[k] * spread[k];
    }
    for (uint32_t j = 0; j < BLOCK_FILTERS; j++) {
        const float mixed = shares->taken[j] * together + shares->kept[j] * spread[j] -
                            means[j][row] * means[j][column];
        filters[j].covariance[row][column] = mixed;
        if (mirror) {
            filters[j].covariance[column][row] = mixed;
        }
    }
}

/* Mixes a row of all covariances up to the diagonal, and what is on its other side in the block of six rows. */
static inline void mix_row(block_kalman_t filters[BLOCK_FILTERS], const shares_t *shares, const errors_t errors,
                           const errors_t means, uint32_t row) {
    const uint32_t block = row - row % 6u;
    for (uint32_t column = 0; column < block; column++) {
        mix_element(filters, shares, errors, means, row, column, false);
    }
    for (uint32_t column = block; column <= row; column++) {
        mix_element(filters, shares, errors, means, row, column, true);
    }
}

void block_mix(block_kalman_t filters[BLOCK_FILTERS], uint32_t best, float change) {
    shares_t shares;
    errors_t errors, means;
    const float stay = 1.0f - (float)BLOCK_FILTERS * change; /* Beside the part that it gives itself as to others. */
    float all = 0.0f;
    differ(filters, best, errors);
    for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
        shares.given[k] = change * filters[k].probability;
        all += shares.given[k];
    }
    for (uint32_t j = 0; j < BLOCK_FILTERS; j++) {
        const float kept = stay * filters[j].probability, probability = all + kept;
        filters[j].probability = probability;
        shares.taken[j] = 1.0f / probability;
        shares.kept[j] = kept / probability;
    }
    for (uint32_t i = 0; i < BLOCK_STATES; i++) {
        float together = 0.0f;
        for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
            together += shares.given[k] * errors[k][i];
        }
        for (uint32_t j = 0; j < BLOCK_FILTERS; j++) {
            means[j][i] = shares.taken[j] * together + shares.kept[j] * errors[j][i];
        }
    }
    for (uint32_t row = 0; row < BLOCK_STATES; row++) {
        mix_row(filters, &shares, (const float(*)[BLOCK_STATES])errors, (const float(*)[BLOCK_STATES])means, row);
    }
    for (uint32_t j = 0; j < BLOCK_FILTERS; j++) {
        if (j != best) {
            block_state_move(&filters[best].state, means[j], &filters[j].state);
        }
    }
    block_state_move(&filters[best].state, means[best], &filters[best].state);
}

uint32_t block_mix_weigh(block_kalman_t filters[BLOCK_FILTERS], const float likelihood[BLOCK_FILTERS],
                         float *together) {
    float most = likelihood[0], sum = 0.0f;
    uint32_t best = 0;
    for (uint32_t k = 1; k < BLOCK_FILTERS; k++) {
        most = likelihood[k] > most ? likelihood[k] : most;
    }
    for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
        filters[k].probability *= exponential(likelihood[k] - most);
        sum += filters[k].probability;
    }
    *together = most + natural_logarithm(sum);
    for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
        const float probability = filters[k].probability / sum;
        filters[k].probability = probability > LEAST ? probability : LEAST;
        best = filters[k].probability > filters[best].probability ? k : best;
    }
    return best;
}

/* Merges the states of all filters, and so many rows and columns of their covariances, whose rows have that length. */
static inline void merge(const block_kalman_t filters[BLOCK_FILTERS], uint32_t best, uint32_t length,
                         block_state_t *state, float *covariance) {
    errors_t errors;
    float mean[BLOCK_STATES], from_mean[BLOCK_STATES][BLOCK_FILTERS];
    differ(filters, best, errors);
    for (uint32_t i = 0; i < BLOCK_STATES; i++) {
        mean[i] = 0.0f;
        for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
            mean[i] += filters[k].probability * errors[k][i];
        }
        for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
            from_mean[i][k] = errors[k][i] - mean[i];
        }
    }
    for (uint32_t row = 0; row < length; row++) {
        const float *of[BLOCK_FILTERS];
        float weights[BLOCK_FILTERS], weighed[BLOCK_FILTERS];
        for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
            of[k] = filters[k].covariance[row];
            weights[k] = filters[k].probability;
            weighed[k] = weights[k] * from_mean[row][k];
        }
        for (uint32_t column = 0; column <= row; column++) {
            float sum = weights[0] * of[0][column];
            sum += weighed[0] * from_mean[column][0]; /* One product each: they are fused with the sums. */
            for (uint32_t k = 1; k < BLOCK_FILTERS; k++) {
                sum += weights[k] * of[k][column];
                sum += weighed[k] * from_mean[column][k];
            }
            covariance[row * length + column] = covariance[column * length + row] = sum;
        }
    }
    block_state_move(&filters[best].state, mean, state);
}

/* Computes the squared agilities that all filters expect together. */
static void agility(const block_kalman_t filters[BLOCK_FILTERS], float *acceleration2, float *turn2) {
    *acceleration2 = *turn2 = 0.0f;
    for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
        *acceleration2 += filters[k].probability * filters[k].acceleration2;
        *turn2 += filters[k].probability * filters[k].turn2;
    }
}

void block_mix_output(const block_kalman_t filters[BLOCK_FILTERS], uint32_t best, float seconds, block_state_t *state,
                      float covariance[6][6]) {
    float merged[BLOCK_E][BLOCK_E], acceleration2, turn2;
    merge(filters, best, BLOCK_E, state, merged[0]);
    agility(filters, &acceleration2, &turn2);
    block_kalman_ahead(state, merged, acceleration2, turn2, seconds);
    for (uint32_t row = 0; row < 6u; row++) {
        for (uint32_t column = 0; column < 6u; column++) {
            covariance[row][column] = merged[row][column];
        }
    }
}

void block_mix_whole(const block_kalman_t filters[BLOCK_FILTERS], uint32_t best, block_kalman_t *whole) {
    merge(filters, best, BLOCK_STATES, &whole->state, whole->covariance[0]);
    agility(filters, &whole->acceleration2, &whole->turn2);
    whole->probability = 1.0f;
}
