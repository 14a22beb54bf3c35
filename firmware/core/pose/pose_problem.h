/* pose_problem.h: what a pose is computed from. The site and the fields of one cycle are the caller's; the problem is
 * what the other modules of this folder work on: the beacons that were heard, in metres relative to an origin near the
 * sensor, and in microtesla, where single precision does best. The call is pose_problem, once for each pose.
 *
 * Units: those of the names; the problem's positions are relative to origin_m. Memory: pose_site_t 2.9 kB,
 * pose_problem_t 6.2 kB.
 */
#ifndef GOLDFIELD_POSE_PROBLEM_H
#define GOLDFIELD_POSE_PROBLEM_H

#include <stdbool.h>
#include <stdint.h>

#include "core/pose/loop_field.h"

#define POSE_BEACONS_MAX 64u /* Most beacons of a site: as many as a sensor reports codes. */

typedef struct {
    float position_m[3];
    float axis[3];     /* Direction of the moment, of any length but 0. */
    float moment_A_m2; /* Current times turns times area; 0: it is not there; negative: it points against the axis. */
    float radius_m;    /* Radius of the coil; 0: it is a dipole. */
    float position_sd_m, axis_sd_rad, current_sd; /* Standard deviations of position, axis and moment (relative). */
} pose_beacon_t;

/* What the sensor knows of its surroundings. */
typedef struct {
    uint32_t count; /* Beacons. */
    pose_beacon_t beacons[POSE_BEACONS_MAX];
    float half_space_point_m[3];
    float half_space_normal[3]; /* The sensor is where (p - point) . normal >= 0. 0: there is no half-space. */
    float alert_limit_m;        /* Largest protection level of a pose that is ok, m. */
    float gain_sd, axis_sd_rad; /* Standard deviations of the gains (relative) and directions of the sensor's axes. */
} pose_site_t;

typedef struct {
    float field_T[3]; /* Field in the sensor's frame, separated from the other beacons'. */
    float sigma_T;    /* Standard deviation of a component; not above 0: the beacon was not heard. */
} pose_field_t;

/* One beacon that was heard. */
typedef struct {
    loop_t loop;        /* Its coil, with the centre relative to the origin. */
    float field_uT[3];  /* Its measured field in the sensor's frame. */
    float magnitude_uT; /* The length of that. */
    float sigma_uT;     /* Standard deviation of each component by noise. */
    float position_sd_m, axis_sd_rad, current_sd;
    float whitening[6]; /* Its weights (pose_weights): a lower triangle, row by row. */
    uint32_t row;       /* Its row in the site's table. */
} pose_heard_t;

typedef struct {
    float origin_m[3];           /* Origin of the problem's coordinates: the strongest beacon. */
    float point_m[3], normal[3]; /* The half-space in these coordinates; normal 0: there is none. */
    float alert_limit_m;
    float gain_sd, axis_sd_rad; /* The sensor's. */
    bool exact_beacons;         /* No beacon has any declared error. */
    uint32_t count;             /* Beacons heard. */
    pose_heard_t heard[POSE_BEACONS_MAX];
} pose_problem_t;

/* Make the problem of a site and its fields, which has one entry for each beacon of the site. Fields that are not
 * finite or too large to be squared count as not heard. */
void pose_problem(const pose_site_t *site, const pose_field_t *fields, pose_problem_t *problem);

/* Returns the degrees of freedom of the cost of a fit: 3 for each beacon less 6; three beacons are the least. */
uint32_t pose_problem_freedom(const pose_problem_t *problem);

/* Returns whether the fields are more than noise, which they are by chance in one cycle of a million. */
bool pose_problem_audible(const pose_problem_t *problem);

/* Returns whether a position is in the half-space. */
bool pose_problem_inside(const pose_problem_t *problem, const float position_m[3]);

/* Returns the square of the distance to the nearest beacon that was heard, m^2. */
float pose_problem_nearest2(const pose_problem_t *problem, const float position_m[3]);

/* Reverse all fields; called again it restores them. */
void pose_problem_negate(pose_problem_t *problem);

/* Multiply the fields by a factor for each axis of the sensor. */
void pose_problem_scale(pose_problem_t *problem, const float scale[3]);

/* Take the beacon of a place out of the problem, to behind its end, or, with out = false, put it back to its place. */
void pose_problem_leave_out(pose_problem_t *problem, uint32_t place, bool out);

#endif
