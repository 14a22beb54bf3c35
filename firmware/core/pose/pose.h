/* pose.h: position and attitude of the sensor from the fields of one cycle, in single precision: the location of
 * host/goldfield/locate on the board itself.
 *
 * Calls: pose_begin, then pose_step until it returns true, so that a long computation does not hold up the board.
 * pose_find and pose_track do it at once.
 *
 * Method. With no prior, the strongest beacon's magnitude gives a shell of candidates (pose_search), each with the
 * best attitude (wahba). They are fitted on all components, the best first, first with 3 % of model error, then with
 * the noise alone (pose_fit), until one explains the fields. Tracking starts the fit from the previous pose, and falls
 * back to the search when that does not explain the fields. If no pose passes the tests of pose_faults, each further
 * step tries an explanation: the negated fields; other gains of the sensor's axes; one beacon after another left out,
 * each time with a search of its own. A beacon is left out, and the pose may be ok, only with five or more heard, if
 * the rest has p > .01 and passes the tests, and if the next best explanation costs 25 more.
 *
 * Differences from the host's location: one beacon is left out at most, not two; of more than 12 the most suspect 12
 * are tried. The sensor's distortion is named as strength or gains only. Errors of the site are not part of the model.
 * The search is not a global one: near a coil another pose may be missed. A fault in a direction with less than 3e-6 of
 * its variance in the residuals counts as not detectable: close to a coil the status is more often unverified.
 *
 * Limits. Any mix of axes, moments and heights is allowed; coils are exact at any range. At least POSE_BEACONS_LEAST
 * beacons are needed. Sensors with fewer than three axes are not here but on the host.
 *
 * Mirror. Coplanar coils that all point across their plane have an exact mirror pose, p mirrored and the sensor turned
 * half around the normal, with exactly the same fields. The half-space decides, if there is one; else the status is
 * ambiguous. Nearly coplanar ones (a quarter of their extent) are tried too, and judged by the fields.
 *
 * Accuracy. Model, weights and covariance (pose_covariance) are the host's; the poses agree within a tenth of the
 * Cramer-Rao bound (tests/firmware/core/pose/test_pose.py; at a tenth of the noise, 0.2 mG, and about a radius from a
 * coil, rounding can make it a fifth).
 *
 * Time (Cortex-M4, gcc 12 -O3, counted in Unicorn by tests/firmware/core/pose/test_pose_instructions.py, 8 beacons in
 * a cube). Every loop is bounded; time grows with the number of beacons heard.
 *   pose_find    980,000 instructions when a pose explains the fields.
 *   pose_track   186,000 instructions, at most 200,000 with the previous pose 0.1 m and 0.1 rad away; when it has to
 *                search, those of pose_find too.
 *   pose_step    at most 2,000,000 instructions, 12 ms at an instruction a cycle and 168 MHz; all steps together, when
 *                nothing explains the fields, 11,000,000, 66 ms.
 *
 * Memory: pose_work_t 5.1 kB, pose_site_t 2,080 bytes, both the caller's; stack 2.7 kB.
 */
#ifndef GOLDFIELD_POSE_H
#define GOLDFIELD_POSE_H

#include "core/pose/pose_faults.h"
#include "core/pose/pose_fit.h"
#include "core/pose/pose_search.h"

#define POSE_BEACONS_MAX         POSE_FIT_BEACONS
#define POSE_BEACONS_LEAST       3u         /* Fewest beacons that are located from: 9 components for 6 unknowns. */
#define POSE_FIND_DIRECTIONS     300u       /* Directions of a search. */
#define POSE_FIND_EVALUATIONS    80u        /* Most evaluations of all fields in a search, which bound its time. */
#define POSE_ROBUST_EVALUATIONS  25u        /* Most evaluations in the robust fit of one candidate. */
#define POSE_TRACK_EVALUATIONS   14u        /* Most evaluations in the fit from the previous pose. */
#define POSE_MIRROR_EVALUATIONS  10u        /* Most evaluations in the fit of a pose that is nearly known. */
#define POSE_LEFT_OUT_LEAST      5u         /* Fewest beacons heard of which one is left out. */
#define POSE_LEFT_OUT_TRIED      12u        /* Most beacons that are tried to be left out, the most suspect first. */
#define POSE_WITHOUT_DIRECTIONS  100u       /* Directions of a search without one beacon. */
#define POSE_WITHOUT_EVALUATIONS 40u        /* Most evaluations of all fields in it. */
#define POSE_GAIN_ROUNDS         5u         /* Rounds of fitting the sensor's gains. */
#define POSE_NOBODY              UINT32_MAX /* No beacon is left out. */

/* The values are those of POSE_QUALITY. */
typedef enum {
    POSE_OK = 0,        /* The pose explains the fields, and no other does. */
    POSE_AMBIGUOUS = 1, /* Another pose explains the fields as well. */
    POSE_WEAK = 2,      /* The standard deviation is beyond a quarter of the distance to the nearest beacon, or beyond
                           0.5 rad: nothing linear holds. */
    POSE_INCONSISTENT = 3, /* The fields and the site do not agree, or the pose is outside the half-space. */
    POSE_FAILED = 4,       /* No pose can be told. Only used, iterations and reason are set. */
    POSE_UNVERIFIED = 5    /* The pose explains the fields, but a fault that nobody would see could move it further than
                              the alert limit. */
} pose_status_t;

/* Why the status is what it is: the values of POSE_INTEGRITY. */
typedef enum {
    POSE_REASON_NONE = 0,        /* All is well. */
    POSE_REASON_FEW = 1,         /* Fewer than three beacons are heard. */
    POSE_REASON_NOISE = 2,       /* The fields are nothing but noise. */
    POSE_REASON_NO_POSE = 3,     /* There is no solution, or it does not tell all six unknowns. */
    POSE_REASON_NEGATED = 4,     /* The negated fields fit: left-handed axes of the sensor, or all coils reversed. */
    POSE_REASON_BEACON = 5,      /* One beacon would explain it, but it is not clear which. */
    POSE_REASON_UNEXPLAINED = 6, /* No single beacon explains it. */
    POSE_REASON_HALF_SPACE = 7,  /* The pose is outside the half-space. */
    POSE_REASON_RIVAL = 8,       /* Another pose explains the fields as well. */
    POSE_REASON_WEAK = 9,        /* The standard deviation is too great. */
    POSE_REASON_UNVERIFIED = 10, /* The protection level is above the alert limit. */
    POSE_REASON_LEFT_OUT = 11,   /* The pose is good; one beacon was left out. */
    POSE_REASON_STRENGTH = 12,   /* Fields of another strength fit: the sensor's gain, or all currents. */
    POSE_REASON_GAINS = 13       /* Axes of the sensor with other gains fit. */
} pose_reason_t;

typedef struct {
    float position_m[3];
    float axis[3];     /* Direction of the moment, of any length but 0. */
    float moment_A_m2; /* Current times turns times area; 0: it is not there; negative: it points against the axis. */
    float radius_m;    /* Radius of the coil; 0: it is a dipole. */
} pose_beacon_t;

/* What the sensor knows of its surroundings. */
typedef struct {
    uint32_t count; /* Beacons. */
    pose_beacon_t beacons[POSE_BEACONS_MAX];
    float half_space_point_m[3];
    float half_space_normal[3]; /* The sensor is where (p - point) . normal >= 0. 0: there is no half-space. */
    float alert_limit_m;        /* Largest protection level of a pose that is ok, m. */
} pose_site_t;

typedef struct {
    float field_T[3]; /* Field in the sensor's frame, separated from the other beacons'. */
    float sigma_T;    /* Standard deviation of a component; not above 0: the beacon was not heard. */
} pose_field_t;

typedef struct {
    float position_m[3];
    float quaternion[4];           /* Attitude x, y, z, w with w >= 0: B_site = R B_sensor. */
    float position_cov_m2[3][3];   /* Covariance of the position. */
    float attitude_cov_rad2[3][3]; /* Covariance of a small turn in the site's frame. */
    float residual;                /* Root of chi-square over its degrees of freedom: about 1 if all is right. */
    float
        protection_m; /* Protection level: what an unseen fault of one beacon can do, with the noise; 1e30: anything. */
    pose_status_t status;
    pose_reason_t reason;
    uint32_t used;       /* Beacons that the pose is from; of a failed pose those that were heard. */
    uint32_t left_out;   /* Row of the beacon that was left out, or POSE_NOBODY. */
    uint32_t iterations; /* Evaluations of all fields. */
    bool tracked;        /* The pose was found from the previous one. */
} pose_t;

typedef enum { POSE_STEP_ALL, POSE_STEP_NEGATED, POSE_STEP_GAINS, POSE_STEP_WITHOUT, POSE_STEP_DECIDE } pose_stage_t;

/* Memory of one pose, from pose_begin to its last pose_step; its contents need not live from pose to pose. */
typedef struct {
    pose_problem_t problem;
    float origin_m[3];           /* Origin of the problem's coordinates: the strongest beacon. */
    float point_m[3], normal[3]; /* The half-space in these coordinates. */
    float alert_limit_m;
    pose_candidates_t candidates;
    pose_fit_t best, other, image;  /* The best fit, the one at work, and the last resort or the mirror image. */
    pose_fit_t full, rest;          /* The best fit by all beacons, and the best one without one of them. */
    pose_faults_t faults;           /* Tests of the latest fit that was tested. */
    pose_stage_t step;              /* What the next step does. */
    bool known;                     /* best holds the previous pose. */
    bool contested, rest_contested; /* Another pose explains the fields as well as full, or as rest. */
    uint32_t tried;                 /* Beacons that were tried to be left out. */
    uint32_t left_out;              /* Place in the problem of the one that rest does without. */
    pose_reason_t whole;            /* What explains the fields with all beacons, or POSE_REASON_UNEXPLAINED. */
    float next_cost;                /* Cost of the next best explanation. */
} pose_work_t;

/* Begin a pose. fields has one entry for each beacon of the site, site->count of them; fields that are not finite count
 * as not heard. With track, *pose is the previous pose: it is where the first step starts, unless it failed. */
void pose_begin(const pose_site_t *site, const pose_field_t *fields, bool track, pose_work_t *work, pose_t *pose);

/* Do the next step. Returns true when *pose is complete, at the latest with step 4 + POSE_LEFT_OUT_TRIED. It never
 * fails but by status. */
bool pose_step(pose_work_t *work, pose_t *pose);

/* Locate with no prior: pose_begin and all steps. */
void pose_find(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose);

/* Locate from the previous pose, *pose, which is replaced: pose_begin with track and all steps. */
void pose_track(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose);

#endif
