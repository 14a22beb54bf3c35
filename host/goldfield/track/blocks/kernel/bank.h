/* bank.h: the block filter of firmware/core/track for the host, with arrays of doubles in SI units (T, m, rad, s) in
 * place of its structures, so that Python need not know these.
 *
 * Calls: gf_bank_size tells how much memory, aligned for any type, the caller provides for a bank; then gf_bank_init,
 * and the calls of block_filter.h. A state has 19 numbers: position, quaternion x, y, z, w, velocity, turn rate,
 * ambient field, offset; a covariance 18 x 18, row by row.
 */
#ifndef GOLDFIELD_BANK_H
#define GOLDFIELD_BANK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Returns the bytes of a bank. */
size_t gf_bank_size(void);

/* Begin without a track; each coil has eight numbers: centre, axis (a unit vector), moment in A m^2, radius. */
void gf_bank_init(void *bank, uint32_t count, const double *coils);

void gf_bank_start(void *bank, const double *state, const double *covariance);

/* Take a block of count + 1 columns, with the standard deviation of a component of a sample.
 * Returns whether any filter took it; *log_likelihood is then the logarithm of its likelihood. */
bool gf_bank_update(void *bank, const double *gram, const double *moment, const double *sums_T, double noise_T,
                    double seconds, double *log_likelihood);

void gf_bank_predict(void *bank, double seconds);

/* Compute the state so many seconds later, the rotation matrix of its quaternion, 3 x 3, row by row, its covariance,
 * and the agility that the sensor seems to have. */
void gf_bank_output(const void *bank, double seconds, double *state, double *rotation, double *covariance,
                    double agility[2]);

#endif
