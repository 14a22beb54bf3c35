/* wahba.h: the rotation between two sets of vectors (Wahba's problem): the R that minimises
 * sum_i w_i |site_i - R sensor_i|^2. The calls are wahba_init, wahba_add for each pair, then wahba_loss or
 * wahba_rotation.
 *
 * Method: Markley's fast optimal attitude matrix (J. Astronaut. Sci. 41, 1993). With H = sum w site sensor', the
 * greatest root lambda of
 *   (lambda^2 - |H|^2)^2 - 8 lambda det H - 4 |adj H|^2 = 0
 * gives the least loss, E - 2 lambda with E = sum w (|site|^2 + |sensor|^2), and R in closed form. Newton finds lambda
 * from E/2, an upper bound, from where it only descends. All is scaled by E, so any units do.
 *
 * Accuracy. Single precision leaves 1e-4 of E in the loss and 1e-3 rad in R when the vectors point in clearly
 * different directions: a start for a fit, not a result. With all vectors parallel R is one of many; wahba_rotation
 * still gives a rotation. Where the vectors of one frame are more than twenty times as long as those of the other,
 * Newton does not arrive: the loss is up to 0.035 E too small then, and R is none.
 *
 * Time (Cortex-M4, -O3): wahba_add takes 80 instructions, wahba_loss 180, wahba_rotation 300. Memory: 40 bytes.
 */
#ifndef GOLDFIELD_WAHBA_H
#define GOLDFIELD_WAHBA_H

#define WAHBA_STEPS 12u /* Most steps of Newton. */

typedef struct {
    float h[3][3]; /* H */
    float energy;  /* E */
} wahba_t;

/* Begin without pairs. */
void wahba_init(wahba_t *wahba);

/* Add a pair of vectors, seen in the site's and in the sensor's frame. */
void wahba_add(wahba_t *wahba, const float site[3], const float sensor[3], float weight);

/* Returns the least loss, in the unit of weight times vector squared, which is never negative. */
float wahba_loss(const wahba_t *wahba);

/* Compute the rotation as a unit quaternion x, y, z, w. */
void wahba_rotation(const wahba_t *wahba, float quaternion[4]);

#endif
