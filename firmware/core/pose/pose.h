/* pose.h: position and attitude of the sensor from the fields of one cycle, in single precision: the location of
 * host/goldfield/locate on the board itself.
 *
 * Calls: pose_find with no prior, or pose_track in each cycle, which starts from the pose before and finds the first
 * one, too.
 *
 * Method. With no prior, the strongest beacon's magnitude gives a shell of candidates (pose_search), each with the
 * best attitude (wahba). They are fitted on all components, the best first, first with 3 % of model error, then with
 * the noise alone (pose_fit), until one explains the fields. Tracking starts the fit from the previous pose, and falls
 * back to the search when that does not explain the fields.
 *
 * Limits. Any mix of axes, moments and heights is allowed; coils are exact at any range. At least POSE_BEACONS_LEAST
 * beacons are needed. Sensors with fewer than three axes, exclusion of faulty beacons, and tests of single beacons are
 * not here but on the host.
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
 *   pose_find    940,000 instructions; 2,000,000 when nothing explains the fields, 12 ms at an instruction a cycle and
 *                168 MHz.
 *   pose_track   162,000 instructions, at most 200,000 with the previous pose 0.1 m and 0.1 rad away; when it has to
 *                search, those of pose_find too.
 *
 * Memory: pose_work_t 4,092 bytes, pose_site_t 2,076, both the caller's; stack 2.7 kB.
 */
#ifndef GOLDFIELD_POSE_H
#define GOLDFIELD_POSE_H

#include "core/pose/pose_fit.h"
#include "core/pose/pose_search.h"

#define POSE_BEACONS_MAX        POSE_FIT_BEACONS
#define POSE_BEACONS_LEAST      3u  /* Fewest beacons that are located from: 9 components for 6 unknowns. */
#define POSE_FIND_EVALUATIONS   80u /* Most evaluations of all fields in a search, which bound its time. */
#define POSE_ROBUST_EVALUATIONS 25u /* Most evaluations in the robust fit of one candidate. */
#define POSE_TRACK_EVALUATIONS  14u /* Most evaluations in the fit from the previous pose. */
#define POSE_MIRROR_EVALUATIONS 10u /* Most evaluations in the fit of the mirror pose. */

/* The values are those of POSE_QUALITY. */
typedef enum {
    POSE_OK = 0,        /* The pose explains the fields, and no other does. */
    POSE_AMBIGUOUS = 1, /* Another pose explains the fields as well. */
    POSE_WEAK = 2,      /* The standard deviation is beyond a quarter of the distance to the nearest beacon, or beyond
                           0.5 rad: nothing linear holds. */
    POSE_INCONSISTENT = 3, /* The residual is improbable (1 in 5,000), or the pose is outside the half-space. */
    POSE_FAILED = 4        /* There are fewer than three beacons, or no solution. Only used and iterations are set. */
} pose_status_t;

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
    pose_status_t status;
    uint32_t used;       /* Beacons that were heard. */
    uint32_t iterations; /* Evaluations of all fields. */
    bool tracked;        /* The pose was found from the previous one. */
} pose_t;

/* Scratch memory; its contents need not live from call to call. */
typedef struct {
    pose_problem_t problem;
    float origin_m[3];           /* Origin of the problem's coordinates: the strongest beacon. */
    float point_m[3], normal[3]; /* The half-space in these coordinates. */
    pose_candidates_t candidates;
    pose_fit_t best, other, image; /* The best fit, the one at work, and the last resort or the mirror image. */
} pose_work_t;

/* Locate with no prior. fields has one entry for each beacon of the site, site->count of them; fields that are not
 * finite count as not heard. It never fails but by status. */
void pose_find(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose);

/* Locate from the previous pose, *pose, which is replaced. A previous pose that failed is no start: the call then does
 * what pose_find does. */
void pose_track(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose);

#endif
