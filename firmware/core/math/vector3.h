/* vector3.h: the few operations on vectors of three floats that the core needs. They are inline, and each takes a
 * handful of instructions. */
#ifndef GOLDFIELD_VECTOR3_H
#define GOLDFIELD_VECTOR3_H

static inline float vector3_dot(const float a[3], const float b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline void vector3_cross(const float a[3], const float b[3], float product[3]) {
    product[0] = a[1] * b[2] - a[2] * b[1];
    product[1] = a[2] * b[0] - a[0] * b[2];
    product[2] = a[0] * b[1] - a[1] * b[0];
}

static inline void vector3_subtract(const float a[3], const float b[3], float difference[3]) {
    difference[0] = a[0] - b[0];
    difference[1] = a[1] - b[1];
    difference[2] = a[2] - b[2];
}

#endif
