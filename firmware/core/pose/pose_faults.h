/* pose_faults.h: whether fitted fields agree with the site, and how far a fault that stays unseen can move the
 * position: integrity as receivers of satellite navigation monitor it. The one call is pose_faults, after a fit.
 *
 * Method. Linear around the fit, with r_i the whitened residuals of beacon i, T_i its rows in units of the uncertainty
 * of the pose and of the sensor's errors, which are fitted with it, and S_i = I - T_i T_i' the covariance of r_i if all
 * is right. The tests, each a part of the cost that another explanation would take away, with their shares of
 * POSE_FAULTS_FALSE_ALARM:
 *
 *   whole cost, 3 n - 6 degrees of freedom                          0.1
 *   one beacon wrong in any way: r_i' S_i^-1 r_i, three degrees     0.3
 *   one beacon of another strength: along its field, one degree     0.2
 *   all fields of another strength, one degree                      0.2
 *   sensor's axes of unequal gain as well, three degrees            0.1
 *   sensor's axes skewed as well, six degrees                       0.1
 *
 * The limits of single beacons are those of 16 beacons, whatever their number.
 *
 * Level. Whatever fault beacon i has, the position is off by what it differs from that without the beacon, which the
 * residuals tell, and by the error of that one. The level is the greatest radius that the sum of the two exceeds with a
 * probability of POSE_FAULTS_MISSED, over all beacons, and that the noise alone exceeds with POSE_FAULTS_UNLUCKY. It is
 * infinite if a fault of some beacon cannot show in the residuals.
 *
 * Limits. A direction of a beacon's residuals with less than POSE_FAULTS_SHOWN of its variance left is not tested:
 * single precision has lost it. The host's limit is 1e-6.
 *
 * Time: about 6,200 instructions a beacon. Stack: 1.2 kB.
 */
#ifndef GOLDFIELD_POSE_FAULTS_H
#define GOLDFIELD_POSE_FAULTS_H

#include "core/pose/pose_fit.h"

#define POSE_FAULTS_FALSE_ALARM 7e-4f /* Rate of sound cycles that are taken for faulty, of at most 16 beacons. */
#define POSE_FAULTS_MISSED      1e-3f /* Rate of errors beyond the level with the worst fault of one beacon. */
#define POSE_FAULTS_UNLUCKY     1e-7f /* Rate of errors beyond the level without a fault. */
#define POSE_FAULTS_SHOWN       3e-6f /* Least share of variance in the residuals with which a fault can show. */

typedef struct {
    bool alarm;                   /* Fields and site do not agree. */
    float drop[POSE_BEACONS_MAX]; /* Part of the cost that leaving out each beacon would take away. */
    float gain[3];                /* Gains of the sensor's axes, less 1, that would explain the fields best. */
    float level_m;                /* Protection level: 1e30 if it has no bound. */
} pose_faults_t;

/* Test a fit by pose_fit; the problem's weights become those around it. Returns false, with *faults not set, if the
 * measurements do not tell all six unknowns. */
bool pose_faults(pose_problem_t *problem, const pose_fit_t *fit, pose_faults_t *faults);

#endif
