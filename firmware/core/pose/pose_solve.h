/* pose_solve.h: the pose that explains the fields of a problem best, with no prior, in steps of bounded time.
 *
 * Calls: pose_solve_begin, then pose_solve_step until it returns true: the best fit is then in solver->best, and
 * solver->contested tells whether another one is as good. pose_solve_mirror looks at its images.
 *
 * Method. pose_search gives candidates on a shell around the strongest beacon. They are fitted, the best first, first
 * with a model error that leads into the right valley, then with the declared errors, until one explains the fields.
 *
 * Time: POSE_SEARCH_SLICE directions of the search are one step, each candidate another. pose.h has the totals.
 */
#ifndef GOLDFIELD_POSE_SOLVE_H
#define GOLDFIELD_POSE_SOLVE_H

#include "core/pose/pose_fit.h"
#include "core/pose/pose_search.h"

#define POSE_ENOUGH_BEACONS     4u  /* Fewest beacons with one answer; with fewer all candidates are fitted. */
#define POSE_ROBUST_EVALUATIONS 25u /* Most evaluations in the robust fit of one candidate. */
#define POSE_NEAR_EVALUATIONS   10u /* Most evaluations in the fit of a pose that is nearly known. */
#define POSE_SEARCH_SLICE       50u /* Directions that a step of the search looks in. */

typedef enum { POSE_SOLVE_DONE, POSE_SOLVE_SEARCH, POSE_SOLVE_CANDIDATE } pose_solve_stage_t;

typedef struct {
    pose_problem_t problem;
    pose_candidates_t candidates;
    pose_fit_t best, other, image; /* The best fit, the one at work, and the last resort or the mirror image. */
    pose_solve_stage_t stage;      /* What the next step does. */
    uint32_t left;                 /* Evaluations that it may still take. */
    uint32_t next;                 /* The next candidate. */
    float rival;                   /* Least cost of a pose other than the best. */
    bool contested;                /* It explains the fields as well. */
} pose_solver_t;

/* Returns whether the cost of a fit is no greater than chance makes it with the probability of a normal deviate. */
bool pose_solve_explains(const pose_problem_t *problem, const pose_fit_t *fit, float deviate);

#define POSE_SOLVE_SUSPECT 2.326f /* Deviate beyond which a cost is suspect: 1 in 100. */

/* Begin a search of solver->problem with so many directions and at most so many evaluations of all fields. */
void pose_solve_begin(pose_solver_t *solver, uint32_t directions, uint32_t evaluations);

/* Do the next step, if one is left, and add its evaluations to *evaluations.
 * Returns true if none was left. best.cost is POSE_FIT_HOPELESS if there is no pose at all. */
bool pose_solve_step(pose_solver_t *solver, uint32_t *evaluations);

/* Go over to an image of the best fit (pose_mirror.h), if there is one that is better or on the right side. Returns
 * whether both explain the fields. */
bool pose_solve_mirror(pose_solver_t *solver, uint32_t *evaluations);

#endif
