/* pose_explain.h: what is wrong when no pose passes the tests of pose_faults, and the pose without one faulty beacon.
 *
 * Calls: pose_explain_begin, or pose_explain_again if a beacon is under suspicion already; then pose_explain_step
 * whenever the search that it has begun in the solver is done, until it returns true.
 *
 * Method. In this order are tried: the negated fields; other gains of the sensor's axes; one beacon after another left
 * out, the most suspect first, each time with a search of its own, and each from the pose of the best of them, which a
 * search may have missed. A beacon is left out only with five or more heard, if the rest has p > .01 and passes the
 * tests, and if the next best explanation costs 25 more. Otherwise the pose by all beacons is inconsistent, and the
 * reason tells what explains the fields.
 *
 * Again. Of a beacon that the fields of a few cycles before spoke against, only it is left out, with the previous pose
 * as a start; the rest must pass the same tests, and no gains, and no other beacon left out at that pose, may explain
 * the fields as well. The searches are spared: they have been made for the cycle before.
 *
 * Time: every step is shorter than the search's; pose.h has the totals.
 */
#ifndef GOLDFIELD_POSE_EXPLAIN_H
#define GOLDFIELD_POSE_EXPLAIN_H

#include "core/pose/pose_faults.h"
#include "core/pose/pose_result.h"
#include "core/pose/pose_solve.h"

#define POSE_LEFT_OUT_LEAST      5u   /* Fewest beacons heard of which one is left out. */
#define POSE_LEFT_OUT_TRIED      12u  /* Most beacons that are tried to be left out, the most suspect first. */
#define POSE_FIND_DIRECTIONS     300u /* Directions of a search. */
#define POSE_FIND_EVALUATIONS    80u  /* Most evaluations of all fields in a search, which bound its time. */
#define POSE_WITHOUT_DIRECTIONS  100u /* Directions of a search without one beacon. */
#define POSE_WITHOUT_EVALUATIONS 40u  /* Most evaluations of all fields in it. */
#define POSE_GAIN_ROUNDS         5u   /* Rounds of fitting the sensor's gains. */

typedef enum {
    POSE_EXPLAIN_NEGATED, /* The negated fields have been searched. */
    POSE_EXPLAIN_GAINS,   /* A round of fitting the sensor's gains comes next. */
    POSE_EXPLAIN_WITHOUT, /* The rest without one beacon has been searched. */
    POSE_EXPLAIN_RIVALS,  /* The rests without the others are fitted from the best one's pose. */
    POSE_EXPLAIN_DECIDE   /* Everything has been tried. */
} pose_explain_stage_t;

typedef struct {
    pose_faults_t faults;  /* Tests of the latest fit that was tested. */
    pose_fit_t full, rest; /* The best fit by all beacons, and the best one without one of them. */
    bool rest_contested;   /* Another pose explains the fields as well as rest. */
    pose_explain_stage_t stage;
    uint32_t tried, place; /* Beacons that were tried to be left out, and the place of the one at work. */
    uint32_t left_out;     /* Place of the one that rest does without. */
    uint32_t round;        /* Rounds of fitting the gains that were done. */
    float total[3];        /* What the fields along each axis have been multiplied by in them. */
    pose_reason_t whole;   /* What explains the fields with all beacons, or POSE_REASON_UNEXPLAINED. */
    float next_cost;       /* Cost of the next best explanation. */
    bool again;            /* A beacon is under suspicion already. */
    bool agreed;           /* The pose is that of the rest, left_out being behind the end of the problem. */
    bool refuted;          /* The rest without the suspect does not agree either; the pose is not set. */
} pose_explain_t;

/* Begin to explain why solver->best, the best fit by all beacons, does not explain the fields. */
void pose_explain_begin(pose_solver_t *solver, pose_explain_t *explain);

/* Begin with the beacon of a row under suspicion; with known, solver->best is the previous pose. Returns false if the
 * beacon cannot be left out, and of POSE_NOBODY. */
bool pose_explain_again(pose_solver_t *solver, pose_explain_t *explain, uint32_t row, bool known, pose_t *pose);

/* Make *pose that of explain->full, the best fit by all beacons, which does not explain the fields. */
void pose_explain_whole(pose_solver_t *solver, pose_explain_t *explain, pose_reason_t reason, pose_t *pose);

/* Go on after a search. Returns true when *pose is complete, or the suspicion is refuted. */
bool pose_explain_step(pose_solver_t *solver, pose_explain_t *explain, pose_t *pose);

#endif
