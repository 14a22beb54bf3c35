#include "core/pose/wahba.h"

#include <stdint.h>

#include "core/math/quaternion.h"
#include "core/math/vector3.h"

/* H over E/2, so that lambda is at most 1, and the numbers that the quartic is made of. */
typedef struct {
    float h[3][3], cofactors[3][3];
    float norm2, determinant, cofactors2; /* |H|^2, det H, |adj H|^2 */
} quartic_t;

void wahba_init(wahba_t *wahba) {
    *wahba = (wahba_t){0};
}

void wahba_add(wahba_t *wahba, const float site[3], const float sensor[3], float weight) {
    for (uint32_t row = 0; row < 3u; row++) {
        const float weighted = weight * site[row];
        for (uint32_t column = 0; column < 3u; column++) {
            wahba->h[row][column] += weighted * sensor[column];
        }
    }
    wahba->energy += weight * (vector3_dot(site, site) + vector3_dot(sensor, sensor));
}

static float square_sum(const float m[3][3]) {
    return vector3_dot(m[0], m[0]) + vector3_dot(m[1], m[1]) + vector3_dot(m[2], m[2]);
}

/* Without any pairs nothing is a number, and no comparison is true. */
static void scaled(const wahba_t *wahba, quartic_t *q) {
    const float scale = 2.0f / wahba->energy;
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            q->h[row][column] = scale * wahba->h[row][column];
        }
    }
    for (uint32_t row = 0; row < 3u; row++) {
        vector3_cross(q->h[(row + 1u) % 3u], q->h[(row + 2u) % 3u], q->cofactors[row]);
    }
    q->norm2 = square_sum((const float(*)[3])q->h);
    q->cofactors2 = square_sum((const float(*)[3])q->cofactors);
    q->determinant = vector3_dot(q->h[0], q->cofactors[0]);
}

static float greatest_root(const quartic_t *q) {
    float lambda = 1.0f;
    for (uint32_t step = 0; step < WAHBA_STEPS; step++) {
        const float excess = lambda * lambda - q->norm2;
        const float value = excess * excess - 8.0f * lambda * q->determinant - 4.0f * q->cofactors2;
        const float slope = 4.0f * lambda * excess - 8.0f * q->determinant;
        if (!(value > 0.0f && slope > 0.0f)) { /* Lambda is the root, but for rounding. */
            break;
        }
        lambda -= value / slope;
    }
    return lambda;
}

float wahba_loss(const wahba_t *wahba) {
    quartic_t q;
    scaled(wahba, &q);
    return wahba->energy * (1.0f - greatest_root(&q));
}

/* R is proportional to (kappa + |H|^2) H + lambda adj(H)' - H H' H, kappa = (lambda^2 - |H|^2)/2. */
void wahba_rotation(const wahba_t *wahba, float quaternion[4]) {
    quartic_t q;
    scaled(wahba, &q);
    const float lambda = greatest_root(&q), kappa = 0.5f * (lambda * lambda - q.norm2);
    const float zeta = kappa * lambda - q.determinant;
    if (!(zeta > 1e-7f)) { /* All vectors are parallel. */
        quaternion[0] = quaternion[1] = quaternion[2] = 0.0f;
        quaternion[3] = 1.0f;
        return;
    }
    float matrix[3][3];
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            float cubic = 0.0f;
            for (uint32_t k = 0; k < 3u; k++) {
                cubic += vector3_dot(q.h[row], q.h[k]) * q.h[k][column];
            }
            const float sum = (kappa + q.norm2) * q.h[row][column] + lambda * q.cofactors[row][column] - cubic;
            matrix[row][column] = sum / zeta;
        }
    }
    quaternion_from_matrix((const float(*)[3])matrix, quaternion);
}
