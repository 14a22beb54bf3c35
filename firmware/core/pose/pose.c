#include "core/pose/pose.h"

#include <string.h>

#include "core/math/vector3.h"

/* After the fit from the previous pose. Returns whether that explains the fields; the pose is complete then. */
static bool tracked(pose_work_t *work, pose_t *pose) {
    pose_solver_t *solver = &work->solver;
    pose_problem_t *problem = &solver->problem;
    pose_faults_t *faults = &work->explain.faults;
    if (!pose_problem_inside(problem, solver->best.position_m) || !pose_faults(problem, &solver->best, faults) ||
        faults->alarm) {
        return false;
    }
    pose->tracked = true;
    const bool contested = pose_solve_mirror(solver, &pose->iterations);
    pose_result(problem, &solver->best, faults, POSE_REASON_NONE, contested, pose);
    return true;
}

/* Begins the search with all beacons. */
static bool begin_all(pose_work_t *work) {
    pose_solve_begin(&work->solver, POSE_FIND_DIRECTIONS, POSE_FIND_EVALUATIONS);
    work->stage = POSE_STEP_ALL;
    return false;
}

static void start_from(const pose_t *pose, pose_solver_t *solver) {
    vector3_subtract(pose->position_m, solver->problem.origin_m, solver->best.position_m);
    memcpy(solver->best.quaternion, pose->quaternion, sizeof pose->quaternion);
}

/* Begins the search: where there is a verdict of a cycle before, without the beacon that it names. */
static bool search(pose_work_t *work, pose_t *pose) {
    if (work->known) {
        start_from(pose, &work->solver);
    }
    if (work->later && pose_explain_again(&work->solver, &work->explain, work->verdict.row, work->known, pose)) {
        work->stage = POSE_STEP_AGAIN;
        return false;
    }
    return begin_all(work);
}

static bool begin(pose_work_t *work, pose_t *pose) {
    const pose_problem_t *problem = &work->solver.problem;
    if (problem->count < POSE_BEACONS_LEAST) {
        pose_fail(pose, POSE_REASON_FEW);
        return true;
    }
    if (!pose_problem_audible(problem)) {
        pose_fail(pose, POSE_REASON_NOISE);
        return true;
    }
    if (work->known && problem->count >= POSE_ENOUGH_BEACONS) {
        pose->iterations += pose_fit(&work->solver.problem, POSE_TRACK_EVALUATIONS, &work->solver.best);
        work->stage = POSE_STEP_TRACK;
        return false;
    }
    return search(work, pose);
}

/* After the search without the beacon of the verdict, and while the pose without it is compared with others. */
static bool by_verdict(pose_work_t *work, pose_t *pose) {
    if (!pose_explain_step(&work->solver, &work->explain, pose)) {
        return false;
    }
    if (work->explain.refuted) {
        pose->tracked = false;
        return begin_all(work);
    }
    work->alarmed = true;
    return true;
}

/* No pose is good. */
static bool by_nothing(pose_work_t *work, pose_t *pose) {
    if (!work->later) {
        pose_explain_begin(&work->solver, &work->explain);
        work->stage = POSE_STEP_EXPLAIN;
        return false;
    }
    work->alarmed = true;
    work->explain.again = false;
    work->explain.full = work->solver.best;
    pose_explain_whole(&work->solver, &work->explain,
                       work->verdict.row == POSE_NOBODY ? work->verdict.reason : POSE_REASON_PENDING, pose);
    return true;
}

/* After the search with all beacons. */
static bool by_all(pose_work_t *work, pose_t *pose) {
    pose_solver_t *solver = &work->solver;
    pose_problem_t *problem = &solver->problem;
    pose_faults_t *faults = &work->explain.faults;
    if (solver->best.cost >= POSE_FIT_HOPELESS) {
        pose_fail(pose, POSE_REASON_NO_POSE);
        return true;
    }
    const bool contested = pose_solve_mirror(solver, &pose->iterations) || solver->contested;
    if (!pose_faults(problem, &solver->best, faults)) {
        if (pose_solve_explains(problem, &solver->best, POSE_SOLVE_SUSPECT)) {
            pose_fail(pose, POSE_REASON_NO_POSE);
            return true;
        }
    } else if (!faults->alarm) {
        pose_result(problem, &solver->best, faults, POSE_REASON_NONE, contested, pose);
        return true;
    }
    return by_nothing(work, pose);
}

void pose_begin(const pose_site_t *site, const pose_field_t *fields, bool track, const pose_verdict_t *verdict,
                pose_work_t *work, pose_t *pose) {
    pose_solver_t *solver = &work->solver;
    pose_problem(site, fields, &solver->problem);
    work->known = track && pose->status != POSE_FAILED;
    work->later = verdict != NULL;
    if (verdict != NULL) {
        work->verdict = *verdict;
    }
    work->alarmed = false;
    if (work->known) {
        start_from(pose, solver);
    }
    solver->stage = POSE_SOLVE_DONE;
    work->stage = POSE_STEP_BEGIN;
    pose->used = solver->problem.count;
    pose->left_out = POSE_NOBODY;
    pose->iterations = 0;
    pose->tracked = false;
}

void pose_review(const pose_work_t *work, pose_work_t *review, pose_t *pose) {
    *review = *work;
    pose_solver_t *solver = &review->solver;
    pose_explain_t *explain = &review->explain;
    *pose = (pose_t){.left_out = POSE_NOBODY};
    if (explain->again) {
        if (explain->agreed) {
            pose_problem_leave_out(&solver->problem, explain->left_out, false);
        }
        pose->iterations = pose_fit(&solver->problem, POSE_NEAR_EVALUATIONS, &solver->best);
    }
    pose->used = solver->problem.count;
    pose_explain_begin(solver, explain);
    review->stage = POSE_STEP_EXPLAIN;
}

bool pose_step(pose_work_t *work, pose_t *pose) {
    if (!pose_solve_step(&work->solver, &pose->iterations)) {
        return false;
    }
    switch (work->stage) {
    case POSE_STEP_BEGIN:
        return begin(work, pose);
    case POSE_STEP_TRACK:
        return tracked(work, pose) || search(work, pose);
    case POSE_STEP_AGAIN:
        return by_verdict(work, pose);
    case POSE_STEP_ALL:
        return by_all(work, pose);
    default:
        return pose_explain_step(&work->solver, &work->explain, pose);
    }
}

void pose_find(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose) {
    pose_begin(site, fields, false, NULL, work, pose);
    while (!pose_step(work, pose)) {
    }
}

void pose_track(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose) {
    pose_begin(site, fields, true, NULL, work, pose);
    while (!pose_step(work, pose)) {
    }
}
