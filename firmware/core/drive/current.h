/* current.h: keeps the amplitude of one coil's current, starts it softly, and stops it when something is wrong.
 *
 * The driver makes the set-point's amperes by itself, chip by chip, in the direction of the bridge; its gain is not
 * exact. The planner asks for a level between -1 and 1 of the reference in each chip, a block or two ahead; the current
 * is measured once a chip, just before the chip ends. The gain is the slope of the line through what was asked and what
 * came (least squares), old chips forgotten: after every CURRENT_BLOCK_CHIPS driven chips
 *   each sum = 7/8 of itself + that over the block, of 1, s, i, s i, s s;   gain = (n Ssi - Ss Si) / (n Sss - Ss Ss),
 *     n = S1 + 1;   reference = target / gain
 * The 1 in n is a chip that asked for nothing and got nothing: it decides where all chips ask the same, as a pulse
 * does. The intercept, the offset of the sense, is of no account. What is planned ahead comes into the measure as it
 * was planned: how far ahead does not matter, there is nothing to oscillate, and chips near zero count for little. The
 * error of the gain falls to 7/8 a block (to 1/e in 25 ms). The reference stays within a quarter of what a driver
 * without error needs: one that is further off stays short of the target, and the status shows it. target is the ramped
 * amplitude: it moves by amplitude / CURRENT_RAMP_BLOCKS a block (from 0 to full in 33 blocks = 1023 driven chips = 0.1
 * s).
 *
 * Protections, on every single measurement:
 *   over-current: |current| above the limit.
 *   open coil: the current in the asked direction is below open_fraction of what was asked (by the estimated gain), in
 *     chips that ask for more than a quarter of the
 *   amplitude, and than CURRENT_OPEN_MINIMUM_A. So neither the first quarter of the ramp, nor zeros of a sinusoid, nor
 *     cancelling codes are an open coil; a sense of the wrong sign is one.
 * Either is a fault: the call says false, within that chip, and so does every call until current_clear.
 *
 * Units. The sense counts 0..4095, 2048 is 0 A; sense_A is A per count; the reference counts 0..4095 of reference_A
 * each. Counts outside 0..4095, and the rails 0 and 4095, are over-current: what lies beyond them is unknown.
 *
 * Contexts: current_sample belongs to the interrupt of the current sense, and uses the floating-point unit. The others
 * are for main, and write single words the interrupt reads, so that no order of interruption can tear them;
 * current_configure only while the state is CURRENT_OFF. The planner reads reference alone.
 */
#ifndef GOLDFIELD_CURRENT_H
#define GOLDFIELD_CURRENT_H

#include <stdbool.h>
#include <stdint.h>

#define CURRENT_BLOCK_CHIPS    31u
#define CURRENT_RAMP_BLOCKS    33u
#define CURRENT_OPEN_MINIMUM_A 0.125f

typedef struct {
    float sense_A;        /* A per count of the sense, > 0. */
    float reference_A;    /* A per count of the reference, > 0, 1/1024 to 8 times sense_A. */
    float amplitude_A;    /* Wanted at level 1, 0..2047 counts of the sense. */
    float over_current_A; /* Limit; more than 2046 counts of the sense is taken as that. */
    float open_fraction;  /* 0..1; 0 switches the open-coil protection off. */
} current_config_t;

typedef enum { CURRENT_OFF = 0, CURRENT_RAMPING = 1, CURRENT_HOLDING = 2, CURRENT_FAULT = 3 } current_state_t;
typedef enum { CURRENT_FAULT_NONE = 0, CURRENT_FAULT_OVER = 1, CURRENT_FAULT_OPEN = 2 } current_fault_t;

/* The caller owns it. */
typedef struct {
    /* Results, for reading. */
    uint8_t state;      /* current_state_t */
    uint8_t fault;      /* current_fault_t, why the state is CURRENT_FAULT. */
    uint16_t reference; /* Set-point of level 1, counts; 0 while the state is CURRENT_OFF or CURRENT_FAULT. */
    float measured_A;   /* Current at level 1: the reference by the estimated gain. */
    float target_A;     /* Ramped amplitude. */
    /* Private. */
    current_config_t config;
    float count, asked, came, product, square; /* The sums that forget, counts of set-point and of sense. */
    int32_t block_asked, block_came, block_product, block_square; /* Of the present block: at most 31 * 4095 * 4095. */
    uint16_t chips;
    uint16_t over_count; /* A magnitude above is a fault. */
    uint16_t open_above; /* Counts of set-point with which the coil must not be open. */
    uint32_t open_scale; /* Least counts of sense for a count of set-point, 16 fractional bits. */
} current_t;

/* Take a configuration; state becomes CURRENT_OFF, faults are cleared. False, and nothing done, if a value is
 * outside its range or not a number. */
bool current_configure(current_t *current, const current_config_t *config);

/* Begin the ramp from 0; only from CURRENT_OFF, otherwise nothing happens. Call it when the first driven chip
 * begins. */
void current_start(current_t *current);

/* To CURRENT_OFF; a fault stays until current_clear. */
void current_stop(current_t *current);

/* From CURRENT_FAULT to CURRENT_OFF. */
void current_clear(current_t *current);

/* Interrupt, once a chip, only for chips that are driven (level not 0): what was asked, counts of set-point with the
 * bridge's sign, -4095..4095, and the sense's count. False: switch the bridge off at once. In CURRENT_OFF it says
 * true, in CURRENT_FAULT false. About 55 instructions, once in CURRENT_BLOCK_CHIPS about 160. */
bool current_sample(current_t *current, int16_t set_point, uint16_t count);

#endif
