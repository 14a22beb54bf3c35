/* What the statistics of faults and the covariance start from: one epoch around a fitted pose.
 *
 * gf_look_around() whitens the components around the pose, gf_inform() adds them up to the information, gf_split()
 * takes its root, and gf_transform() puts slopes along the principal axes that the root gives.
 */
#ifndef GF_LOCATE_AROUND_H
#define GF_LOCATE_AROUND_H

#include "whiten.h"

/* Whitened components around a pose, and the same slopes weighted for what all components share. Without errors the
 * whitening only has weights. */
typedef struct {
    gf_whitening_t whitening;
    gf_components_t components;
    double weighted[3 * GF_MOST_COILS][6];
} gf_around_t;

/* A pose of the arrays that kernel.h describes: three coordinates and nine elements of a matrix. */
gf_pose_t gf_pose_of(const double *position_m, const double *rotation);

/* Prepare an epoch around a pose. field_T is n x 3, sigma_T n; errors is null if all is exact. */
void gf_look_around(const gf_coils_t *coils, const gf_errors_t *errors, const double *field_T, const double *sigma_T,
                    const gf_pose_t *pose, gf_around_t *out);

/* The components at another pose, whitened as around the first. */
void gf_look(const gf_coils_t *coils, const gf_errors_t *errors, const gf_around_t *around, const gf_pose_t *pose,
             gf_components_t *out);

/* The information of whitened slopes; weighted are the same slopes, weighted for errors that components share. */
void gf_inform(size_t components, double slope[][6], double weighted[][6], double information[6][6]);

/* Split information into a root L of its inverse, L L' on what the measurements tell, and the directions that they
 * do not tell: those columns of root are zero and the unit vector is in free. */
void gf_split(const double information[6][6], double least_eigenvalue, double root[6][6], double free[6][6]);

/* Each row times a 6 x 6 matrix; out may be slope. */
void gf_transform(size_t components, double slope[][6], const double by[6][6], double out[][6]);

#endif
