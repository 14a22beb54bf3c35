/* pose.h: position and attitude of the sensor from the fields of one cycle, in single precision: the location of
 * host/goldfield/locate on the board itself.
 *
 * With no prior (pose_find): the strongest beacon's magnitude gives a shell of candidates (pose_search), each with the
 * best attitude (wahba), which are fitted on all components, first with 3 % of model error, then with the noise alone
 * (pose_fit), the best first, until one explains the fields. Tracking (pose_track) starts the fit from the previous
 * pose, and falls back to the search when that does not explain the fields. Any mix of axes, moments and heights; coils
 * exact at any range. At least POSE_BEACONS_LEAST beacons.
 *
 * Coplanar coils that all point across their plane have an exact mirror pose, p mirrored and the sensor turned half
 * around the normal: the same fields exactly. The half-space decides, if there is one; else the status is ambiguous.
 * Nearly coplanar ones (a quarter of their extent) are tried too, and judged by the fields.
 *
 * Against the host: same model, weights and covariance (pose_covariance); the poses agree within a tenth of the
 * Cramer-Rao bound (tests/firmware/core/pose/test_pose.py; at a tenth of the noise, 0.2 mG, and about a radius from a
 * coil, rounding can make it a fifth). Not here: sensors with fewer than three axes, exclusion of faulty beacons, tests
 * of single beacons.
 *
 * Bounds (Cortex-M4, gcc 12 -O3, counted in Unicorn by tests/firmware/core/pose/test_pose_instructions.py, 8 beacons in
 * a cube):
 *   pose_find    940,000 instructions, 2,000,000 when nothing explains the fields: 12 ms at an instruction a cycle and
 *                168 MHz.
 *   pose_track   162,000 instructions, at most 200,000 with the previous pose 0.1 m and 0.1 rad away; when it has to
 *                search, those of pose_find too.
 * Every loop is bounded; time grows with the number of beacons heard. Memory: pose_work_t 4,092 bytes, pose_site_t
 * 2,076, both the caller's; stack 2.7 kB.
 */
#ifndef GOLDFIELD_POSE_H
#define GOLDFIELD_POSE_H

#include "core/pose/pose_fit.h"
#include "core/pose/pose_search.h"

#define POSE_BEACONS_MAX        POSE_FIT_BEACONS
#define POSE_BEACONS_LEAST      3u
#define POSE_FIND_EVALUATIONS   80u /* Of all fields, over all candidates: what bounds the time. */
#define POSE_ROBUST_EVALUATIONS 25u /* For the robust fit of one candidate. */
#define POSE_TRACK_EVALUATIONS  14u
#define POSE_MIRROR_EVALUATIONS 10u

/* As in POSE_QUALITY. */
typedef enum {
    POSE_OK = 0,
    POSE_AMBIGUOUS = 1, /* Another pose explains the fields as well. */
    POSE_WEAK = 2,      /* Standard deviation beyond a quarter of the distance to the nearest beacon, or beyond 0.5 rad:
                           nothing linear holds. */
    POSE_INCONSISTENT = 3, /* The residual is improbable (1 in 5,000), or the pose is outside the half-space. */
    POSE_FAILED = 4        /* Fewer than three beacons, or no solution: nothing else is set but used and iterations. */
} pose_status_t;

typedef struct {
    float position_m[3];
    float axis[3];     /* Any length but 0. */
    float moment_A_m2; /* Current times turns times area; 0: not there. Negative: against the axis. */
    float radius_m;    /* 0: a dipole. */
} pose_beacon_t;

/* What the sensor knows of its surroundings. */
typedef struct {
    uint32_t count;
    pose_beacon_t beacons[POSE_BEACONS_MAX];
    float half_space_point_m[3];
    float half_space_normal[3]; /* The sensor is where (p - point) . normal >= 0. 0: no half-space. */
} pose_site_t;

typedef struct {
    float field_T[3]; /* In the sensor's frame, separated from the other beacons'. */
    float sigma_T;    /* Standard deviation of a component; not above 0: not heard. */
} pose_field_t;

typedef struct {
    float position_m[3];
    float quaternion[4]; /* x, y, z, w; w >= 0. B_site = R B_sensor. */
    float position_cov_m2[3][3];
    float attitude_cov_rad2[3][3]; /* Of a small turn in the site's frame. */
    float residual;                /* Root of chi-square over its degrees of freedom: about 1 if all is right. */
    pose_status_t status;
    uint32_t used;       /* Beacons. */
    uint32_t iterations; /* Evaluations of all fields. */
    bool tracked;        /* Found from the previous pose. */
} pose_t;

/* Scratch; its contents need not live from call to call. */
typedef struct {
    pose_problem_t problem;
    float origin_m[3];           /* Of the problem's coordinates: the strongest beacon. */
    float point_m[3], normal[3]; /* Half-space in these. */
    pose_candidates_t candidates;
    pose_fit_t best, other, image;
} pose_work_t;

/* Locate with no prior. fields has one entry a beacon of the site, site->count of them. Never fails but by status;
 * fields that are not finite count as not heard. */
void pose_find(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose);

/* Locate from the previous pose, *pose, which is replaced. A previous pose that failed is no start: then as
 * pose_find. */
void pose_track(const pose_site_t *site, const pose_field_t *fields, pose_work_t *work, pose_t *pose);

#endif
