/* front_end.h: a three-axis magnetoresistive sensor and its amplifier, up to the converter's pin. front_end_init(),
 * then front_end_volts() for each conversion.
 *
 *     volts[a] = 1.65 V + (sum over s of gain[a][s] B[s] + offset_T[a] + noise) * 1.65 V / range_T + converter noise
 *
 * gain holds the gain errors and the misalignment. The bandwidth acts before, on the sources (coil.h and ambient.h, in
 * closed form): the field per ampere of a moving sensor is taken at the present instead of one lag ago, an error of lag
 * * speed (1.6 um at 1 m/s and 100 kHz).
 *
 * Noise. noise_T is the standard deviation of one chip's sample: one number per burst and axis, so that averaging a
 * burst does not change it. Conversions of an axis belong to one burst as long as each comes less than
 * FRONT_END_BURST_PS after the one before. The converter's own noise is independent from conversion to conversion.
 * Quantisation and clamping belong to the converter.
 *
 * Faults. front_end_break() makes an axis fail from its next conversion on: behind the amplifier, at the pin, or in the
 * converter itself, whose result the pin's voltage then stands for. front_end_fault_t says how.
 *
 * Times of one axis must not decrease. Time of a call: a normal number, and one more for the first of a burst.
 */
#ifndef GOLDFIELD_WORLD_FRONT_END_H
#define GOLDFIELD_WORLD_FRONT_END_H

#include <stdbool.h>
#include <stdint.h>

#define FRONT_END_BURST_PS 20000000 /* 20 us. */

typedef struct {
    double gain[3][3]; /* gain[a][s]: axis a of the sensor by component s of the field in its frame. */
    double offset_T[3];
    double range_T;           /* The field at 3.3 V; at 0 V it is as much the other way. */
    double noise_T;           /* Standard deviation of one chip's sample. */
    double converter_noise_V; /* Standard deviation of one conversion. */
} front_end_config_t;

typedef enum {
    FRONT_END_SOUND = 0,
    FRONT_END_HELD = 1,     /* The pin stays at the voltage of its last conversion. */
    FRONT_END_LOW = 2,      /* It lies at 0 V ... */
    FRONT_END_HIGH = 3,     /* ... or at 3.3 V. */
    FRONT_END_GAIN = 4,     /* What differs from the middle is multiplied by value: -1 reverses the axis. */
    FRONT_END_OTHER = 5,    /* The pin is wired to the axis with the number value. */
    FRONT_END_BIT_HIGH = 6, /* The bit with the number value of each result, 0..11, is 1 ... */
    FRONT_END_BIT_LOW = 7   /* ... or 0. */
} front_end_fault_t;

typedef struct {
    front_end_config_t config;
    uint64_t chip_stream[3], converter_stream[3]; /* Those of the noise (noise.h). */
    int64_t burst_start_ps[3], last_ps[3];
    double chip_noise[3]; /* That of the burst, as drawn at drawn_ps; -1: not yet. */
    int64_t drawn_ps[3];
    front_end_fault_t fault[3];
    double value[3];  /* That of the fault. */
    double last_V[3]; /* Voltage of the last conversion. */
} front_end_t;

void front_end_init(front_end_t *front_end, const front_end_config_t *config, uint64_t seed, unsigned board);

/* Let an axis (0..2) fail from now on, or be sound again. value as front_end_fault_t says, else any. */
void front_end_break(front_end_t *front_end, unsigned axis, front_end_fault_t fault, double value);

/* Returns the volts at the pin of an axis (0..2) for a field in the sensor's frame. */
double front_end_volts(front_end_t *front_end, unsigned axis, const double field_T[3], int64_t time_ps);

#endif
