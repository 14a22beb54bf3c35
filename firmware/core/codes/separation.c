#include "core/codes/separation.h"

bool separation_init(separation_t *separation, uint32_t chips, const uint16_t *codes, const int16_t *sums,
                     uint32_t count) {
    separation->count = 0;
    separation->chips = (float)chips;
    if (count > SEPARATION_CODES_MAX) {
        return false;
    }
    int32_t sum = 0;
    int64_t square = 0;
    for (uint32_t i = 0; i < count; i++) {
        for (uint32_t j = 0; j < i; j++) {
            if (codes[i] == codes[j]) {
                return false;
            }
        }
        if (codes[i] > chips) { /* The code is v, or none. */
            return false;
        }
        separation->sums[i] = sums[i];
        sum += sums[i];
        square += (int64_t)sums[i] * sums[i];
    }
    /* The 2 x 2 matrix is a - V'U with a = N + 1, U = [1, s] and V = [1, s / N]. Times N it is of integers, so that its
     * determinant is 0 where nothing can separate the codes, and nowhere else. */
    const int32_t m00 = (int32_t)chips + 1 - (int32_t)count;
    const int64_t m11 = (int64_t)(chips + 1u) * chips - square;
    const int64_t determinant = m00 * m11 - (int64_t)sum * sum;
    if (determinant <= 0) {
        return false;
    }
    const float scale = 1.0f / (float)determinant;
    separation->inverse[0][0] = scale * (float)m11;
    separation->inverse[0][1] = scale * ((float)sum * separation->chips);
    separation->inverse[1][0] = scale * (float)sum;
    separation->inverse[1][1] = scale * ((float)m00 * separation->chips);
    separation->count = count;
    return true;
}

/* Woodbury: b = (y + U M^-1 V'y) / a solves (a I - U V') b = y, with M = a - V'U. */
void separation_apply(const separation_t *separation, float mean, float *field) {
    float plain = 0.0f, weighted = 0.0f;
    for (uint32_t i = 0; i < separation->count; i++) {
        field[i] = separation->chips * field[i] - separation->sums[i] * mean;
        plain += field[i];
        weighted += separation->sums[i] * field[i];
    }
    weighted /= separation->chips;
    const float all = separation->inverse[0][0] * plain + separation->inverse[0][1] * weighted;
    const float by_sum = separation->inverse[1][0] * plain + separation->inverse[1][1] * weighted;
    for (uint32_t i = 0; i < separation->count; i++) {
        field[i] = (field[i] + all + separation->sums[i] * by_sum) / (separation->chips + 1.0f);
    }
}

float separation_variance(const separation_t *separation, uint32_t index) {
    const float s = separation->sums[index], scaled = s / separation->chips;
    const float all = separation->inverse[0][0] + separation->inverse[0][1] * scaled;
    const float by_sum = separation->inverse[1][0] + separation->inverse[1][1] * scaled;
    return (1.0f + all + s * by_sum) / (separation->chips + 1.0f);
}
