/* current.h: keeps the amplitude of the coil current, starts it softly, and stops it when something is wrong.
 *
 * The driver makes +-reference amperes by itself, chip by chip; its gain is not exact. Once a chip, just before the chip ends, the current is measured. Its magnitude
 * (the sign is the code's) is averaged over CURRENT_BLOCK_CHIPS; at the end of each such block an integrator corrects the reference:
 *   trim += (target - mean) / 4;   reference = target + trim
 * target is the ramped amplitude: it moves toward the amplitude by amplitude / CURRENT_RAMP_BLOCKS a block (from 0 to full in 33 blocks = 1023 chips = 0.1 s). The error
 * falls by a factor 4 / (4 - g) a block for a driver of gain g, stable for 0 < g < 8. trim is limited to a quarter of the amplitude: a driver that is further
 * off stays short of the target, and the status shows it.
 *
 * Protections, on every single measurement:
 *   over-current: |current| above the limit.
 *   open coil: |current| below open_fraction of the target of that moment, once the target is past a quarter of the amplitude
 *   (chip 256 of the ramp) and at least CURRENT_OPEN_MINIMUM_A.
 * Either is a fault: the call says CURRENT_DRIVE_OFF, within that chip, and so does every call until current_clear.
 *
 * Units. The sense counts 0..4095, 2048 is 0 A; sense_A is A per count; the reference counts 0..4095 of reference_A each. Counts outside 0..4095, and the
 * rails 0 and 4095, are over-current: what lies beyond them is unknown.
 *
 * Contexts: current_sample belongs to the interrupt of the current sense. The others are for main, and write single words the interrupt reads,
 * so that no order of interruption can tear them; current_configure only while the state is CURRENT_OFF.
 */
#ifndef GOLDFIELD_CURRENT_H
#define GOLDFIELD_CURRENT_H

#include <stdbool.h>
#include <stdint.h>

#define CURRENT_BLOCK_CHIPS 31u
#define CURRENT_RAMP_BLOCKS 33u
#define CURRENT_OPEN_MINIMUM_A 0.125f

typedef struct {
    float sense_A;        /* A per count of the sense, > 0. */
    float reference_A;    /* A per count of the reference, > 0. */
    float amplitude_A;    /* Wanted, 0..2047 counts of the sense. */
    float over_current_A; /* Limit; more than 2046 counts of the sense is taken as that. */
    float open_fraction;  /* 0..1; 0 switches the open-coil protection off. */
} current_config_t;

typedef enum { CURRENT_OFF = 0, CURRENT_RAMPING = 1, CURRENT_HOLDING = 2, CURRENT_FAULT = 3 } current_state_t;
typedef enum { CURRENT_FAULT_NONE = 0, CURRENT_FAULT_OVER = 1, CURRENT_FAULT_OPEN = 2 } current_fault_t;
typedef enum {
    CURRENT_KEEP = 0,
    CURRENT_SET_REFERENCE = 1, /* Hand current_t.reference to the driver. */
    CURRENT_DRIVE_OFF = 2      /* Switch the bridge off at once. */
} current_action_t;

/* The caller owns it. Amounts are counts of the sense with 16 fractional bits. */
typedef struct {
    /* Results, for reading. */
    uint8_t state;      /* current_state_t */
    uint8_t fault;      /* current_fault_t, why the state is CURRENT_FAULT. */
    uint16_t reference; /* Counts, for the driver. */
    uint32_t mean;      /* Mean magnitude in the last full block. */
    uint32_t target;    /* Ramped amplitude. */
    /* Private. */
    uint32_t amplitude, step;
    int32_t trim;
    uint32_t sum;
    uint16_t chips;
    uint16_t over_count, open_count; /* A magnitude above, or below, is a fault. */
    uint32_t open_fraction;          /* 16 fractional bits. */
    uint32_t open_minimum;
    uint32_t reference_scale; /* Counts of reference for a count of sense, 16 fractional bits. */
    float sense_A;
} current_t;

/* Take a configuration; state becomes CURRENT_OFF, faults are cleared. False, and nothing done, if a value is outside its range or not a number. */
bool current_configure(current_t *current, const current_config_t *config);

/* Begin the ramp from 0; only from CURRENT_OFF, otherwise nothing happens. Call it when the first driven chip begins. */
void current_start(current_t *current);

/* To CURRENT_OFF; a fault stays until current_clear. */
void current_stop(current_t *current);

/* From CURRENT_FAULT to CURRENT_OFF. */
void current_clear(current_t *current);

/* Interrupt, once a chip, with the sense's count; only for chips that are driven. In CURRENT_OFF it says CURRENT_KEEP, in CURRENT_FAULT CURRENT_DRIVE_OFF.
 * About 35 instructions, once in CURRENT_BLOCK_CHIPS about 100. */
current_action_t current_sample(current_t *current, uint16_t count);

/* Amperes of an amount (mean, target). */
float current_amperes(const current_t *current, uint32_t amount);

#endif
