/* ambient.h: the field of everything that is not a beacon, in the site's frame, tesla. ambient_field() is the only
 * call.
 *
 *     earth      constant
 *     mains      mains_T * sum over h = 1.. of harmonics[h-1] * sin(h (2 pi f t + phase))
 *     impulses   a Poisson process of impulse_rate_Hz; each is amplitude * direction * exp(-(t - t0)/decay), the
 *                direction uniform on the sphere
 *
 * Mains and impulses pass the same first-order low-pass (lag_s) as the coils, in closed form.
 *
 * The field is a function of the time alone (noise.h), so any number of sensors may ask in any order. Time of a call: a
 * few sines, and with impulses the numbers of the last 20 decay times. An impulse still contributes e^-20 of its
 * amplitude when it is dropped.
 */
#ifndef GOLDFIELD_WORLD_AMBIENT_H
#define GOLDFIELD_WORLD_AMBIENT_H

#include <stdint.h>

#define AMBIENT_HARMONICS 16

typedef struct {
    uint64_t seed;
    double earth_T[3];
    double mains_Hz; /* 0: there are no mains. */
    double mains_T[3];
    double mains_phase_rad;
    double harmonics[AMBIENT_HARMONICS]; /* Relative amplitudes of 1, 2, ... times mains_Hz. */
    double impulse_rate_Hz;              /* Impulses per second; 0: there are none. */
    double impulse_T;                    /* Amplitude of each. */
    double impulse_decay_s;              /* Above 0 if there are impulses. */
    double lag_s;                        /* Time constant of the low-pass; 0: there is none. */
} ambient_t;

/* The field at a time, picoseconds. */
void ambient_field(const ambient_t *ambient, int64_t time_ps, double field_T[3]);

#endif
