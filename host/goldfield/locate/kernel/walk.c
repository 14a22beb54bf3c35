#include "walk.h"

#include <math.h>
#include <string.h>

#include "linear.h"

/* A walk ends where the cost has risen by this: four standard deviations. */
#define MOST_RISE 16.0

/* A walk has come over a pass where the cost falls by this from the highest point. */
#define FALL 1.0

#define MOST_STEPS  32
#define HELD_TRIALS 5
#define HELD_ENOUGH 1e-2
#define WAY_POINTS  8

/* Steps grow while the cost rises by less than this at a step, and shrink where it rises by more than the second. */
#define SLOW_RISE  0.7
#define QUICK_RISE 3.0

/* As goldfield.locate.uncertainty has them. */
#define UNOBSERVABLE           1e-13
#define FREE_M2                1e6
#define FREE_RAD2              3.28986813369645287
#define COVARIANCE_EVALUATIONS 13

static void moved(const gf_pose_t *pose, const double step[6], double portion, gf_pose_t *out) {
    double turn[3];
    *out = *pose;
    for (size_t k = 0; k < 3; ++k) {
        out->position_m[k] += portion * step[k];
        turn[k] = portion * step[3 + k];
    }
    gf_turn(out->rotation, turn);
}

static double length_of(const double vector[3]) {
    return sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]);
}

/* Let the rest of a pose give way while the position keeps its component along a direction. */
static void give_way(gf_epoch_t *epoch, const double direction[3], gf_minimum_t *at) {
    const double length = length_of(direction);
    for (size_t k = 0; k < 3; ++k) {
        epoch->normal[k] = direction[k] / fmax(length, 1e-300);
    }
    epoch->held = true;
    gf_descend(epoch, HELD_TRIALS, HELD_ENOUGH, at);
    epoch->held = false;
}

/* The inverse of a positive definite matrix; false if it is not. */
static bool invert(const double matrix[6][6], double out[6][6]) {
    for (size_t k = 0; k < 6; ++k) {
        const double unit[6] = {k == 0, k == 1, k == 2, k == 3, k == 4, k == 5};
        double damped[6][6];
        memcpy(damped, matrix, sizeof damped);
        for (size_t l = 0; l < 6; ++l) {
            damped[l][l] *= 1.0 + 1e-12;
        }
        if (!gf_solve(6, (const double(*)[6])damped, unit, out[k])) {
            return false;
        }
    }
    return true;
}

void gf_begin_width(gf_epoch_t *epoch, const gf_minimum_t *minimum, gf_width_t *width) {
    double covariance[6][6];
    width->from = minimum->pose;
    width->cost = minimum->squares.cost;
    memset(width->widening, 0, sizeof width->widening);
    gf_covariance(epoch->coils, NULL, 1, epoch->field_T, epoch->sigma_T, minimum->pose.position_m,
                  &minimum->pose.rotation[0][0], UNOBSERVABLE, FREE_M2, FREE_RAD2, &covariance[0][0]);
    epoch->evaluations += COVARIANCE_EVALUATIONS;
    if (!invert((const double(*)[6])covariance, width->information)) {
        memcpy(width->information, minimum->squares.normal, sizeof width->information);
    }
}

void gf_widen(gf_width_t *width, const gf_pose_t *pose, double cost) {
    double d[6];
    double along[6] = {0.0};
    gf_difference(&width->from, pose, d);
    for (size_t k = 0; k < 6; ++k) {
        for (size_t l = 0; l < 6; ++l) {
            along[k] += width->information[k][l] * d[l];
        }
    }
    double nu = 0.0;
    for (size_t k = 0; k < 6; ++k) {
        nu += d[k] * along[k];
    }
    const double allowed = 3.0 * fmax(cost - width->cost, 1.0);
    if (!(nu > allowed) || !isfinite(nu)) {
        return;
    }
    const double added = 1.0 / allowed - 1.0 / nu;
    for (size_t k = 0; k < 6; ++k) {
        for (size_t l = 0; l < 6; ++l) {
            width->widening[k][l] += added * d[k] * d[l];
            width->information[k][l] -= along[k] * along[l] * added / (1.0 + added * nu);
        }
    }
}

/* One standard deviation along the least determined direction of position, with the turn that goes with it. */
static bool weakest(const gf_minimum_t *from, double step[6]) {
    double covariance[6][6];
    double block[3][6] = {{0.0}};
    double vectors[3][6];
    if (!invert((const double(*)[6])from->squares.normal, covariance)) {
        return false;
    }
    for (size_t k = 0; k < 3; ++k) {
        memcpy(block[k], covariance[k], 3 * sizeof block[k][0]);
    }
    gf_eigen(3, block, vectors);
    size_t widest = 0;
    for (size_t k = 1; k < 3; ++k) {
        widest = block[k][k] > block[widest][widest] ? k : widest;
    }
    const double deviation = sqrt(fmax(block[widest][widest], 1e-300));
    for (size_t k = 0; k < 6; ++k) {
        step[k] = 0.0;
        for (size_t l = 0; l < 3; ++l) {
            step[k] += covariance[k][l] * vectors[l][widest] / deviation;
        }
    }
    return isfinite(deviation);
}

bool gf_walk(gf_epoch_t *epoch, const gf_minimum_t *from, double sign, gf_width_t *width, gf_pose_t *out) {
    double step[6];
    double size = sign;
    double before = from->squares.cost;
    double highest = before;
    gf_minimum_t at = *from;
    if (!weakest(from, step)) {
        return false;
    }
    for (size_t count = 0; count < MOST_STEPS; ++count) {
        const gf_pose_t last = at.pose;
        moved(&last, step, size, &at.pose);
        give_way(epoch, step, &at);
        const double cost = at.squares.cost;
        if (!isfinite(cost)) {
            return false;
        }
        gf_widen(width, &at.pose, cost);
        if (cost < highest - FALL || cost < from->squares.cost - 0.1) {
            *out = at.pose;
            return true;
        }
        if (cost > from->squares.cost + MOST_RISE) {
            return false;
        }
        highest = fmax(highest, cost);
        gf_difference(&last, &at.pose, step);
        size = cost - before < SLOW_RISE ? 1.7 : cost - before > QUICK_RISE ? 0.5 : 1.0;
        before = cost;
    }
    return false;
}

bool gf_joined(gf_epoch_t *epoch, const gf_minimum_t *from, const gf_minimum_t *to, double limit, gf_width_t *width) {
    double way[6];
    gf_width_t wider = *width;
    gf_minimum_t at = *from;
    gf_difference(&from->pose, &to->pose, way);
    for (size_t point = 1; point <= WAY_POINTS; ++point) {
        /* From where the last point gave way to, straight on towards the end. */
        double rest[6];
        gf_pose_t next;
        gf_difference(&at.pose, &to->pose, rest);
        moved(&at.pose, rest, 1.0 / (double)(WAY_POINTS + 2 - point), &next);
        at.pose = next;
        give_way(epoch, way, &at);
        if (!(at.squares.cost < limit)) {
            return false;
        }
        gf_widen(&wider, &at.pose, at.squares.cost);
    }
    gf_widen(&wider, &to->pose, to->squares.cost);
    *width = wider;
    return true;
}
