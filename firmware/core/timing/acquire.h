/* acquire.h: synchronises the chip clock by the beacons' field alone: no wire, no message (Prigge and How, section 4,
 * second method). Gold codes of degree 10.
 *
 * Which samples. The paper samples one axis at 1 MHz. The converters here could be run through without pause (three
 * axes at 780 kHz), at the price of a second mode of the converters, 470 kB/s of samples and their filter. There is no
 * need: the burst that ends each chip is a window of 10 us on the field, and the chip clock decides where in the
 * beacons' chip it lies. With own chips 48 ticks longer than the beacons' the window slides over one whole chip in 341
 * chips: three sweeps a cycle, all three axes.
 *
 * Search, from one cycle of slid bursts (acquire_record.h):
 *   1. code phase, to a few us (code_search.h). A peak ACQUIRE_PEAK times the mean is one.
 *   2. amplitudes of every code from settled samples, and from these the field of every chip (code_field.h).
 *   3. edge, rate and duration of the ramp, with their covariance (edge_fit.h). The chip clock then jumps to the
 *      beacons' chips.
 * Up to 16 codes of the list are used; a search that fails goes on with the next 16.
 *
 * Captures. A search leaves about 0.12 us and 3 ppm at 2 mG, which must not grow until whole cycles are tracked: three
 * records of a third of a cycle follow, with the search's amplitudes. In the first two the edge is kept in the middle
 * of the burst: half of the conversions before, half behind it, which shows most of it and misses no edge within 5 us.
 *
 * Tracking costs no chip. The chip clock is kept so late behind the beacons that the last of a burst's eight
 * conversions lies ACQUIRE_TARGET_TICKS after the edge, on the foot of the ramp, and the other seven before it: those
 * are the sample (7 of 8 conversions: 7 % more of the converter's own noise, none of noise that a burst has in common).
 * Last conversion minus the others, correlated with the changes that the code makes, is the height on the ramp: nothing
 * when early, more when late. A record is one cycle of chips; each half of it is a look, with the noise that it shows,
 * for the filter of phase, rate and ramp (edge_track.h).
 *
 * A record begins when the chip clock has slewed to where it is to be (after a jump up to 22 chips): bursts under way
 * to it lie elsewhere on the ramp, and would bias the first capture.
 *
 * Dropout. When the codes' share of the variance is that of noise, the clock is left alone (chip_clock.h unlocks it
 * after its hold-over) and each record is searched: codes at the own phase are tracked again from the first whole
 * record on, codes elsewhere start a new search with sliding phase. Four records in succession without a ramp start one
 * too.
 *
 * Accuracy (`make field-sync-figures`). 1000 cold starts of the test's signal with 2 mG a burst, 8 beacons in the cube,
 * mains hum of 0.5 uT: edge at three cycles within 0.32 us, rms 0.079; in the three cycles after it, the worst moment
 * of a start within 0.57 us, rms 0.146. With 2 mG in each conversion 0.58 and 0.92 us (300 starts). Noise as large in a
 * burst's mean but independent in its conversions (5.7 mG each) leaves 0.46 us rms at three cycles, 286 of 300 within 1
 * us; the lock then comes when the filter knows the edge, up to three cycles later.
 *
 * Contexts: acquire_plan and acquire_feed from the one interrupt of the chip clock; the rest from main. Main and
 * interrupt hand the record over by one flag each. Time (Cortex-M4, -O2,
 * tests/firmware/core/timing/test_acquire_instructions.py): acquire_feed 150 instructions, acquire_plan 620. One
 * acquire_step at most 760,000 (4.5 ms at an instruction a cycle), the search of one code; a whole search with eight
 * codes 9.3 million in 17 steps, a tracked record 1.16 million in 3. Memory: 41.5 kB, nearly all of it the record (12
 * kB) and the transforms.
 */
#ifndef GOLDFIELD_ACQUIRE_H
#define GOLDFIELD_ACQUIRE_H

#include <stdbool.h>
#include <stdint.h>

#include "core/timing/acquire_record.h"
#include "core/timing/chip_clock.h"
#include "core/timing/code_field.h"
#include "core/timing/code_search.h"
#include "core/timing/edge_fit.h"
#include "core/timing/edge_track.h"

#define ACQUIRE_CODES_MAX    CODE_FIELD_CODES /* Used at a time. */
#define ACQUIRE_LIST_MAX     64u
#define ACQUIRE_DETUNE_TICKS 48   /* One chip in 342. */
#define ACQUIRE_PEAK         10   /* Times the mean. */
#define ACQUIRE_TARGET_TICKS 286u /* 1.7 us: last conversion after the beacons' edge. */
#define ACQUIRE_EXTRA_TICKS                                                                                            \
    700u /* 4.2 us: so much later are records taken that look for the edge: it then lies in the middle of the burst.   \
          */
#define ACQUIRE_CAPTURES      3u  /* Records of a third of a cycle after a search, */
#define ACQUIRE_LATE_CAPTURES 2u  /* of which look for the edge. */
#define ACQUIRE_LOCK_TICKS    84u /* 0.5 us: locked while the phase, a cycle ahead, has a smaller standard deviation. */

/* Of the board and its front end. */
typedef struct {
    uint16_t nominal_ticks;          /* Chip. */
    uint16_t first_conversion_ticks; /* From the chip's start to the moment when the burst's first sample is held. */
    uint16_t conversion_ticks;       /* From one to the next. */
    uint16_t lag_ticks;              /* Time constant of the front end's low-pass. */
} acquire_config_t;

typedef enum {
    ACQUIRE_RECORDING,
    ACQUIRE_TRANSFORMING,
    ACQUIRE_AMPLITUDES,
    ACQUIRE_EDGE,
    ACQUIRE_MEASURING
} acquire_stage_t;
typedef enum { ACQUIRE_NONE, ACQUIRE_SWEEP, ACQUIRE_JUMP, ACQUIRE_CORRECT, ACQUIRE_AGAIN } acquire_command_t;

typedef struct {
    acquire_config_t config;
    /* For reading. */
    bool tracking;     /* The code phase is known. */
    bool silent;       /* No codes in the latest record. */
    uint32_t searches; /* Searches begun. */
    float late_ticks;  /* Last conversion after the beacons' edge, in the middle of the latest record, by all that is
                          known; */
    float deviation_ticks; /* its standard deviation. */
    edge_fit_t edge;       /* Of the latest search. */
    float peak;            /* Of the latest search, times the mean. */
    /* Private: main's. */
    acquire_stage_t stage;
    uint16_t list[ACQUIRE_LIST_MAX];
    uint32_t list_count, list_first; /* The codes in use begin at list_first. */
    uint16_t codes[ACQUIRE_CODES_MAX];
    uint32_t code_count, code, pass;
    uint32_t length;  /* Of the record, chips; */
    record_cut_t cut; /* how its bursts are cut. */
    code_frame_t frame;
    edge_track_t track;   /* At middle_chip, */
    uint32_t middle_chip; /* of the record that was measured last. */
    uint32_t captures;    /* Records measured since the search, at most ACQUIRE_CAPTURES. */
    uint32_t unseen;      /* Records in succession that saw no ramp. */
    uint32_t extra_ticks; /* What the record is late on purpose. */
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
    uint64_t period; /* Estimate during the record. */
    /* Private: interrupt's. */
    bool filling;
    uint32_t from_chip, count;
    acquire_record_t record;
    union { /* One after the other. */
        code_search_t search;
        code_field_t field;
    };
} acquire_t;

void acquire_init(acquire_t *acquire, const acquire_config_t *config);

/* The codes that may be on the air: indices of gold.h, degree 10; those above 1024 and beyond 64 are left out. With
 * a new list the search starts anew; the same list changes nothing. */
void acquire_codes(acquire_t *acquire, const uint16_t *codes, uint32_t count);

/* Interrupt, before chips are planned: what main decided is applied to the clock. About 620 instructions when
 * something was decided, else 10. */
void acquire_plan(acquire_t *acquire, chip_clock_t *clock);

/* Interrupt: the burst of a chip, in order, with what chip_clock_at says of the chip. */
void acquire_feed(acquire_t *acquire, uint32_t chip, const chip_clock_chip_t *planned,
                  const uint16_t burst[ACQUIRE_BURST][ACQUIRE_AXES]);

/* Main, once a turn: one piece of work, if there is any. */
void acquire_step(acquire_t *acquire);

#endif
