#include "core/pose/pose.h"

#include <string.h>

#include "core/math/vector3.h"

/* Fits from the previous pose. Returns whether that explains the fields; the pose is complete then. */
static bool track(pose_work_t *work, pose_t *pose) {
    pose_solver_t *solver = &work->solver;
    pose_problem_t *problem = &solver->problem;
    pose_faults_t *faults = &work->explain.faults;
    pose->iterations += pose_fit(problem, POSE_TRACK_EVALUATIONS, &solver->best);
    if (!pose_problem_inside(problem, solver->best.position_m) || !pose_faults(problem, &solver->best, faults) ||
        faults->alarm) {
        return false;
    }
    pose->tracked = true;
    const bool contested = pose_solve_mirror(solver, &pose->iterations);
    pose_result(problem, &solver->best, faults, POSE_REASON_NONE, contested, pose);
    return true;
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
    if (work->known && problem->count >= POSE_ENOUGH_BEACONS && track(work, pose)) {
        return true;
    }
    pose_solve_begin(&work->solver, POSE_FIND_DIRECTIONS, POSE_FIND_EVALUATIONS);
    work->stage = POSE_STEP_ALL;
    return false;
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
    pose_explain_begin(solver, &work->explain);
    work->stage = POSE_STEP_EXPLAIN;
    return false;
}

void pose_begin(const pose_site_t *site, const pose_field_t *fields, bool track, pose_work_t *work, pose_t *pose) {
    pose_solver_t *solver = &work->solver;
    pose_problem(site, fields, &solver->problem);
    work->known = track && pose->status != POSE_FAILED;
    if (work->known) {
        vector3_subtract(pose->position_m, solver->problem.origin_m, solver->best.position_m);
        memcpy(solver->best.quaternion, pose->quaternion, sizeof pose->quaternion);
    }
    solver->stage = POSE_SOLVE_DONE;
    work->stage = POSE_STEP_BEGIN;
    pose->used = solver->problem.count;
    pose->left_out = POSE_NOBODY;
    pose->iterations = 0;
    pose->tracked = false;
}

bool pose_step(pose_work_t *work, pose_t *pose) {
    if (!pose_solve_step(&work->solver, &pose->iterations)) {
        return false;
    }
    switch (work->stage) {
    case POSE_STEP_BEGIN:
        return begin(work, pose);
    case POSE_STEP_ALL:
        return by_all(work, pose);
    default:
        return pose_explain_step(&work->solver, &work->explain, pose);
    }
}

void pose_find(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose) {
    pose_begin(site, fields, false, work, pose);
    while (!pose_step(work, pose)) {
    }
}

void pose_track(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose) {
    pose_begin(site, fields, true, work, pose);
    while (!pose_step(work, pose)) {
    }
}
