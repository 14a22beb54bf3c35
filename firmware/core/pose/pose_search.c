#include "core/pose/pose_search.h"

#include "core/math/roots.h"
#include "core/math/vector3.h"
#include "core/pose/wahba.h"

#define COARSENESS 0.3f /* Relative change of the fields between neighbouring points, used as an error. */
/* Cosine and sine of the golden angle, 2.39996 rad: Fibonacci's spiral spreads points evenly over the sphere. */
#define GOLDEN_COSINE (-0.73736887f)
#define GOLDEN_SINE   0.67549029f
#define NEAR          3.0f            /* Distance within which a coil is not taken for its dipole, radii. */
#define APART2        (0.25f * 0.25f) /* Least distance of candidates over that to the strongest beacon, squared. */

static uint32_t strongest(const pose_problem_t *problem) {
    uint32_t best = 0;
    for (uint32_t i = 1; i < problem->count; i++) {
        if (problem->heard[i].magnitude_uT > problem->heard[best].magnitude_uT) {
            best = i;
        }
    }
    return best;
}

static void profile(const pose_problem_t *problem, const float position_m[3], wahba_t *wahba) {
    wahba_init(wahba);
    for (uint32_t i = 0; i < problem->count; i++) {
        const pose_heard_t *heard = &problem->heard[i];
        const float error = COARSENESS * heard->magnitude_uT;
        float field[3];
        loop_field(&heard->loop, position_m, field);
        wahba_add(wahba, field, heard->field_uT, 1.0f / (heard->sigma_uT * heard->sigma_uT + error * error));
    }
}

static bool near(const pose_candidate_t *a, const pose_candidate_t *b, float apart2) {
    float between[3];
    vector3_subtract(a->position_m, b->position_m, between);
    return vector3_dot(between, between) < apart2;
}

/* Offers a candidate to the list, which stays sorted by loss, with its entries apart: if no better one is near, it goes
 * to its place, and worse ones that are near leave. */
static void offer(pose_candidates_t *found, const pose_candidate_t *offered, float apart2) {
    pose_candidate_t *list = found->candidates;
    if (found->count == POSE_SEARCH_CANDIDATES && list[POSE_SEARCH_CANDIDATES - 1u].loss <= offered->loss) {
        return;
    }
    uint32_t place = 0;
    for (; place < found->count && list[place].loss <= offered->loss; place++) {
        if (near(&list[place], offered, apart2)) {
            return;
        }
    }
    pose_candidate_t moving = *offered;
    for (uint32_t i = place; i < found->count; i++) {
        const pose_candidate_t worse = list[i];
        if (!near(&worse, offered, apart2)) {
            list[place] = moving;
            place++;
            moving = worse;
        }
    }
    if (place < POSE_SEARCH_CANDIDATES) {
        list[place] = moving;
        place++;
    }
    found->count = place;
}

static void place(const loop_t *loop, const float direction[3], float distance, float position_m[3]) {
    for (uint32_t axis = 0; axis < 3u; axis++) {
        position_m[axis] = loop->centre_m[axis] + distance * direction[axis];
    }
}

void pose_search_begin(uint32_t directions, pose_candidates_t *found) {
    *found = (pose_candidates_t){.directions = directions, .x = 1.0f};
}

bool pose_search(const pose_problem_t *problem, uint32_t most, pose_candidates_t *found) {
    const pose_heard_t *centre = &problem->heard[strongest(problem)];
    const float k = centre->loop.k_uT_m3 > 0.0f ? centre->loop.k_uT_m3 : -centre->loop.k_uT_m3;
    const float ratio = centre->magnitude_uT / k;
    const uint32_t left = found->directions - found->next, end = found->next + (left < most ? left : most);
    const float all = (float)found->directions;
    float x = found->x, y = found->y;
    for (uint32_t i = found->next; i < end; i++) {
        const float z = 1.0f - (2.0f * (float)i + 1.0f) / all;
        const float across = square_root(1.0f - z * z);
        const float direction[3] = {across * x, across * y, z};
        const float turned = GOLDEN_COSINE * x - GOLDEN_SINE * y;
        y = GOLDEN_SINE * x + GOLDEN_COSINE * y;
        x = turned;
        const float cosine = vector3_dot(direction, centre->loop.axis);
        float distance = inverse_cube_root(ratio * inverse_square_root(1.0f + 3.0f * cosine * cosine));
        pose_candidate_t candidate;
        place(&centre->loop, direction, distance, candidate.position_m);
        if (distance < NEAR * centre->loop.radius_m) {
            float field[3];
            loop_field(&centre->loop, candidate.position_m, field);
            distance *= inverse_cube_root(centre->magnitude_uT * inverse_square_root(vector3_dot(field, field)));
            place(&centre->loop, direction, distance, candidate.position_m);
        }
        if (!pose_problem_inside(problem, candidate.position_m)) {
            continue;
        }
        wahba_t wahba;
        profile(problem, candidate.position_m, &wahba);
        candidate.loss = wahba_loss(&wahba);
        offer(found, &candidate, APART2 * distance * distance);
    }
    found->x = x;
    found->y = y;
    found->next = end;
    return end == found->directions;
}

void pose_search_attitude(const pose_problem_t *problem, const float position_m[3], float quaternion[4]) {
    wahba_t wahba;
    profile(problem, position_m, &wahba);
    wahba_rotation(&wahba, quaternion);
}
