/* current.h: keeps the amplitude of one coil's current, starts it softly, and stops it when something is wrong.
 *
 * Calls, in the order they are made
 *   1. current_configure  while the state is CURRENT_OFF.
 *   2. current_start      when the first driven chip begins; the planner reads reference for the set-points.
 *   3. current_sample     once a driven chip, from the interrupt of the current sense.
 *   4. current_stop       at the end; current_clear after a fault.
 *
 * Method. The driver makes the set-point's amperes by itself, chip by chip, in the direction of the bridge; its gain
 * is not exact. The planner asks for a level between -1 and 1 of the reference in each chip, a block or two ahead; the
 * current is measured once a chip, just before the chip ends. The gain is the slope of the line through what was asked
 * (s) and what came (i) by least squares, with old chips forgotten. After every CURRENT_BLOCK_CHIPS driven chips
 *   each sum = 7/8 of itself + that over the block, of 1, s, i, s i, s s;
 *   gain = (n Ssi - Ss Si) / (n Sss - Ss Ss),   n = S1 + 1;
 *   reference = target / gain.
 * The 1 in n is a chip that asked for nothing and got nothing: it decides where all chips ask the same, as a pulse
 * does. The intercept, the offset of the sense, is of no account. What is planned ahead comes into the measure as it
 * was planned: how far ahead does not matter, there is nothing to oscillate, and chips near zero count for little. The
 * error of the gain falls to 7/8 a block (to 1/e in 25 ms). The reference stays within a quarter of what a driver
 * without error needs: one that is further off stays short of the target, and the status shows it. target is the
 * ramped amplitude: it moves by amplitude / CURRENT_RAMP_BLOCKS a block (from 0 to full in 33 blocks = 1023 driven
 * chips = 0.1 s).
 *
 * Protections, on every single measurement
 *   over-current  |current| is above the limit.
 *   open coil     The current in the asked direction is below open_fraction of what was asked (by the estimated gain),
 *                 in a chip that asks for more than a quarter of the amplitude and than CURRENT_OPEN_MINIMUM_A. So
 *                 neither the first quarter of the ramp, nor zeros of a sinusoid, nor cancelling codes are an open
 *                 coil; a sense of the wrong sign is one.
 * Either is a fault: current_sample returns false, within that chip, and so does every call until current_clear.
 *
 * Units. The sense counts 0..4095, 2048 is 0 A; sense_A is A per count. The reference counts 0..4095 of reference_A
 * each. Counts outside 0..4095, and the rails 0 and 4095, are over-current: what lies beyond them is unknown.
 *
 * Contexts: current_sample belongs to the interrupt of the current sense, and uses the floating-point unit. The others
 * are for main, and write single words that the interrupt reads, so that no order of interruption can tear them;
 * current_configure only while the state is CURRENT_OFF. The planner reads reference alone.
 */
#ifndef GOLDFIELD_CURRENT_H
#define GOLDFIELD_CURRENT_H

#include <stdbool.h>
#include <stdint.h>

#define CURRENT_BLOCK_CHIPS    31u    /* Driven chips between two estimates of the gain. */
#define CURRENT_RAMP_BLOCKS    33u    /* Blocks from 0 to full amplitude: 1023 driven chips, 0.1 s. */
#define CURRENT_OPEN_MINIMUM_A 0.125f /* Largest current asked for with which an open coil is not looked for, A. */

typedef struct {
    float sense_A;        /* Current for a count of the sense, A, > 0. */
    float reference_A;    /* Current for a count of the reference, A, > 0, 1/1024 to 8 times sense_A. */
    float amplitude_A;    /* Current wanted at level 1, A, 0..2047 counts of the sense. */
    float over_current_A; /* Limit of the magnitude, A; more than 2046 counts of the sense is taken as that. */
    float open_fraction;  /* Least share of what was asked, 0..1; 0 switches the open-coil protection off. */
} current_config_t;

typedef enum { CURRENT_OFF = 0, CURRENT_RAMPING = 1, CURRENT_HOLDING = 2, CURRENT_FAULT = 3 } current_state_t;
typedef enum { CURRENT_FAULT_NONE = 0, CURRENT_FAULT_OVER = 1, CURRENT_FAULT_OPEN = 2 } current_fault_t;

/* The caller owns it. */
typedef struct {
    /* Results, for reading. */
    uint8_t state;      /* A current_state_t. */
    uint8_t fault;      /* A current_fault_t: why the state is CURRENT_FAULT. */
    uint16_t reference; /* Set-point of level 1, counts; 0 while the state is CURRENT_OFF or CURRENT_FAULT. */
    float measured_A;   /* Current at level 1, A: the reference by the estimated gain. */
    float target_A;     /* Ramped amplitude, A. */
    /* Private. */
    current_config_t config;
    float count, asked, came, product, square; /* The sums that forget, counts of set-point and of sense. */
    int32_t block_asked, block_came, block_product, block_square; /* Sums of the block, at most 31 * 4095 * 4095. */
    uint16_t chips;                                               /* Driven chips of the present block. */
    uint16_t over_count; /* Largest magnitude that is no fault, counts of sense. */
    uint16_t open_above; /* Largest set-point with which the coil may be open, counts. */
    uint32_t open_scale; /* Least counts of sense for a count of set-point, 16 fractional bits. */
} current_t;

/* Take a configuration. The state becomes CURRENT_OFF, and faults are cleared.
 * Returns false, with nothing done, if a value is outside its range or not a number. */
bool current_configure(current_t *current, const current_config_t *config);

/* Begin the ramp from 0. Nothing happens but from CURRENT_OFF. It is to be called when the first driven chip begins. */
void current_start(current_t *current);

/* Go to CURRENT_OFF; a fault stays until current_clear. */
void current_stop(current_t *current);

/* Go from CURRENT_FAULT to CURRENT_OFF. */
void current_clear(current_t *current);

/* Take a measurement: once a chip, only for chips that are driven (level not 0). set_point is what was asked, in
 * counts with the bridge's sign, -4095..4095, and count is the sense's. Costs about 55 instructions, once in
 * CURRENT_BLOCK_CHIPS about 160.
 * Returns false if the bridge must be switched off at once; true in CURRENT_OFF, false in CURRENT_FAULT. */
bool current_sample(current_t *current, int16_t set_point, uint16_t count);

#endif
