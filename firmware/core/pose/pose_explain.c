#include "core/pose/pose_explain.h"

#include <string.h>

#define NEGATED    4.265f /* Normal deviate up to which the negated fields are explained: 1 in 100,000. */
#define CLEARLY    25.0f  /* What the next best explanation must cost more for a beacon to be left out. */
#define LEAST_GAIN 0.3f   /* Least gain of an axis that one round of fitting the gains takes. */
#define SAME_GAIN  0.06f  /* Largest difference of gains that are one strength. */

static void note_next(pose_explain_t *explain, float cost) {
    explain->next_cost = cost < explain->next_cost ? cost : explain->next_cost;
}

void pose_explain_whole(pose_solver_t *solver, pose_explain_t *explain, pose_reason_t reason, pose_t *pose) {
    (void)pose_faults(&solver->problem, &explain->full, &explain->faults); /* A fit without tests fails as a result. */
    pose_result(&solver->problem, &explain->full, &explain->faults, reason, false, pose);
}

static void prepare(pose_explain_t *explain, bool again) {
    explain->again = again;
    explain->agreed = explain->refuted = false;
    explain->whole = POSE_REASON_UNEXPLAINED;
    explain->next_cost = explain->rest.cost = POSE_FIT_HOPELESS;
    explain->tried = 0;
}

void pose_explain_begin(pose_solver_t *solver, pose_explain_t *explain) {
    prepare(explain, false);
    explain->full = solver->best;
    explain->stage = POSE_EXPLAIN_NEGATED;
    pose_problem_negate(&solver->problem);
    pose_solve_begin(solver, POSE_FIND_DIRECTIONS, POSE_FIND_EVALUATIONS);
}

bool pose_explain_again(pose_solver_t *solver, pose_explain_t *explain, uint32_t row, bool known, pose_t *pose) {
    pose_problem_t *problem = &solver->problem;
    uint32_t place = 0;
    while (place < problem->count && problem->heard[place].row != row) {
        place++;
    }
    if (place == problem->count || problem->count < POSE_LEFT_OUT_LEAST) {
        return false;
    }
    prepare(explain, true);
    explain->place = place;
    explain->stage = POSE_EXPLAIN_WITHOUT;
    pose_problem_leave_out(problem, place, true);
    if (known) {
        pose->iterations += pose_fit(problem, POSE_NEAR_EVALUATIONS, &solver->best);
        solver->contested = false;
        pose->tracked = pose_solve_explains(problem, &solver->best, POSE_SOLVE_SUSPECT) &&
                        pose_problem_inside(problem, solver->best.position_m);
    }
    if (!pose->tracked) {
        pose_solve_begin(solver, POSE_WITHOUT_DIRECTIONS, POSE_WITHOUT_EVALUATIONS);
    }
    return true;
}

/* Begins to fit the gains of the sensor's axes, with all beacons, from a fit. */
static void begin_gains(pose_solver_t *solver, pose_explain_t *explain, const pose_fit_t *from) {
    solver->best = *from;
    explain->total[0] = explain->total[1] = explain->total[2] = 1.0f;
    explain->round = 0;
    explain->stage = POSE_EXPLAIN_GAINS;
}

static bool after_negated(pose_solver_t *solver, pose_explain_t *explain, pose_t *pose) {
    pose_problem_t *problem = &solver->problem;
    explain->next_cost = solver->best.cost;
    const bool mirrored = pose_solve_explains(problem, &solver->best, NEGATED) &&
                          explain->full.cost - solver->best.cost >= CLEARLY;
    pose_problem_negate(problem);
    if (mirrored || problem->count < POSE_LEFT_OUT_LEAST) {
        pose_explain_whole(solver, explain, mirrored ? POSE_REASON_NEGATED : POSE_REASON_UNEXPLAINED, pose);
        return true;
    }
    begin_gains(solver, explain, &explain->full);
    return false;
}

/* Begins the search without the most suspect beacon that has not been left out yet. */
static void begin_without(pose_solver_t *solver, pose_explain_t *explain) {
    explain->place = 0;
    for (uint32_t i = 1; i < solver->problem.count; i++) {
        explain->place = explain->faults.drop[i] > explain->faults.drop[explain->place] ? i : explain->place;
    }
    explain->faults.drop[explain->place] = -1.0f; /* Drops are not below 0. */
    pose_problem_leave_out(&solver->problem, explain->place, true);
    pose_solve_begin(solver, POSE_WITHOUT_DIRECTIONS, POSE_WITHOUT_EVALUATIONS);
    explain->stage = POSE_EXPLAIN_WITHOUT;
}

/* Returns whether the gains that were found are one strength. */
static bool same_gains(const float total[3]) {
    const float mean = (total[0] + total[1] + total[2]) / 3.0f;
    bool same = true;
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const float apart = total[axis] / mean - 1.0f;
        same = same && apart < SAME_GAIN && apart > -SAME_GAIN;
    }
    return same;
}

/* After the rounds of fitting the gains: notes what they explain. */
static void after_gains(pose_solver_t *solver, pose_explain_t *explain) {
    pose_problem_t *problem = &solver->problem;
    const float back[3] = {1.0f / explain->total[0], 1.0f / explain->total[1], 1.0f / explain->total[2]};
    pose_problem_scale(problem, back);
    note_next(explain, solver->best.cost);
    if (pose_solve_explains(problem, &solver->best, NEGATED)) {
        explain->whole = same_gains(explain->total) ? POSE_REASON_STRENGTH : POSE_REASON_GAINS;
    }
    if (explain->again) {
        explain->place = 0;
        explain->stage = POSE_EXPLAIN_RIVALS;
        return;
    }
    if (!pose_faults(problem, &explain->full, &explain->faults)) { /* It tells nothing of who is suspect. */
        memset(explain->faults.drop, 0, sizeof explain->faults.drop);
    }
    begin_without(solver, explain);
}

/* Does a round of fitting another strength of all fields, or other gains of the sensor's axes. */
static bool by_gains(pose_solver_t *solver, pose_explain_t *explain, pose_t *pose) {
    pose_problem_t *problem = &solver->problem;
    if (explain->round == POSE_GAIN_ROUNDS || !pose_faults(problem, &solver->best, &explain->faults)) {
        after_gains(solver, explain);
        return false;
    }
    float scale[3];
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const float gain = 1.0f + explain->faults.gain[axis];
        scale[axis] = 1.0f / (gain > LEAST_GAIN ? gain < 1.0f / LEAST_GAIN ? gain : 1.0f / LEAST_GAIN : LEAST_GAIN);
        explain->total[axis] *= scale[axis];
    }
    pose_problem_scale(problem, scale);
    pose->iterations += pose_fit(problem, POSE_NEAR_EVALUATIONS, &solver->best);
    explain->round++;
    return false;
}

/* Returns whether the suspicion is refuted. */
static bool after_without(pose_solver_t *solver, pose_explain_t *explain) {
    explain->refuted = explain->again && !pose_solve_explains(&solver->problem, &solver->best, POSE_SOLVE_SUSPECT);
    pose_problem_leave_out(&solver->problem, explain->place, false);
    if (solver->best.cost < explain->rest.cost) {
        note_next(explain, explain->rest.cost);
        explain->rest = solver->best;
        explain->rest_contested = solver->contested;
        explain->left_out = explain->place;
    } else {
        note_next(explain, solver->best.cost);
    }
    explain->tried++;
    if (explain->again) {
        begin_gains(solver, explain, &explain->rest);
    } else if (explain->tried < solver->problem.count && explain->tried < POSE_LEFT_OUT_TRIED) {
        begin_without(solver, explain);
    } else {
        explain->place = 0;
        explain->stage = explain->rest.cost < POSE_FIT_HOPELESS ? POSE_EXPLAIN_RIVALS : POSE_EXPLAIN_DECIDE;
    }
    return explain->refuted;
}

/* Fits the rest without the next beacon from the pose of the best rest. */
static bool by_rivals(pose_solver_t *solver, pose_explain_t *explain, pose_t *pose) {
    pose_problem_t *problem = &solver->problem;
    if (explain->place != explain->left_out) {
        solver->other = explain->rest;
        pose_problem_leave_out(problem, explain->place, true);
        pose->iterations += pose_fit(problem, POSE_NEAR_EVALUATIONS, &solver->other);
        pose_problem_leave_out(problem, explain->place, false);
        note_next(explain, solver->other.cost);
    }
    explain->place++;
    explain->stage = explain->place < problem->count ? POSE_EXPLAIN_RIVALS : POSE_EXPLAIN_DECIDE;
    return false;
}

static bool decide(pose_solver_t *solver, pose_explain_t *explain, pose_t *pose) {
    pose_problem_t *problem = &solver->problem;
    bool agrees = false;
    if (explain->rest.cost < POSE_FIT_HOPELESS) {
        pose_problem_leave_out(problem, explain->left_out, true);
        solver->best = explain->rest;
        const bool contested = pose_solve_mirror(solver, &pose->iterations) || explain->rest_contested;
        agrees = pose_solve_explains(problem, &solver->best, POSE_SOLVE_SUSPECT) &&
                 pose_faults(problem, &solver->best, &explain->faults) && !explain->faults.alarm;
        if (agrees && explain->next_cost - solver->best.cost >= CLEARLY) {
            pose_result(problem, &solver->best, &explain->faults, POSE_REASON_NONE, contested, pose);
            pose->reason = pose->status == POSE_OK ? POSE_REASON_LEFT_OUT : pose->reason;
            pose->left_out = problem->heard[problem->count].row;
            explain->agreed = true;
            return true;
        }
        pose_problem_leave_out(problem, explain->left_out, false);
    }
    if (explain->again) { /* Nobody has fitted all beacons there. */
        explain->full = explain->rest;
        pose->iterations += pose_fit(problem, POSE_NEAR_EVALUATIONS, &explain->full);
    }
    const bool one = explain->whole == POSE_REASON_UNEXPLAINED && agrees;
    pose_explain_whole(solver, explain, one ? POSE_REASON_BEACON : explain->whole, pose);
    return true;
}

bool pose_explain_step(pose_solver_t *solver, pose_explain_t *explain, pose_t *pose) {
    switch (explain->stage) {
    case POSE_EXPLAIN_NEGATED:
        return after_negated(solver, explain, pose);
    case POSE_EXPLAIN_GAINS:
        return by_gains(solver, explain, pose);
    case POSE_EXPLAIN_WITHOUT:
        return after_without(solver, explain);
    case POSE_EXPLAIN_RIVALS:
        return by_rivals(solver, explain, pose);
    default:
        return decide(solver, explain, pose);
    }
}
