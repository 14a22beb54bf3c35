/* current.h: keeps the amplitude of one coil's current in both directions, starts it softly, and tells when something
 * is wrong with it.
 *
 * Calls, in the order they are made
 *   1. current_configure  while the state is CURRENT_OFF.
 *   2. current_sample     once a chip, from the interrupt of the current sense, driven or not, bridge on or off.
 *      current_edge       the same, before it, where the board measures behind the chip's beginning, too.
 *      current_middle     the same, between them, amid the chip.
 *      current_ready      tells when the zero of the sense is known: from then on the drive may start.
 *   3. current_start      when the first driven chip begins; current_set_point gives the planner its set-points.
 *   4. current_stop       at the end.
 *
 * What is loop, and what is adaptation. The loop is the driver's: it makes the set-point's amperes by itself, chip by
 * chip, in the direction of the bridge, and takes what it needs of the supply; a warm coil or a lower supply changes
 * nothing as long as there is enough of it. What the driver makes is not exact, and not the same in both directions.
 * The firmware adapts the set-points to that: it is no loop, has no feedback within a chip, and cannot oscillate,
 * because what is planned ahead comes into the measure as it was planned.
 *
 * Method. The current is measured once a chip, just before the chip ends. For each direction the firmware keeps the
 * line through what was asked (s, counts of set-point) and what came in that direction (y, counts of sense) by least
 * squares, with old chips forgotten; y = gain s + offset. After every CURRENT_BLOCK_CHIPS driven chips
 *   each sum = kept * itself + that over the block, of 1, s, y, s y, s s; kept 7/8 in the ramp and 31/32 after it;
 *   gain   = (n Ssy - Ss Sy) / (n Sss - Ss Ss),   n = S1 + 1/16,   offset = (Sy - gain Ss) / n;
 * and a chip of level l asks for (|l| target - offset) / gain. The 1/16 in n are chips that asked for nothing and got
 * nothing: they give a direction of a single level a line, too. A waveform whose levels all have one size, as those of
 * one code, cannot tell an offset from a gain and need not: gain = Ssy / Sss, offset = 0. The gain stays within a
 * quarter of a driver's without error, the offset within a tenth of the amplitude. The error falls to 1/e in 25 ms of
 * the ramp and in 0.1 s later on.
 *   Where the offset of its direction alone is more than a level, the other direction is asked for it. Where neither
 * can make so little the set-point is 0, and the chip does not count for the line once the ramp is over: a driver may
 * have no offset where nothing is asked of it.
 *   A set-point is a whole count; what is lost by rounding is added to the next chip of the same direction, so that
 * amplitude and direct current are finer than a count on the mean of a few chips.
 *   The zero of the sense is the mean of what it tells while no current is asked for, over CURRENT_ZERO_MEMORY chips:
 * before the start (current_ready: CURRENT_ZERO_CHIPS are enough), and in all but the first of successive chips that
 * are not driven. A code has no such chips; the zero is then that of the last time when the bridge was off. What the
 * zero drifts from then on goes into the direct current. target is the ramped amplitude: it moves by amplitude /
 * CURRENT_RAMP_BLOCKS a block (from 0 to full in 33 blocks = 1023 driven chips = 0.1 s).
 *
 * Headroom. Where the supply cannot bring the current to what was asked before the chip ends, no set-point can: a chip
 * that falls short by an eighth does not count for the line, so that nothing winds up, and one that falls short by 1/64
 * (and 6 counts), a set-point at the end of its range, or an estimated amplitude more than 0.5 % short raises
 * headroom_lost for 33 blocks. So does a chip that brings as much more than is expected: the line is then wrong itself,
 * and the amplitude that it tells with it.
 *
 * Protections: those of guard.h on every measurement, and, by current_sample and current_middle, an open coil. That is
 * looked for in a chip that asks for more than a quarter of the amplitude and than CURRENT_OPEN_MINIMUM_A (so in
 * neither the first quarter of the ramp, nor zeros of a sinusoid, nor cancelling codes): the current in the asked
 * direction is below open_fraction of what was asked (by the estimated line); a sense of the wrong sign is one, too.
 * Amid the chip the current may still be on its way there. A coil's changes ever slower under a constant supply: one
 * that is there when the chip ends has done more than 2/5 of the way amid the chip, as hal.h has the moments. It counts
 * as open with less than 3/8. A fault is returned within that chip. The state is then CURRENT_FAULT until
 * current_configure.
 *
 * Units. The sense counts 0..4095, 2048 is about 0 A; sense_A is A per count. The reference counts 0..4095 of
 * reference_A each.
 *
 * Contexts: current_sample (which uses the floating-point unit), current_edge and current_middle belong to the
 * interrupt of the sense; current_set_point to the planner alone. The others are for main, and write single words that
 * the interrupts read; current_configure only while the bridge is off. Memory: 232 bytes.
 */
#ifndef GOLDFIELD_CURRENT_H
#define GOLDFIELD_CURRENT_H

#include <stdbool.h>
#include <stdint.h>

#include "core/drive/guard.h"

#define CURRENT_BLOCK_CHIPS    31u    /* Driven chips between two estimates of the lines. */
#define CURRENT_RAMP_BLOCKS    33u    /* Blocks from 0 to full amplitude: 1023 driven chips, 0.1 s. */
#define CURRENT_ZERO_CHIPS     256u   /* Chips without current before the zero counts as known: 25 ms. */
#define CURRENT_ZERO_MEMORY    1024u  /* Chips over which it is averaged: 0.1 s. */
#define CURRENT_OPEN_MINIMUM_A 0.125f /* Largest current asked for with which an open coil is not looked for, A. */
#define CURRENT_MID_SCALE      2048   /* Count of the sense at 0 A, nominally. */
#define CURRENT_ONE            16384  /* The level 1. */

typedef struct {
    float sense_A;       /* Current for a count of the sense, A, > 0. */
    float reference_A;   /* Current for a count of the reference, A, > 0, 1/1024 to 8 times sense_A. */
    float amplitude_A;   /* Current wanted at level 1, A, 0..2047 counts of the sense. */
    float open_fraction; /* Least share of what was asked, 0..1; 0 switches the open-coil protection off. */
    bool several_levels; /* The waveform has levels of several sizes, 0 left aside. */
    guard_config_t guard;
} current_config_t;

typedef enum { CURRENT_OFF = 0, CURRENT_RAMPING = 1, CURRENT_HOLDING = 2, CURRENT_FAULT = 3 } current_state_t;

/* What is known of one direction; private. */
typedef struct {
    float count, asked, came, product, square; /* The sums that forget, counts of set-point and of sense. */
    int32_t block_count, block_asked, block_came, block_product,
        block_square;        /* Those of the block, at most 31 * 4095^2. */
    float gain, offset;      /* The line, counts of sense. */
    uint32_t gain_q;         /* The gain within its limits, 16 fractional bits. */
    int32_t offset_q;        /* The offset within its limits, counts. */
    volatile uint32_t scale; /* Set-point of level 1 without the offset, 1/16 counts. */
    volatile int32_t shift;  /* The offset's set-point, 1/16 counts. */
    int32_t carry;           /* What rounding has left over, 1/16 counts; the planner's. */
} current_line_t;

/* The caller owns it. */
typedef struct {
    /* Results, for reading. */
    uint8_t state;      /* A current_state_t. */
    bool headroom_lost; /* The driver does not make what is asked of it. */
    uint16_t reference; /* Set-point of level 1, the larger of both directions, counts; 0 unless ramping or holding. */
    float measured_A;   /* Current at level 1, A: the mean of the directions that are driven. */
    float dc_A;         /* Half the difference of the currents at level 1 and -1, A; 0 if one is not driven. */
    float target_A;     /* Ramped amplitude, A. */
    float zero;         /* Zero of the sense from mid-scale, counts. */
    guard_t guard;
    /* Private. */
    current_config_t config;
    current_line_t line[2]; /* Positive, negative. */
    uint16_t chips;         /* Driven chips of the present block. */
    uint16_t zeros;         /* Chips of which the zero is the mean. */
    uint16_t open_above;    /* Largest set-point with which the coil may be open, counts. */
    uint32_t open_share;    /* The open_fraction, 16 fractional bits. */
    uint8_t short_blocks;   /* Blocks for which headroom_lost is still told. */
    uint8_t cause;          /* A cause_t: why, in CURRENT_FAULT. */
    bool quiet;             /* The chip before was not driven. */
    volatile bool strayed;  /* In this block a chip was off what is expected; the planner sets it, too. */
} current_t;

/* Take a configuration. The state becomes CURRENT_OFF. The zero and the mean square that were measured stay.
 * Returns false, with nothing done, if a value is outside its range or not a number. */
bool current_configure(current_t *current, const current_config_t *config);

/* Returns whether two currents have one configuration. They are of one driver, and are given one: where they have not,
 * a bit has flipped. */
bool current_alike(const current_t *one, const current_t *other);

/* Returns whether the zero of the sense is known. */
bool current_ready(const current_t *current);

/* Begin the ramp from 0. Nothing happens but from CURRENT_OFF. It is to be called when the first driven chip begins. */
void current_start(current_t *current);

/* Go to CURRENT_OFF, unless there is a fault. */
void current_stop(current_t *current);

/* Returns the set-point of a chip of a level, -CURRENT_ONE..CURRENT_ONE, counts with the sign of the bridge's
 * direction: the level's, but for levels below the direct current. Once for each chip, in their order. Costs about 25
 * instructions.
 */
int16_t current_set_point(current_t *current, int32_t level);

/* Take a measurement, once a chip. driven tells whether the bridge is on and the chip's level is not 0; set_point is
 * what was asked, in counts with the bridge's sign, -4095..4095, 0 if not driven. count is the sense's. Costs about 134
 * instructions, once in CURRENT_BLOCK_CHIPS about 450. Returns CAUSE_NONE, or why the bridge must be switched off at
 * once; in CURRENT_FAULT its cause, at each look again, so that a bridge that has missed it once goes off all the
 * same. */
cause_t current_sample(current_t *current, bool driven, int16_t set_point, uint16_t count);

/* Take a measurement behind a chip's beginning, where the current may still be that of the chip before. set_point is 0
 * if the chip is not driven. Costs about 35 instructions. Returns what guard_edge does; in CURRENT_FAULT its cause. */
cause_t current_edge(current_t *current, int16_t set_point, uint16_t count);

/* Take a measurement amid a chip. start is the one before it: behind the chip's beginning, or at the end of the chip
 * before. Costs about 60 instructions. Returns what guard_edge does, or that the coil is open. */
cause_t current_middle(current_t *current, int16_t set_point, uint16_t start, uint16_t count);

#endif
