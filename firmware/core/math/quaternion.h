/* quaternion.h: unit quaternions x, y, z, w as attitudes, B_site = R B_sensor. Results are normalised, so rounding
 * never accumulates, and no trigonometric functions are needed.
 */
#ifndef GOLDFIELD_QUATERNION_H
#define GOLDFIELD_QUATERNION_H

/* Compute the rotation matrix R of a unit quaternion. Costs about 50 instructions. */
void quaternion_matrix(const float quaternion[4], float matrix[3][3]);

/* Compute the unit quaternion of a matrix that is a rotation but for rounding (Shepperd: from the greatest of its
 * components). */
void quaternion_from_matrix(const float matrix[3][3], float quaternion[4]);

/* Turn an attitude by a small vector of the site's frame, rad: (1, vector/2) times quaternion, exact to second order
 * in the angle; any angle gives a rotation. */
void quaternion_turn(float quaternion[4], const float vector_rad[3]);

/* Compute the turn by a vector, rad, of any length up to 1e6: exact but for rounding. Costs about 60 instructions up to
 * 2 rad. */
void quaternion_exp(const float vector_rad[3], float quaternion[4]);

/* Compute the product of two attitudes: first right, then left. product may be one of them. */
void quaternion_multiply(const float left[4], const float right[4], float product[4]);

#endif
