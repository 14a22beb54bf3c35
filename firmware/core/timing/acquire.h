/* acquire.h: synchronises the chip clock by the beacons' field alone, with no wire and no message (Prigge and How,
 * section 4, second method). It works on Gold codes of degree 10.
 *
 * Calls, in the order they are made
 *   1. acquire_init   main, once, and again when the source of time changes.
 *   2. acquire_codes  main, with the codes that may be on the air.
 *      acquire_known  instead of it, main, with a clock that is in step by something else.
 *   3. acquire_plan   interrupt, before the chips of a block are planned.
 *   4. acquire_feed   interrupt, with the burst of each chip; acquire_sample (acquire_record.h) makes its sample.
 *   5. acquire_step   main, once a turn; acquire_replace behind acquire_known, when other codes are nearer.
 * Main reads tracking, silent and the other results; the chip clock's `locked` tells whether the chips are in step.
 *
 * Which samples. The paper samples one axis at 1 MHz. The converters here could be run through without pause (three
 * axes at 780 kHz), at the price of a second mode of the converters, 470 kB/s of samples and their filter. There is no
 * need: the burst that ends each chip is a window of 10 us on the field, and the chip clock decides where in the
 * beacons' chip it lies. With own chips 48 ticks longer than the beacons' the window slides over one whole chip in 341
 * chips: three sweeps a cycle, on all three axes.
 *
 * Search, from one cycle of slid bursts (acquire_record.h)
 *   1. The code phase is found to a few us (code_search.h). A peak of ACQUIRE_PEAK times the mean counts as one.
 *   2. The amplitudes of every code come from settled samples, and from these the field of every chip (code_field.h).
 *   3. The edge, its rate and the duration of the ramp are fitted, with their covariance (edge_fit.h). The chip clock
 *      then jumps to the beacons' chips.
 * Up to 16 codes of the list are used; a search that fails goes on with the next 16.
 *
 * Captures. A search leaves about 0.12 us and 3 ppm at 2 mG, which must not grow until whole cycles are tracked. So
 * three records of a third of a cycle follow, with the search's amplitudes. In the first two the edge is kept in the
 * middle of the burst, half of the conversions before it and half behind it: that shows most of it and misses no edge
 * within 5 us.
 *
 * Tracking costs no chip. The chip clock is kept so late behind the beacons that the last of a burst's eight
 * conversions lies ACQUIRE_TARGET_TICKS after the edge, on the foot of the ramp, and the other seven before it. Those
 * seven are the sample: 7 of 8 conversions have 7 % more of the converter's own noise, and no more of the noise that a
 * burst has in common. The last conversion minus the others, correlated with the changes that the code makes, is the
 * height on the ramp: nothing when early, more when late. A record is one cycle of chips. Each half of it is a look,
 * with the noise that it shows, for the filter of phase, rate and ramp (edge_track.h).
 *
 * A record begins when the chip clock has slewed to where it is to be (after a jump up to 22 chips). Bursts under way
 * to it lie elsewhere on the ramp, and would bias the first capture.
 *
 * A phase that is known (acquire_known). The clock was in step with the beacons until its wire and its messages fell
 * silent. Then there is no search: it is tracked from the first whole record on. What is not known is the ramp's rise;
 * the first record tells it as it would be if the phase were right, and an error of the phase stays, as large as the
 * filter says. The lock is lost at no time.
 *
 * Dropout. When the codes' share of the variance is that of noise, the clock is left alone (chip_clock.h unlocks it
 * after its hold-over) and each record is searched. Codes at the own phase are tracked again from the first whole
 * record on; codes elsewhere start a new search with sliding phase. Four records in succession without a ramp start
 * one, too.
 *
 * Accuracy (`make field-sync-figures`), with 8 beacons in the cube and mains hum of 0.5 uT. Figures are of the edge,
 * in us.
 *   noise                           starts   at three cycles               worst moment of a start in the next three
 *   2 mG a burst                    1000     within 0.32, rms 0.079        within 0.57, rms 0.146
 *   2 mG in each conversion         300      within 0.58                   within 0.92
 *   5.7 mG in each conversion       300      rms 0.46, 286 within 1        -
 * The third line has as much noise in a burst's mean as the first, but independent in its conversions; the lock then
 * comes when the filter knows the edge, up to three cycles later.
 *
 * Contexts: acquire_plan and acquire_feed are called from the one interrupt of the chip clock, the others from main.
 * Main and interrupt hand the record over by one flag each.
 *
 * Time (Cortex-M4, -O2, tests/firmware/core/timing/test_acquire_instructions.py): acquire_feed takes 150 instructions,
 * acquire_plan 620. One acquire_step takes at most 760,000 (4.5 ms at an instruction a cycle), the search of one code.
 * A whole search with eight codes takes 9.3 million in 17 steps, a tracked record 1.16 million in 3.
 *
 * Memory: 41.5 kB, nearly all of it the record (12 kB) and the transforms.
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

#define ACQUIRE_CODES_MAX    CODE_FIELD_CODES /* Codes of the list that are used at a time. */
#define ACQUIRE_LIST_MAX     64u              /* Longest list of codes: as many as a sensor reports. */
#define ACQUIRE_DETUNE_TICKS 48               /* Extra length of own chips in a search, ticks: one chip in 342. */
#define ACQUIRE_PEAK         10               /* Least height of a search's peak, times the mean. */
#define ACQUIRE_TARGET_TICKS 286u /* Last conversion after the beacons' edge when tracking, ticks: 1.7 us. */
/* Extra delay of records that look for the edge, ticks: 4.2 us, which puts it in the middle of the burst. */
#define ACQUIRE_EXTRA_TICKS   700u
#define ACQUIRE_CAPTURES      3u /* Records of a third of a cycle after a search. */
#define ACQUIRE_LATE_CAPTURES 2u /* How many of these look for the edge. */
/* Largest standard deviation of the phase, a cycle ahead, with which the clock counts as locked, ticks: 0.5 us. */
#define ACQUIRE_LOCK_TICKS 84u

/* The board and its front end. */
typedef struct {
    uint16_t nominal_ticks;          /* Nominal length of a chip, ticks. */
    uint16_t first_conversion_ticks; /* Time from the chip's start until the burst's first sample is held, ticks. */
    uint16_t conversion_ticks;       /* Time from one conversion to the next, ticks. */
    uint16_t lag_ticks;              /* Time constant of the front end's low-pass, ticks. */
} acquire_config_t;

/* What main does with a record, in this order; a tracked record goes from RECORDING to MEASURING. */
typedef enum {
    ACQUIRE_RECORDING,    /* It waits for the interrupt to fill the record. */
    ACQUIRE_TRANSFORMING, /* It correlates the record with each code. */
    ACQUIRE_AMPLITUDES,   /* It estimates the codes' amplitudes. */
    ACQUIRE_EDGE,         /* It fits the edge. */
    ACQUIRE_MEASURING     /* It estimates the amplitudes of a tracked record. */
} acquire_stage_t;

/* What main has decided for the chip clock; a new record begins with each. */
typedef enum {
    ACQUIRE_NONE,    /* Nothing. */
    ACQUIRE_SWEEP,   /* Search: unlock and slide. */
    ACQUIRE_JUMP,    /* Go to the edge that was found. */
    ACQUIRE_CORRECT, /* Correct phase and rate. */
    ACQUIRE_AGAIN    /* Leave the clock alone. */
} acquire_command_t;

typedef struct {
    acquire_config_t config;
    /* Results, for reading. */
    bool tracking;     /* The code phase is known. */
    bool silent;       /* The latest record shows no codes. */
    uint32_t searches; /* Searches begun. */
    float late_ticks;  /* Last conversion after the beacons' edge, in the middle of the latest record, by all that is
                          known, ticks. */
    float deviation_ticks; /* Standard deviation of late_ticks. */
    edge_fit_t edge;       /* Edge that the latest search fitted. */
    float peak;            /* Height of the latest search's peak, times the mean. */
    /* Private: main's. */
    acquire_stage_t stage;
    uint16_t list[ACQUIRE_LIST_MAX];
    uint32_t list_count, list_first; /* Codes in the list, and where those in use begin. */
    uint16_t codes[ACQUIRE_CODES_MAX];
    uint32_t code_count, code, pass; /* Codes in use, the one at work, and the pass over them. */
    uint32_t length;                 /* Length of the record, chips. */
    record_cut_t cut;                /* How the record's bursts are cut. */
    code_frame_t frame;
    edge_track_t track;   /* State of the filter at middle_chip. */
    uint32_t middle_chip; /* Middle of the record that was measured last. */
    uint32_t captures;    /* Records measured since the search, at most ACQUIRE_CAPTURES. */
    uint32_t unseen;      /* Records in succession that saw no ramp. */
    uint32_t extra_ticks; /* How late the record is on purpose. */
    /* From main to the interrupt: valid while command is not ACQUIRE_NONE. */
    uint8_t command;                     /* An acquire_command_t. */
    uint64_t edge_position, edge_period; /* What chip_clock_jump takes. */
    float phase_change, rate_change;     /* Ticks at rate_chip, and ticks a chip since then. */
    uint32_t rate_chip;                  /* Absolute chip at which phase_change holds. */
    int32_t residual_ticks;              /* What chip_clock_correct takes. */
    bool good;                           /* The clock counts as locked. */
    /* From the interrupt to main: valid while recorded. */
    uint8_t recorded;                    /* The record is full. */
    uint32_t first_chip, first_position; /* Its first absolute chip, and that chip's position. */
    uint16_t first_code_chip;            /* Its first chip's place in the own cycle. */
    uint64_t period;                     /* The chip clock's estimate during the record. */
    /* Private: the interrupt's. */
    bool filling;              /* A record is wanted or under way. */
    uint32_t from_chip, count; /* Absolute chip from which the record may begin, and its chips so far. */
    acquire_record_t record;
    union { /* Used one after the other. */
        code_search_t search;
        code_field_t field;
    };
} acquire_t;

/* Forget everything and take the board's times. */
void acquire_init(acquire_t *acquire, const acquire_config_t *config);

/* Tell the codes that may be on the air, as indices of gold.h at degree 10. Those above 1024 and beyond the first 64
 * are left out. With a new list the search starts anew; the same list changes nothing. */
void acquire_codes(acquire_t *acquire, const uint16_t *codes, uint32_t count);

/* Begin with a clock that is in step, and that chip_clock_late puts acquire_late_ticks behind the beacons' chips before
 * the next acquire_plan: instead of acquire_codes. chip is the clock's next one, deviation_ticks the standard deviation
 * of its phase. Codes are as in acquire_codes, the first 16 are used. */
void acquire_known(acquire_t *acquire, const uint16_t *codes, uint32_t count, uint32_t chip, float deviation_ticks);

/* Track these codes from now on, the first 16 of them, without a search. Nothing happens while the codes' phase is not
 * known, or while the record at work needs those before: the caller asks again.
 * Returns whether they are in use. */
bool acquire_replace(acquire_t *acquire, const uint16_t *codes, uint32_t count);

/* Returns how long after the beacons' chips the own ones begin while tracking, ticks. */
int16_t acquire_late_ticks(const acquire_config_t *config);

/* Apply to the clock what main has decided; from the interrupt, before chips are planned. Costs about 620 instructions
 * when something was decided, else 10. */
void acquire_plan(acquire_t *acquire, chip_clock_t *clock);

/* Take the burst of a chip, in order, with what chip_clock_at says of the chip; from the interrupt. */
void acquire_feed(acquire_t *acquire, uint32_t chip, const chip_clock_chip_t *planned,
                  const uint16_t burst[ACQUIRE_BURST][ACQUIRE_AXES]);

/* Do one piece of work, if there is any; main calls it once a turn. */
void acquire_step(acquire_t *acquire);

#endif
