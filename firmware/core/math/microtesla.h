/* microtesla.h: in which unit fields are computed. Tesla are what goes over the wire and what other modules see; in
 * single precision their squares and products of a few would be too small, so what fits poses and tracks computes in
 * microtesla.
 */
#ifndef GOLDFIELD_MICROTESLA_H
#define GOLDFIELD_MICROTESLA_H

#define MICROTESLA     1e6f /* Microtesla in a tesla. */
#define UT_M3_PER_A_M2 0.1f /* mu0 / (4 pi) in uT m^3 for each A m^2. */

#endif
