/* coil.h: a beacon's coil and its driver.
 *
 * coil_init() makes a coil at rest; coil_input(), coil_enable(), coil_reference() and coil_open() change what drives
 * it, in order of time; coil_current(), coil_lagged() and coil_sense() look at it.
 *
 * The driver is an H-bridge with a fast current loop. Bridge inputs (1, 2) = (high, low) ask for +set-point, (low,
 * high) for -set-point, equal inputs for zero; with the bridge disabled the diodes put the supply against the current
 * until it is zero. The set-point is the reference voltage times reference_A_per_V. Until the current has arrived, the
 * bridge gives all it has:
 *
 *     L di/dt = +-V - R i      i(t) = +-V/R + (i0 -+ V/R) exp(-t R/L)       (Kirchhoff; +-V toward the target)
 *
 * then the loop holds it. Each change of an input starts a segment of this form, so current and lagged current are
 * exact at any time. The lagged current is the current through a first-order low-pass of lag_s (the sensor's
 * bandwidth), solved in the same closed form.
 *
 * One thread changes a coil, another may look at its past at the same time: the reader uses a head that it got before
 * (coil_t.head), and segments are not rewritten as long as no more than COIL_CHANGES_MAX changes happen in one quantum
 * (lockstep.h); `changes` counts them.
 *
 * Times are picoseconds of virtual time and must not decrease from change to change. Each call is bounded: one exp or
 * two, and at most COIL_HISTORY segments looked at. Bad values (resistance or inductance not above 0) are refused by
 * scenario.py.
 */
#ifndef GOLDFIELD_WORLD_COIL_H
#define GOLDFIELD_WORLD_COIL_H

#include <stdbool.h>
#include <stdint.h>

#define COIL_HISTORY     256
#define COIL_CHANGES_MAX 64

typedef struct {
    double inductance_H;   /* Above 0. */
    double resistance_Ohm; /* Above 0. */
    double supply_V;
    double reference_A_per_V; /* Set-point per volt of reference: 16 A / 3.3 V and the driver's gain error. */
    double sense_V_per_A;     /* 0.103125 V/A and the sense amplifier's gain error. */
    double sense_noise_V;     /* Standard deviation of one look at the sense output. */
    double lag_s;             /* Time constant of the low-pass of the sensor that looks; 0: there is none. */
} coil_config_t;

typedef struct {
    int64_t start_ps;
    double current_A; /* Current at the start. */
    double lagged_A;  /* Lagged current at the start. */
    double limit_A;   /* Where the supply alone would bring the current: +-V/R. */
    double target_A;  /* Where the loop holds it. */
    double reach_s;   /* Time from the start to the arrival at the target; infinite if the current never arrives. */
    double lagged_at_reach_A;
} coil_segment_t;

typedef struct {
    coil_config_t config;
    double time_constant_s; /* L/R. */
    bool input1, input2, enabled;
    bool open;          /* Fault: no current can flow. */
    bool sense_shorted; /* Fault: the sense output lies at 0 V. */
    double set_point_A;
    uint64_t head;    /* Number of the latest segment. */
    unsigned changes; /* Segments since it was last set to 0. */
    coil_segment_t segments[COIL_HISTORY];
} coil_t;

/* Make a coil without current, its bridge disabled. */
void coil_init(coil_t *coil, const coil_config_t *config);

/* A bridge input, number 1 or 2; the bridge's enable; the reference voltage; the fault of a broken wire. */
void coil_input(coil_t *coil, unsigned number, bool level, int64_t time_ps);
void coil_enable(coil_t *coil, bool enabled, int64_t time_ps);
void coil_reference(coil_t *coil, double volts, int64_t time_ps);
void coil_open(coil_t *coil, bool open, int64_t time_ps);

/* Returns the current at a time, ampere, as seen from the present; times after the last change are included. */
double coil_current(const coil_t *coil, int64_t time_ps);

/* Returns the lagged current at a time not before the history, ampere, looking no further than segment head. */
double coil_lagged(const coil_t *coil, uint64_t head, int64_t time_ps);

/* Returns the volts at the sense output: 1.65 V + gain * current + noise; stream is the noise's (noise.h). */
double coil_sense(const coil_t *coil, uint64_t seed, uint64_t stream, int64_t time_ps);

#endif
