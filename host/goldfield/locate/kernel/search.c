#include <math.h>
#include <string.h>

#include "candidates.h"
#include "walk.h"

/* Relative errors of the model, one after another: strong, curved beacons no longer dominate at first. */
static const double softness[] = {0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4};
#define STAGES (sizeof softness / sizeof softness[0])

/* Trials at each stage, at the end of a descent, and more for the best on a ridge; what counts as no decrease. */
#define STAGE_TRIALS 8
#define LAST_TRIALS  150
#define STAGE_ENOUGH 1e-2
#define FINAL_TRIALS 40
#define FINAL_ENOUGH 1e-6

#define MOST_MINIMA 12

/* One part in so many of the evaluations is left for the walks. */
#define WALKS_SHARE 5

/* Near a coil, and with so few coils that there are several answers, descents begin all over its level set, at this
 * stage; two that come this near each other, in parts of the range and in rad, are one. */
#define FEW_COILS      4
#define SPREAD_STAGE   2
#define SPREAD_TRIALS  12
#define SPREAD_PORTION 0.03
#define SPREAD_TURN    0.1

/* Two poses are one minimum below these: squared distance in standard deviations, and turn in rad. */
#define SAME_DISTANCE2 1.0
#define SAME_PORTION   1e-3
#define SAME_TURN      1e-2

/* A rival this near, in parts of the range and in rad, widens the covariance instead. */
#define NEAR_PORTION 0.05
#define NEAR_TURN    0.2

/* A way between two minima is low if the cost stays within this of the best. */
#define LOW_PASS 9.0

/* Only minima within this of the best are rivals; further off than the second a descent is given up. */
#define RIVAL_COST    15.0
#define HOPELESS_COST 30.0

/* A descent that has not ended at this stage or beyond leads to nothing, too, at so many times the hopeless cost. */
#define UNENDED_STAGE 2
#define UNENDED_TIMES 100.0

/* A pose is near the start coil within the first number of radii of its centre, and inside it within the second: of
 * 10,000 poses within a radius, 8 were missed by all first descents, which ended within .8 radii. */
#define NEAR_RADII   3.0
#define INSIDE_RADII 1.2

typedef struct {
    gf_epoch_t epoch;
    const double *half_space; /* unit normal and the least component along it; a normal of 0 allows all */
    double model_error;
    double hopeless_cost;
    bool at_any_cost;
    size_t coil; /* the start coil */
    size_t count;
    gf_minimum_t minima[MOST_MINIMA]; /* those on the right side first, then by cost */
} search_t;

static bool is_inside(const search_t *search, const gf_pose_t *pose) {
    const double *const h = search->half_space;
    return h[0] * pose->position_m[0] + h[1] * pose->position_m[1] + h[2] * pose->position_m[2] >= h[3];
}

static double distance_from(const gf_coils_t *coils, size_t coil, const gf_pose_t *pose) {
    double square = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        const double offset = pose->position_m[k] - coils->centre_m[k][coil];
        square += offset * offset;
    }
    return sqrt(square);
}

static double nearest_coil(const gf_coils_t *coils, const gf_pose_t *pose) {
    double least = INFINITY;
    for (size_t i = 0; i < coils->count; ++i) {
        least = fmin(least, distance_from(coils, i, pose));
    }
    return least;
}

static bool is_near(const gf_coils_t *coils, const gf_pose_t *a, const gf_pose_t *b, double portion, double turn) {
    double d[6];
    gf_difference(a, b, d);
    const double shift = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    const double angle = sqrt(d[3] * d[3] + d[4] * d[4] + d[5] * d[5]);
    return shift < portion * nearest_coil(coils, a) && angle < turn;
}

static bool is_same(const search_t *search, const gf_minimum_t *a, const gf_minimum_t *b) {
    double d[6];
    gf_difference(&a->pose, &b->pose, d);
    return gf_form((const double(*)[6])a->squares.normal, d) < SAME_DISTANCE2 ||
           is_near(search->epoch.coils, &a->pose, &b->pose, SAME_PORTION, SAME_TURN);
}

static bool is_better(const search_t *search, const gf_minimum_t *a, const gf_minimum_t *b) {
    const bool inside = is_inside(search, &a->pose);
    return inside == is_inside(search, &b->pose) ? a->squares.cost < b->squares.cost : inside;
}

/* Keep a minimum in its rank unless it is known. Returns whether it is new. */
static bool keep(search_t *search, const gf_minimum_t *found) {
    gf_minimum_t *const minima = search->minima;
    if (!isfinite(found->squares.cost)) {
        return false;
    }
    for (size_t i = 0; i < search->count; ++i) {
        if (!is_same(search, &minima[i], found)) {
            continue;
        }
        if (!is_better(search, found, &minima[i])) {
            return false;
        }
        memmove(&minima[i], &minima[i + 1], (search->count - i - 1) * sizeof minima[0]);
        --search->count;
        break;
    }
    if (search->count == MOST_MINIMA) {
        if (!is_better(search, found, &minima[MOST_MINIMA - 1])) {
            return false;
        }
        --search->count;
    }
    size_t rank = search->count++;
    for (; rank > 0 && is_better(search, found, &minima[rank - 1]); --rank) {
        minima[rank] = minima[rank - 1];
    }
    minima[rank] = *found;
    return true;
}

/* Whether an error of the model is small beside the noise of every coil. */
static bool is_stiff(const gf_epoch_t *epoch, double error) {
    for (size_t i = 0; i < epoch->coils->count; ++i) {
        const double variance = 1.0 / (epoch->sigma_T[i] * epoch->sigma_T[i]);
        if (epoch->weight[i] > 0.0 && epoch->weight[i] < 0.9 * variance && error > 0.0) {
            return false;
        }
    }
    return true;
}

/* Whether a soft minimum leads to nothing that matters: no stiffer cost is less, and this is above what data that fit
 * anywhere cost, or far above the best. */
static bool is_hopeless(const search_t *search, const gf_minimum_t *soft) {
    return soft->squares.cost > search->hopeless_cost ||
           (search->count > 0 && is_inside(search, &search->minima[0].pose) &&
            soft->squares.cost > search->minima[0].squares.cost + HOPELESS_COST);
}

static bool is_given_up(const search_t *search, const gf_minimum_t *at, size_t stage) {
    const bool far = stage >= UNENDED_STAGE && at->squares.cost > UNENDED_TIMES * search->hopeless_cost;
    return (at->converged || far) && is_hopeless(search, at);
}

/* Descend through the stages of softness from this one on, then to the end. */
static bool refine(search_t *search, const gf_pose_t *pose, size_t stage) {
    gf_minimum_t at = {.pose = *pose};
    for (; stage < STAGES && softness[stage] > search->model_error; ++stage) {
        gf_soften(&search->epoch, softness[stage]);
        if (is_stiff(&search->epoch, softness[stage])) {
            break;
        }
        gf_descend(&search->epoch, STAGE_TRIALS, STAGE_ENOUGH, &at);
        if (is_given_up(search, &at, stage)) {
            return false;
        }
    }
    gf_soften(&search->epoch, search->model_error);
    gf_descend(&search->epoch, FINAL_TRIALS, FINAL_ENOUGH, &at);
    return keep(search, &at);
}

/* Poses where the start coil's field is the same but for its direction: through its plane, its centre and its axis. */
static void try_images(search_t *search, const gf_pose_t *pose) {
    static const double along[3] = {-1.0, -1.0, 1.0};
    static const double across[3] = {1.0, -1.0, -1.0};
    const gf_coils_t *const coils = search->epoch.coils;
    double offset[3];
    double height = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        offset[k] = pose->position_m[k] - coils->centre_m[k][search->coil];
        height += offset[k] * coils->axis[k][search->coil];
    }
    for (size_t image = 0; image < 3; ++image) {
        gf_pose_t there;
        for (size_t k = 0; k < 3; ++k) {
            const double up = height * coils->axis[k][search->coil];
            there.position_m[k] = coils->centre_m[k][search->coil] + along[image] * up +
                                  across[image] * (offset[k] - up);
        }
        gf_soften(&search->epoch, 0.1);
        gf_align(&search->epoch, &there);
        (void)refine(search, &there, 0);
    }
}

/* Descend from all over the start coil's level set, from this softness on; what comes near what an earlier start came
 * to goes no further. */
static void try_spread(search_t *search, size_t stage) {
    gf_pose_t starts[GF_SPREAD];
    gf_pose_t reached[GF_SPREAD];
    size_t count = 0;
    gf_spread(&search->epoch, search->coil, starts);
    for (size_t i = 0; i < GF_SPREAD; ++i) {
        gf_minimum_t at = {.pose = starts[i]};
        gf_soften(&search->epoch, softness[stage]);
        gf_descend(&search->epoch, SPREAD_TRIALS, STAGE_ENOUGH, &at);
        bool known = is_given_up(search, &at, stage);
        for (size_t k = 0; k < count && !known; ++k) {
            known = is_near(search->epoch.coils, &reached[k], &at.pose, SPREAD_PORTION, SPREAD_TURN);
        }
        if (!known) {
            reached[count++] = at.pose;
            (void)refine(search, &at.pose, stage);
        }
    }
}

/* Whether the best minimum is within so many radii of the start coil's centre. */
static bool is_within(const search_t *search, double radii) {
    const gf_coils_t *const coils = search->epoch.coils;
    return search->count > 0 &&
           distance_from(coils, search->coil, &search->minima[0].pose) < radii * coils->radius_m[search->coil];
}

static void explore(search_t *search) {
    gf_pose_t candidates[GF_CANDIDATES];
    search->coil = gf_start_coil(&search->epoch);
    const size_t count = gf_candidates(&search->epoch, search->coil, candidates);
    for (size_t i = 0; i < count; ++i) {
        (void)refine(search, &candidates[i], 0);
    }
    for (size_t i = 0; i < 2 && i < search->count; ++i) {
        const gf_pose_t pose = search->minima[i].pose;
        try_images(search, &pose);
    }
    if (is_within(search, NEAR_RADII) || (search->count > 0 && search->epoch.coils->count <= FEW_COILS)) {
        try_spread(search, SPREAD_STAGE);
    }
    if (search->at_any_cost && (search->count == 0 || search->minima[0].squares.cost > search->hopeless_cost)) {
        /* Nothing fits; the pose that fits best is wanted all the same, as a track's start. Near a coil it may lie on
         * the wrong side of a ridge, and is where the right one is sought from. */
        const double hopeless_cost = search->hopeless_cost;
        const bool spread = search->count > 0;
        search->hopeless_cost = INFINITY;
        for (size_t i = 0; i < count; ++i) {
            (void)refine(search, &candidates[i], 0);
        }
        search->hopeless_cost = hopeless_cost;
        if (!spread && is_within(search, INSIDE_RADII)) {
            try_spread(search, SPREAD_STAGE);
        }
    }
}

/* Walk both ways from the best minimum, again from a better one if that is found, and widen its covariance. */
static void walk(search_t *search, gf_width_t *width) {
    for (size_t round = 0; round < 4; ++round) {
        gf_soften(&search->epoch, search->model_error);
        gf_descend(&search->epoch, LAST_TRIALS, FINAL_ENOUGH, &search->minima[0]);
        const gf_minimum_t from = search->minima[0];
        gf_begin_width(&search->epoch, &from, width);
        for (size_t side = 0; side < 2; ++side) {
            gf_pose_t beyond;
            if (gf_walk(&search->epoch, &from, side == 0 ? 1.0 : -1.0, width, &beyond)) {
                (void)refine(search, &beyond, STAGES);
            }
        }
        if (!(search->minima[0].squares.cost < from.squares.cost)) {
            break; /* nothing better was found beyond */
        }
    }
}

/* The first minimum that is neither joined with the best nor so near that its covariance takes it in. */
static size_t find_rival(search_t *search, gf_width_t *width) {
    const gf_minimum_t *const best = &search->minima[0];
    gf_soften(&search->epoch, search->model_error);
    for (size_t i = 1; i < search->count; ++i) {
        const gf_minimum_t *const other = &search->minima[i];
        if (other->squares.cost > best->squares.cost + RIVAL_COST ||
            is_inside(search, &other->pose) != is_inside(search, &best->pose)) {
            continue;
        }
        if (is_near(search->epoch.coils, &best->pose, &other->pose, NEAR_PORTION, NEAR_TURN)) {
            gf_widen(width, &other->pose, other->squares.cost);
        } else if (!gf_joined(&search->epoch, best, other, best->squares.cost + LOW_PASS, width)) {
            return i;
        }
    }
    return search->count;
}

static void put(const gf_minimum_t *minimum, double *position_m, double *rotation) {
    memcpy(position_m, minimum->pose.position_m, sizeof minimum->pose.position_m);
    memcpy(rotation, minimum->pose.rotation, sizeof minimum->pose.rotation);
}

void gf_search(const gf_coils_t *coils, size_t epochs, const double *field_T, const double *sigma_T, double model_error,
               const double half_space[4], size_t most_evaluations, double hopeless_cost, bool at_any_cost,
               double *position_m, double *rotation, uint8_t *found, double *widening, uint32_t *evaluations) {
    const size_t n = coils->count;
    for (size_t e = 0; e < epochs; ++e) {
        search_t search = {.epoch = {.coils = coils},
                           .half_space = half_space,
                           .model_error = model_error,
                           .hopeless_cost = hopeless_cost,
                           .at_any_cost = at_any_cost};
        gf_width_t width = {.cost = 0.0};
        search.epoch.field_T = field_T + 3 * n * e;
        search.epoch.sigma_T = sigma_T + n * e;
        search.epoch.most_evaluations = most_evaluations - most_evaluations / WALKS_SHARE;
        explore(&search);
        const bool ended = search.epoch.evaluations >= search.epoch.most_evaluations;
        search.epoch.most_evaluations = most_evaluations;
        size_t rival = search.count;
        if (search.count > 0) {
            if (!(search.minima[0].squares.cost > hopeless_cost)) {
                walk(&search, &width);
                rival = find_rival(&search, &width);
            }
            put(&search.minima[0], position_m + 6 * e, rotation + 18 * e);
            put(&search.minima[rival < search.count ? rival : 0], position_m + 6 * e + 3, rotation + 18 * e + 9);
        }
        found[e] = search.count == 0 ? 0 : rival < search.count ? 2 : 1;
        memcpy(widening + 36 * e, width.widening, sizeof width.widening);
        evaluations[e] = (uint32_t)(ended ? most_evaluations : search.epoch.evaluations);
    }
}
