#include "core/math/quaternion.h"

#include <stdint.h>

#include "core/math/roots.h"

#define MOST_DOUBLINGS 20u /* Most doublings of a turn: enough for 1e6 rad. */

static void normalise(float q[4]) {
    const float scale = inverse_square_root(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (uint32_t i = 0; i < 4u; i++) {
        q[i] *= scale;
    }
}

void quaternion_matrix(const float q[4], float m[3][3]) {
    const float x = q[0], y = q[1], z = q[2], w = q[3];
    m[0][0] = 1.0f - 2.0f * (y * y + z * z);
    m[1][1] = 1.0f - 2.0f * (x * x + z * z);
    m[2][2] = 1.0f - 2.0f * (x * x + y * y);
    m[0][1] = 2.0f * (x * y - w * z);
    m[1][0] = 2.0f * (x * y + w * z);
    m[0][2] = 2.0f * (x * z + w * y);
    m[2][0] = 2.0f * (x * z - w * y);
    m[1][2] = 2.0f * (y * z - w * x);
    m[2][1] = 2.0f * (y * z + w * x);
}

void quaternion_from_matrix(const float m[3][3], float q[4]) {
    const float trace = m[0][0] + m[1][1] + m[2][2];
    uint32_t greatest = 3;
    float most = trace;
    for (uint32_t i = 0; i < 3u; i++) {
        if (m[i][i] > most) {
            most = m[i][i];
            greatest = i;
        }
    }
    if (greatest == 3u) { /* The sums are 4 w times each component. */
        q[0] = m[2][1] - m[1][2];
        q[1] = m[0][2] - m[2][0];
        q[2] = m[1][0] - m[0][1];
        q[3] = 1.0f + trace;
    } else { /* The sums are 4 times the greatest component times each. */
        const uint32_t i = greatest, j = (i + 1u) % 3u, k = (i + 2u) % 3u;
        q[i] = 1.0f - trace + 2.0f * m[i][i];
        q[j] = m[i][j] + m[j][i];
        q[k] = m[i][k] + m[k][i];
        q[3] = m[k][j] - m[j][k];
    }
    normalise(q);
}

void quaternion_turn(float q[4], const float vector_rad[3]) {
    const float x = 0.5f * vector_rad[0], y = 0.5f * vector_rad[1], z = 0.5f * vector_rad[2];
    const float old[4] = {q[0], q[1], q[2], q[3]};
    q[0] = old[0] + x * old[3] + y * old[2] - z * old[1];
    q[1] = old[1] + y * old[3] + z * old[0] - x * old[2];
    q[2] = old[2] + z * old[3] + x * old[1] - y * old[0];
    q[3] = old[3] - x * old[0] - y * old[1] - z * old[2];
    normalise(q);
}

void quaternion_multiply(const float left[4], const float right[4], float product[4]) {
    const float a = left[0], b = left[1], c = left[2], d = left[3];
    const float x = right[0], y = right[1], z = right[2], w = right[3];
    product[0] = d * x + a * w + b * z - c * y;
    product[1] = d * y + b * w + c * x - a * z;
    product[2] = d * z + c * w + a * y - b * x;
    product[3] = d * w - a * x - b * y - c * z;
    normalise(product);
}

/* sin(x) / x and cos(x) by their power series with x at most 1 rad; a longer turn is that of its 2^n-th part, doubled
 * n times. */
void quaternion_exp(const float vector_rad[3], float q[4]) {
    float part = 0.5f;
    float x2 = 0.25f * (vector_rad[0] * vector_rad[0] + vector_rad[1] * vector_rad[1] + vector_rad[2] * vector_rad[2]);
    uint32_t doublings = 0;
    for (; x2 > 1.0f && doublings < MOST_DOUBLINGS; doublings++) {
        x2 *= 0.25f;
        part *= 0.5f;
    }
    const float sine = 1.0f + x2 * (-1.0f / 6 + x2 * (1.0f / 120 + x2 * (-1.0f / 5040 + x2 * (1.0f / 362880))));
    q[3] = 1.0f + x2 * (-0.5f + x2 * (1.0f / 24 + x2 * (-1.0f / 720 + x2 * (1.0f / 40320 - x2 * (1.0f / 3628800)))));
    for (uint32_t i = 0; i < 3u; i++) {
        q[i] = part * sine * vector_rad[i];
    }
    for (; doublings > 0u; doublings--) {
        quaternion_multiply(q, q, q);
    }
}
