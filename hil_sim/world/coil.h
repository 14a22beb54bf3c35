/* coil.h: a beacon's coil and its driver.
 *
 * coil_init() makes a coil at rest; coil_input(), coil_enable(), coil_reference(), coil_supply() and coil_fault()
 * change what drives it, in order of time; coil_current(), coil_lagged(), coil_sense(), coil_bus() and
 * coil_temperature() look at it.
 *
 * The driver is an H-bridge with a fast current loop. Bridge inputs (1, 2) = (high, low) ask for +set-point, (low,
 * high) for -set-point, equal inputs for zero; with the bridge disabled the diodes put the supply against the current
 * until it is zero. The set-point is the reference voltage times reference_A_per_V, plus reference_offset_A; a driver
 * may do more in one direction than in the other (asymmetry), and dc_error_A adds to what it makes in either. Until the
 * current has arrived, the bridge gives all it has:
 *
 *     L di/dt = +-V - (R + Rs) i      i(t) = lim + (i0 - lim) exp(-t/T),  lim = +-V/(R + Rs),  T = L/(R + Rs)
 *
 * (Kirchhoff; +-V toward the target), then the loop holds it; a current that is held but that a sagging supply no
 * longer carries falls to lim. Rs is the resistance of the supply. It takes what the coil gives back when the current
 * is driven down (fly-back), so that the bridge's voltage is then V + Rs |i|. For dead_time_s after each change of an
 * input both halves of the bridge are off, and the diodes conduct as when it is disabled. A loop that acts
 * driver_delay_s late overshoots by (V - R |i|) delay / L, which a shorted coil makes large.
 *
 * Shorted turns (a share f of all) are a winding of their own, on which the rest (1 - f) works as a transformer does:
 *
 *     L1 di/dt + M di2/dt = +-V - ((1 - f) R + Rs) i        L1 = (1 - f)^2 Lx, L2 = f^2 Lx, M = k f (1 - f) Lx
 *     M di/dt + L2 di2/dt = -f R i2                         L1 + 2 M + L2 = L,  k the coupling of the two
 *
 * Both turn the same way, and at the short's beginning they carry the same current. A fast edge sees L1 - M^2 / L2
 * alone; where the driver holds i, i2 dies away with L2 / (f R). The field is that of (1 - f) i + f i2, and it is this
 * which the sensor's low-pass takes. When the short ends, the flux (L1 + M) i + (M + L2) i2 stays.
 *
 * The copper has resistance_Ohm at 20 degC and 0.393 % more for each kelvin above. The coil's temperature follows
 *
 *     C dT/dt = R i^2 - (T - ambient) / Rth
 *
 * with R as of the last change of an input; thermal_resistance_K_per_W 0 keeps the coil at the ambient's.
 *
 * Each change of an input starts a segment of this form, so current and lagged current are exact at any time; changes
 * at one moment start one, which is made when somebody looks at the coil as it is now (coil_head() and the like). The
 * lagged current is the current through a first-order low-pass of lag_s (the sensor's bandwidth), solved in the same
 * closed form.
 *
 * One thread changes a coil, another may look at its past at the same time: the reader uses a head that it got before
 * (coil_t.head), and segments are not rewritten as long as no more than COIL_CHANGES_MAX changes happen in one step
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

#include "world/coil_law.h"

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
    /* All of these may be 0. */
    double source_Ohm;         /* Resistance of the supply, Rs. */
    double reference_offset_A; /* Adds to the magnitude of the set-point, unless the reference is 0 V. */
    double asymmetry;          /* The set-point is (1 + this) larger for positive currents, (1 - this) for negative. */
    double dc_error_A;         /* Adds to the current that the loop holds while the bridge drives. */
    double dead_time_s;
    double driver_delay_s;
    double driver_limit_A; /* The driver's own limit of the current, whatever the loop does; 0: it has none. */
    double ambient_degC;
    double thermal_resistance_K_per_W; /* From coil to ambient; 0: the coil has the ambient's temperature. */
    double heat_capacity_J_per_K;      /* The coil's; above 0 if the thermal resistance is. */
    double shorted_fraction;           /* Share of the turns that COIL_SHORTED shorts, f, 0..1, without 1. */
    double shorted_coupling;           /* Coupling of these turns to the rest, k, between 0 and 1. */
} coil_config_t;

/* What may be wrong with a coil, its driver or its current sense. */
typedef enum {
    COIL_OPEN = 0,     /* No current can flow. */
    COIL_SHORTED = 1,  /* Turns are shorted, as said above. */
    COIL_RUNAWAY = 2,  /* The driver's loop is gone: an enabled bridge gives the full supply in the asked direction. */
    COIL_STUCK_ON = 3, /* A half of the bridge is shorted: the full supply, positive, whatever inputs and enable say. */
    COIL_SENSE_LOW = 4,      /* The sense output lies at 0 V. */
    COIL_SENSE_HELD = 5,     /* The sense output stays where it was when somebody last looked. */
    COIL_BRIDGE_SWAPPED = 6, /* The bridge's inputs are exchanged: the current flows the other way, and is sensed so. */
    COIL_REVERSED = 7, /* The coil's wires are exchanged behind the sense: it flows the other way in the coil alone. */
    COIL_FAULTS = 8
} coil_fault_t;

/* What a segment ends with, apart from the rest and short, for those who look at many coils: from since_ps on the
 * lagged current is limit_A + rest_A exp(-(time - since_ps) / lag), if simple. */
typedef struct {
    int64_t start_ps; /* The segment's. */
    double since_s;   /* From the segment's start on. */
    double limit_A, rest_A;
} coil_brief_t;

typedef struct {
    coil_config_t config;
    bool input1, input2, enabled;
    bool fault[COIL_FAULTS];
    bool other_circuit; /* Supply or faults have changed since the latest segment. */
    bool waits;         /* Something has changed at waits_ps, and has no segment yet; */
    int64_t waits_ps;
    double waits_dead_s; /* the bridge is off for so long. */
    double supply_V;     /* The supply's present voltage without load. */
    double set_point_A;
    double temperature_degC;           /* As of the latest segment's start. */
    double sense_V;                    /* What was last seen at the sense output. */
    uint64_t head;                     /* Number of the latest segment. */
    uint64_t made;                     /* Segments that were made so far. */
    unsigned changes;                  /* Segments since it was last set to 0. */
    coil_brief_t briefs[COIL_HISTORY]; /* What the segments end with. */
    coil_segment_t segments[COIL_HISTORY];
} coil_t;

/* Make a coil without current, its bridge disabled. */
void coil_init(coil_t *coil, const coil_config_t *config);

/* A bridge input, number 1 or 2; the bridge's enable; the reference voltage; the supply's voltage; a fault. */
void coil_input(coil_t *coil, unsigned number, bool level, int64_t time_ps);
void coil_enable(coil_t *coil, bool enabled, int64_t time_ps);
void coil_reference(coil_t *coil, double volts, int64_t time_ps);
void coil_supply(coil_t *coil, double volts, int64_t time_ps);
void coil_fault(coil_t *coil, coil_fault_t fault, bool active, int64_t time_ps);

/* Let go of what was before a time, at which nobody looks any more, so that the latest segments stay together in
 * memory. Segments get new numbers; nobody may look at the coil meanwhile. */
void coil_forget(coil_t *coil, int64_t before_ps);

/* Returns the number of the latest segment, which the looks below take: any that this function has told, and that are
 * not forgotten. */
uint64_t coil_head(coil_t *coil);

/* Returns the current at a time, ampere, as seen from the present; times after the last change are included. */
double coil_current(coil_t *coil, int64_t time_ps);

/* Returns the lagged current at a time not before the history, ampere, looking no further than segment head; with
 * shorted turns that of the field. */
double coil_lagged(const coil_t *coil, uint64_t head, int64_t time_ps);

/* A view of the lagged current from a time t on: limit_A + rest_A exp(-(time - t) / lag) until until_ps, with the rest
 * below a millionth of a millionth of the limit, and 0 if it changes no bit of the sum. If the current has another
 * form, until_ps is t. number is the segment's; INT64_MAX as the end says that it was the head. */
typedef struct {
    double limit_A, rest_A;
    int64_t until_ps;
    uint64_t number;
} coil_view_t;

/* Returns the view from a time on, not before the history, looking no further than segment head. It is found fast if
 * guess is the number of its segment, or of the one before. */
coil_view_t coil_view(const coil_t *coil, uint64_t head, uint64_t guess, int64_t time_ps);

/* Returns the current in the shorted turns at a time, ampere, as coil_current does; 0 without them. */
double coil_second(coil_t *coil, int64_t time_ps);

/* Returns the volts at the sense output: 1.65 V + gain * current + noise; stream is the noise's (noise.h). A coil that
 * warms up takes its present resistance into account from here on, if it has not for 10 ms. */
double coil_sense(coil_t *coil, uint64_t stream, int64_t time_ps);

/* Returns the volts of the supply at the bridge at the present: with its load, and with the fly-back. */
double coil_bus(coil_t *coil, int64_t time_ps);

/* Returns the temperature of the copper at the present, degC. */
double coil_temperature(coil_t *coil, int64_t time_ps);

/* Returns the volts of a thermistor (10 kOhm at 25 degC, B 3950) to ground below 10 kOhm to 3.3 V. */
double thermistor_volts(double temperature_degC);

#endif
