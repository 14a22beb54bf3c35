/* acquire.h: synchronises the chip clock by the beacons' field alone: no wire, no message (Prigge and How, section 4, second method).
 *
 * Which samples. The paper samples one axis at 1 MHz. The converters here could be run through without pause (three axes at 780 kHz), at the price of a second mode of the
 * converters, 470 kB/s of samples and their filter. There is no need: the burst that ends each chip is a window of 10 us on the field, and the chip clock decides where in the
 * beacons' chip it lies. With own chips 48 ticks longer than the beacons' the window slides over one whole chip in 341 chips: three sweeps a cycle, all three axes.
 *
 * Search, from one cycle of slid samples:
 *   1. code phase: samples at their own times, in whole chips, correlated with each known code at all 1023 phases by Fourier transforms (fourier.h; below 160 Hz is left out: earth,
 *      mains; of the three axes the two with most variance, as one complex number). |correlation|^2 is summed over the codes, since all beacons share the phase. Half the sweep sees
 *      the chip before the edge: two neighbouring phases share the peak, and their shares tell the edge to a few us. A peak ACQUIRE_PEAK times the mean is one.
 *   2. amplitudes of every code, from settled samples, by three passes of successive subtraction; from these the field of every chip.
 *   3. edge and rate: how much of each change of the field is done, as a function of the phase; differences of successive samples are compared, which removes earth and mains at no
 *      cost in noise. edge_fit.h gives onset, rise time and the slip of the two clocks.
 *   The chip clock then jumps to the beacons' chips.
 * Up to 16 codes of the list are used; a search that fails goes on with the next 16.
 *
 * Tracking costs no chip. The chip clock is kept ACQUIRE_LATE_TICKS behind the beacons, so that the last of a burst's eight conversions lies ACQUIRE_TARGET_TICKS after
 * the edge, on the foot of the ramp, and the other seven before it: those are the sample (7 of 8 conversions: 7 % more of the converter's own noise, none of noise that a
 * burst has in common). Last conversion minus the others, correlated with the changes that the code makes, is the height on the ramp: nothing when early, more when
 * late; close to the foot the rise time hardly matters. A record is one cycle of chips; each half of it is a measurement with the noise that it shows, and a Kalman filter
 * of phase and rate turns them into a correction of the chip clock.
 *
 * Dropout. When the codes' share of the variance is that of noise, the clock is left alone (chip_clock.h unlocks it after its hold-over) and each record is searched: codes at
 * the own phase are tracked again, codes elsewhere start a new search with sliding phase.
 *
 * Contexts: acquire_plan and acquire_feed from the one interrupt of the chip clock; the rest from main. Main and interrupt hand the record over by one flag each.
 * Time (Cortex-M4, -O2, tests/firmware/core/test_acquire_instructions.py): acquire_feed 200 instructions, acquire_plan 550. One acquire_step at most 750,000 (4.5 ms at an
 * instruction a cycle), the search of one code; a whole search with eight codes 9.6 million in 19 steps, a tracked record 0.85 million in 4.
 * Memory: 45.6 kB, nearly all of it the record and the transforms.
 */
#ifndef GOLDFIELD_ACQUIRE_H
#define GOLDFIELD_ACQUIRE_H

#include <stdbool.h>
#include <stdint.h>

#include "chip_clock.h"
#include "edge_fit.h"
#include "fourier.h"

#define ACQUIRE_AXES 3u
#define ACQUIRE_BURST 8u
#define ACQUIRE_CHIPS 1023u
#define ACQUIRE_CODES_MAX 16u       /* Used at a time. */
#define ACQUIRE_LIST_MAX 64u
#define ACQUIRE_DETUNE_TICKS 48     /* One chip in 342. */
#define ACQUIRE_PEAK 10             /* Times the mean. */
#define ACQUIRE_TARGET_TICKS 286    /* 1.7 us: last conversion after the beacons' edge. */
#define ACQUIRE_EXTRA_TICKS 504     /* 3 us: so much later are records taken after a search, and after one that saw no ramp: before the edge there is nothing to see. */
#define ACQUIRE_CAPTURES 3u         /* Records of a third of a cycle after a search, with its amplitudes: what it left of error in rate must not grow. */
#define ACQUIRE_LOCK_TICKS 84       /* 0.5 us: locked while the phase, a cycle ahead, has a smaller standard deviation. */

/* Of the board and its front end. */
typedef struct {
    uint16_t nominal_ticks;          /* Chip. */
    uint16_t first_conversion_ticks; /* From the chip's start to the moment when the burst's first sample is held. */
    uint16_t conversion_ticks;       /* From one to the next. */
    uint16_t lag_ticks;              /* Time constant of the front end's low-pass. */
} acquire_config_t;

typedef enum { ACQUIRE_RECORDING, ACQUIRE_TRANSFORMING, ACQUIRE_AMPLITUDES, ACQUIRE_EDGE, ACQUIRE_MEASURING } acquire_stage_t;
typedef enum { ACQUIRE_NONE, ACQUIRE_SWEEP, ACQUIRE_JUMP, ACQUIRE_CORRECT, ACQUIRE_AGAIN } acquire_command_t;

typedef struct {
    acquire_config_t config;
    /* For reading. */
    bool tracking;           /* The code phase is known. */
    bool silent;             /* No codes in the latest record. */
    uint32_t searches;       /* Searches begun. */
    float late_ticks;        /* Last conversion after the beacons' edge, in the middle of the latest record; */
    float deviation_ticks;   /* its standard deviation. */
    edge_fit_t edge;         /* Of the latest search. */
    float peak;              /* Of the latest search, times the mean. */
    /* Private: main's. */
    acquire_stage_t stage;
    uint16_t list[ACQUIRE_LIST_MAX];
    uint32_t list_count, list_first; /* The codes in use begin at list_first. */
    uint16_t codes[ACQUIRE_CODES_MAX];
    uint32_t code_count, code, pass;
    uint32_t axes[2];
    int32_t detune;          /* Of the record, */
    uint32_t length;         /* its chips. */
    float mean[ACQUIRE_AXES];
    float variance;          /* Sum over the axes. */
    float crossing;          /* Where the frame's middle is, chips. */
    uint32_t start_label;    /* Code chip at the record's origin. */
    float amplitude[ACQUIRE_CODES_MAX][ACQUIRE_AXES];
    float covariance[3];     /* Of phase and rate at middle_chip: phase squared, product, rate squared; ticks and ticks a chip. */
    uint32_t middle_chip;    /* Of the record that was measured last. */
    uint32_t captures;       /* Records measured since the search, at most ACQUIRE_CAPTURES. */
    uint32_t unseen;         /* Records in succession that saw no ramp. */
    float extra_ticks;       /* What the record is late on purpose. */
    /* Main to interrupt: valid while command is not ACQUIRE_NONE. */
    uint8_t command;
    uint64_t edge_position, edge_period;
    float phase_change, rate_change; /* Ticks; ticks a chip, since rate_chip. */
    uint32_t rate_chip;
    int32_t residual_ticks;
    bool good;
    /* Interrupt to main: valid while recorded. */
    uint8_t recorded;
    uint32_t first_chip, first_position;
    uint16_t first_code_chip;
    uint64_t period;         /* Estimate during the record. */
    /* Private: interrupt's. */
    bool filling;
    uint32_t from_chip, count;
    /* The record: relative to mid-scale the first seven conversions; seven times the last minus the first seven. */
    int16_t field[ACQUIRE_CHIPS + 1u][ACQUIRE_AXES];
    union {
        int16_t step[ACQUIRE_CHIPS + 1u][ACQUIRE_AXES];
        float metric[ACQUIRE_CHIPS + 1u];
    };
    union {
        struct {
            fourier_t signal[FOURIER_LENGTH], work[FOURIER_LENGTH];
        };
        struct {
            float residual[ACQUIRE_CHIPS][ACQUIRE_AXES], expected[ACQUIRE_CHIPS][ACQUIRE_AXES];
            int8_t chips[ACQUIRE_CHIPS];
            uint16_t labels[ACQUIRE_CHIPS]; /* Of each sample its code chip, and UNSETTLED or not. */
            edge_profile_t profile;
        };
    };
} acquire_t;

void acquire_init(acquire_t *acquire, const acquire_config_t *config);

/* The codes that may be on the air: indices of gold.h, degree 10; those above 1024 and beyond 64 are left out. With a new list the search starts anew; the same list changes nothing. */
void acquire_codes(acquire_t *acquire, const uint16_t *codes, uint32_t count);

/* Interrupt, before chips are planned: what main decided is applied to the clock. About 550 instructions when something was decided, else 10. */
void acquire_plan(acquire_t *acquire, chip_clock_t *clock);

/* Interrupt: the burst of a chip, in order, with what chip_clock_at says of the chip. */
void acquire_feed(acquire_t *acquire, uint32_t chip, const chip_clock_chip_t *planned, const uint16_t burst[ACQUIRE_BURST][ACQUIRE_AXES]);

/* Main, once a turn: one piece of work, if there is any. */
void acquire_step(acquire_t *acquire);

/* The sample of a chip without its last conversion, at the scale of epoch_sample: 8/7 of the sum of the first seven conversions relative to mid-scale. About 180 instructions. */
void acquire_sample(const uint16_t burst[ACQUIRE_BURST][ACQUIRE_AXES], int16_t sample[ACQUIRE_AXES]);

#endif
