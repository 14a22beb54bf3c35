/* quaternion.h: unit quaternions x, y, z, w as attitudes, B_site = R B_sensor. Results are normalised, so rounding
 * never accumulates, and no trigonometric functions are needed.
 */
#ifndef GOLDFIELD_QUATERNION_H
#define GOLDFIELD_QUATERNION_H

/* Compute the rotation matrix R of a unit quaternion. Costs about 50 instructions. */
void quaternion_matrix(const float quaternion[4], float matrix[3][3]);

/* Compute the unit quaternion nearest to a matrix that is a rotation but for rounding and scale (Shepperd: from the
 * greatest of its components). */
void quaternion_from_matrix(const float matrix[3][3], float quaternion[4]);

/* Turn an attitude by a small vector of the site's frame, rad: (1, vector/2) times quaternion, exact to second order
 * in the angle; any angle gives a rotation. */
void quaternion_turn(float quaternion[4], const float vector_rad[3]);

#endif
