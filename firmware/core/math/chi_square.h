/* chi_square.h: the limit that a sum of squares of so many independent normal deviates, whole or not, exceeds with a
 * given probability (Wilson and Hilferty, 1931). It is inline and takes about 25 instructions.
 *
 * Accuracy: the limit is too great by at most 1.3 % from 18 degrees of freedom on and 7 % with 3, at a probability of
 * 1e-6; at 1 % it is so by less than 0.3 %.
 */
#ifndef GOLDFIELD_CHI_SQUARE_H
#define GOLDFIELD_CHI_SQUARE_H

#include "core/math/roots.h"

/* Returns the chi-square that is exceeded with the probability with which a normal deviate exceeds deviate. */
static inline float chi_square_limit(float freedom, float deviate) {
    const float part = 2.0f / (9.0f * freedom);
    const float root = 1.0f - part + deviate * square_root(part);
    return freedom * root * root * root;
}

#endif
