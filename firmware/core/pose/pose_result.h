/* pose_result.h: the answer, pose_t, and how a fit becomes one: its covariance, its protection level, and the status
 * and reason that follow from them. The call is pose_result, once for each pose that a fit was found for; pose_fail for
 * the others.
 *
 * Protection level. It is the position error that a fault of one beacon can hide at the alarm of pose_faults, missed in
 * 1 of 1,000 cases, and the noise on top, with the same probability.
 *
 * Time: that of pose_covariance.
 */
#ifndef GOLDFIELD_POSE_RESULT_H
#define GOLDFIELD_POSE_RESULT_H

#include "core/pose/pose_faults.h"

#define POSE_NOBODY UINT32_MAX /* No beacon is left out. */

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
    POSE_REASON_GAINS = 13,      /* Axes of the sensor with other gains fit. */
    POSE_REASON_PENDING = 14,    /* The fields and the site do not agree; what is wrong is still being computed. */
    POSE_REASON_LATE = 15        /* There was no time to compute a pose. */
} pose_reason_t;

typedef struct {
    float position_m[3];
    float quaternion[4];           /* Attitude x, y, z, w with w >= 0: B_site = R B_sensor. */
    float position_cov_m2[3][3];   /* Covariance of the position. */
    float attitude_cov_rad2[3][3]; /* Covariance of a small turn in the site's frame. */
    float residual;                /* Root of chi-square over its degrees of freedom: about 1 if all is right. */
    float protection_m;            /* Protection level; 1e30: anything. */
    pose_status_t status;
    pose_reason_t reason;
    uint32_t used;       /* Beacons that the pose is from; of a failed pose those that were heard. */
    uint32_t left_out;   /* Row of the beacon that was left out, or POSE_NOBODY. */
    uint32_t iterations; /* Evaluations of all fields. */
    bool tracked;        /* The pose was found from the previous one. */
} pose_t;

/* Put a fit and the tests of it into *pose; left_out, iterations and tracked stay. wrong says what is wrong with it,
 * POSE_REASON_NONE if it explains the fields; contested, that another pose explains them as well. The pose fails if
 * the measurements do not tell all six unknowns, and if nothing would be heard there: a fit that finds no place for
 * the fields goes off so far. The reason is then what is wrong, all the same. */
void pose_result(pose_problem_t *problem, const pose_fit_t *fit, const pose_faults_t *faults, pose_reason_t wrong,
                 bool contested, pose_t *pose);

/* Make a pose failed, with the reason. */
void pose_fail(pose_t *pose, pose_reason_t reason);

#endif
