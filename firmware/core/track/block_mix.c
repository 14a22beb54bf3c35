#include "core/track/block_mix.h"

#include "core/math/logarithm.h"

#define LEAST  1e-9f /* Least probability of a filter. */
#define SILENT 1e-6f /* Probability below which a filter has no part in the output. */

typedef float errors_t[BLOCK_FILTERS][BLOCK_STATES];

static void differ(const block_kalman_t filters[BLOCK_FILTERS], uint32_t best, errors_t errors) {
    for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
        block_state_subtract(&filters[k].state, &filters[best].state, errors[k]);
    }
}

/* Mixes an element of all covariances, and that of the other side of the diagonal. */
static inline void mix_element(block_kalman_t filters[BLOCK_FILTERS], const float share[BLOCK_FILTERS][BLOCK_FILTERS],
                               const errors_t errors, const errors_t means, uint32_t row, uint32_t column) {
    float spread[BLOCK_FILTERS];
    for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
        spread[k] = filters[k].covariance[row][column] + errors[k][row] * errors[k][column];
    }
    for (uint32_t j = 0; j < BLOCK_FILTERS; j++) {
        float sum = -means[j][row] * means[j][column];
        for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
            sum += share[j][k] * spread[k];
        }
        filters[j].covariance[row][column] = filters[j].covariance[column][row] = sum;
    }
}

void block_mix(block_kalman_t filters[BLOCK_FILTERS], uint32_t best, float change) {
    float share[BLOCK_FILTERS][BLOCK_FILTERS], probability[BLOCK_FILTERS];
    errors_t errors, means;
    const block_state_t reference = filters[best].state;
    const float stay = 1.0f - (float)(BLOCK_FILTERS - 1u) * change;
    differ(filters, best, errors);
    for (uint32_t j = 0; j < BLOCK_FILTERS; j++) {
        probability[j] = 0.0f;
        for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
            share[j][k] = filters[k].probability * (j == k ? stay : change);
            probability[j] += share[j][k];
        }
        for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
            share[j][k] /= probability[j];
        }
        for (uint32_t i = 0; i < BLOCK_STATES; i++) {
            means[j][i] = 0.0f;
            for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
                means[j][i] += share[j][k] * errors[k][i];
            }
        }
    }
    for (uint32_t row = 0; row < BLOCK_STATES; row++) {
        for (uint32_t column = 0; column <= row; column++) {
            mix_element(filters, (const float(*)[BLOCK_FILTERS])share, (const float(*)[BLOCK_STATES])errors,
                        (const float(*)[BLOCK_STATES])means, row, column);
        }
    }
    for (uint32_t j = 0; j < BLOCK_FILTERS; j++) {
        filters[j].probability = probability[j];
        filters[j].state = reference;
        block_state_move(&filters[j].state, means[j]);
    }
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
    float mean[BLOCK_STATES] = {0.0f};
    differ(filters, best, errors);
    for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
        for (uint32_t i = 0; i < BLOCK_STATES; i++) {
            mean[i] += filters[k].probability * errors[k][i];
        }
    }
    for (uint32_t row = 0; row < length; row++) {
        for (uint32_t column = 0; column <= row; column++) {
            float sum = -mean[row] * mean[column];
            for (uint32_t k = 0; k < BLOCK_FILTERS; k++) {
                if (filters[k].probability > SILENT) {
                    sum += filters[k].probability *
                           (filters[k].covariance[row][column] + errors[k][row] * errors[k][column]);
                }
            }
            covariance[row * length + column] = covariance[column * length + row] = sum;
        }
    }
    *state = filters[best].state;
    block_state_move(state, mean);
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
