#include "core/pose/pose_solve.h"

#include <string.h>

#include "core/math/chi_square.h"
#include "core/math/vector3.h"
#include "core/pose/pose_mirror.h"

#define LEAST_EVALUATIONS 12u   /* Fewest evaluations that are worth the name of a fit. */
#define LAST_EVALUATIONS  20u   /* Most evaluations of the fit of the last resort, which bounds the last step. */
#define RIVAL_COST        15.0f /* Distance in cost of a rival: a pose so much worse is right in one case of e^7.5. */

bool pose_solve_explains(const pose_problem_t *problem, const pose_fit_t *fit, float deviate) {
    return fit->cost <= chi_square_limit((float)pose_problem_freedom(problem), deviate);
}

/* Returns whether two fits are different poses: apart by a twentieth of the distance to the nearest beacon, or by 0.2
 * rad. */
static bool different(const pose_problem_t *problem, const pose_fit_t *a, const pose_fit_t *b) {
    float offset[3], overlap = 0.0f;
    vector3_subtract(a->position_m, b->position_m, offset);
    for (uint32_t i = 0; i < 4u; i++) {
        overlap += a->quaternion[i] * b->quaternion[i]; /* The cosine of half the angle between. */
    }
    return vector3_dot(offset, offset) > 0.0025f * pose_problem_nearest2(problem, a->position_m) ||
           overlap * overlap < 0.99f;
}

/* Notes a fit with the declared errors: the best one, and the least cost of another pose. */
static void note(pose_solver_t *solver, const pose_fit_t *fit) {
    const pose_problem_t *problem = &solver->problem;
    pose_fit_t *best = &solver->best;
    const bool other = different(problem, best, fit) && pose_problem_inside(problem, fit->position_m) &&
                       pose_problem_inside(problem, best->position_m);
    const float worse = fit->cost > best->cost ? fit->cost : best->cost;
    solver->rival = other && worse < solver->rival ? worse : solver->rival;
    if (fit->cost < best->cost) {
        *best = *fit;
    }
}

/* Fits the next candidate, with the declared errors too if it is plausible; the least implausible is kept as a last
 * resort. */
static void fit_candidate(pose_solver_t *solver) {
    const pose_problem_t *problem = &solver->problem;
    pose_fit_t *fit = &solver->other;
    memcpy(fit->position_m, solver->candidates.candidates[solver->next].position_m, sizeof fit->position_m);
    solver->next++;
    pose_search_attitude(problem, fit->position_m, fit->quaternion);
    solver->left -= pose_fit_robust(&solver->problem, POSE_ROBUST_EVALUATIONS, fit);
    if (pose_solve_explains(problem, fit, POSE_SOLVE_SUSPECT)) {
        solver->left -= pose_fit(&solver->problem, solver->left, fit);
        note(solver, fit);
    } else if (fit->cost < solver->image.cost) {
        solver->image = *fit;
    }
}

/* Returns whether another candidate is to be fitted. */
static bool wanted(const pose_solver_t *solver) {
    const pose_problem_t *problem = &solver->problem;
    const bool found = problem->count >= POSE_ENOUGH_BEACONS &&
                       pose_solve_explains(problem, &solver->best, POSE_SOLVE_SUSPECT) &&
                       pose_problem_inside(problem, solver->best.position_m);
    return !found && solver->next < solver->candidates.count &&
           solver->left >= POSE_ROBUST_EVALUATIONS + LEAST_EVALUATIONS;
}

void pose_solve_begin(pose_solver_t *solver, uint32_t directions, uint32_t evaluations) {
    pose_search_begin(directions, &solver->candidates);
    solver->left = evaluations;
    solver->next = 0;
    solver->rival = solver->best.cost = solver->image.cost = POSE_FIT_HOPELESS;
    solver->stage = POSE_SOLVE_SEARCH;
}

bool pose_solve_step(pose_solver_t *solver, uint32_t *evaluations) {
    const uint32_t before = solver->left;
    switch (solver->stage) {
    case POSE_SOLVE_SEARCH:
        if (pose_search(&solver->problem, POSE_SEARCH_SLICE, &solver->candidates)) {
            solver->stage = POSE_SOLVE_CANDIDATE;
        }
        break;
    case POSE_SOLVE_CANDIDATE:
        if (wanted(solver)) {
            fit_candidate(solver);
            break;
        }
        if (solver->best.cost >= POSE_FIT_HOPELESS && solver->image.cost < POSE_FIT_HOPELESS) {
            solver->best = solver->image;
            const uint32_t most = solver->left < LAST_EVALUATIONS ? solver->left : LAST_EVALUATIONS;
            solver->left -= pose_fit(&solver->problem, most, &solver->best);
        }
        solver->contested = solver->rival - solver->best.cost < RIVAL_COST;
        solver->stage = POSE_SOLVE_DONE;
        break;
    default:
        return true;
    }
    *evaluations += before - solver->left;
    return false;
}

/* Fits the image, and goes over to it if it is better or on the right side. Returns whether it explains the fields,
 * too, and the half-space does not decide. */
static bool rivals(pose_solver_t *solver, uint32_t *evaluations) {
    pose_problem_t *problem = &solver->problem;
    pose_fit_t *best = &solver->best, *image = &solver->image;
    *evaluations += pose_fit(problem, POSE_NEAR_EVALUATIONS, image);
    if (!different(problem, image, best) || image->cost - best->cost >= RIVAL_COST) {
        return false;
    }
    const bool here = pose_problem_inside(problem, best->position_m),
               there = pose_problem_inside(problem, image->position_m);
    if (here == there ? image->cost < best->cost - 1.0f : there) {
        *best = *image;
    }
    return here == there;
}

bool pose_solve_mirror(pose_solver_t *solver, uint32_t *evaluations) {
    pose_fit_t *best = &solver->best, *image = &solver->image;
    float point[3], normal[3], extent2;
    bool contested = false;
    const bool plane = pose_mirror_plane(&solver->problem, point, normal, &extent2);
    if (plane) {
        pose_mirror_reflect(point, normal, best, image);
        contested = rivals(solver, evaluations);
    }
    if (pose_mirror_is_far(point, extent2, best->position_m)) {
        pose_mirror_across(point, best, image);
        contested = rivals(solver, evaluations) || contested;
        if (plane) {
            pose_mirror_reflect(point, normal, best, image);
            pose_mirror_across(point, image, image);
            contested = rivals(solver, evaluations) || contested;
        }
    }
    return contested;
}
