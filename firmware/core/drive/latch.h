/* latch.h: remembers why a drive was switched off, until somebody clears it, and decides when it may go on again. It
 * does so across resets, in two words that keep their value until power-off.
 *
 * Calls, in the order they are made
 *   1. latch_start  once, after a reset.
 *   2. latch_set    when something is wrong, from any context: the first cause stays.
 *      latch_on     when the bridge goes on or off.
 *   3. latch_step   once a turn of the main loop.
 *      latch_clear  when somebody asks for it.
 *      latch_open   tells whether the drive may be on.
 *
 * Rules
 *   - A cause stays until latch_clear, also across a reset, whoever caused it; only power-off forgets it.
 *   - After the n-th trip in a row the drive waits for 2^(n-1) s, counted from the trip (or the reset), before it may
 *     be on again, however soon it is cleared.
 *   - A watchdog reset while the drive was on is a trip that needs no clearing: the drive waits, and goes on.
 *   - After LATCH_TRIPS trips in a row it is locked out: nothing but power-off ends that.
 *   - LATCH_FORGET_US with the bridge on end the row.
 *
 * Contexts: as said above; latch_set and latch_on write single words. Memory: 40 bytes.
 */
#ifndef GOLDFIELD_LATCH_H
#define GOLDFIELD_LATCH_H

#include <stdbool.h>
#include <stdint.h>

#include "core/drive/cause.h"

#define LATCH_WORDS     2u         /* Words that keep their value over a reset. */
#define LATCH_TRIPS     5u         /* Trips in a row with which the drive is locked out. */
#define LATCH_WAIT_US   1000000u   /* Time to wait after the first trip in a row, us; each further one doubles it. */
#define LATCH_FORGET_US 600000000u /* Time with the bridge on that ends a row of trips, us. */

typedef struct {
    volatile uint8_t cause; /* A cause_t: why the drive is off, until it is cleared. */
    uint8_t trips;          /* Trips in a row. */
    bool locked_out;
    /* Private. */
    uint32_t *kept;   /* The words that keep their value. */
    volatile bool on; /* The bridge is on. */
    bool counted;     /* The present cause is counted in trips. */
    bool good;        /* The bridge has been on at every step since good_us. */
    uint64_t wait_us, good_us;
} latch_t;

/* Begin after a reset. kept has LATCH_WORDS words, which are 0 after power-on; others than latch_t wrote count as that.
 * watchdog tells whether the watchdog caused the reset. */
void latch_start(latch_t *latch, uint32_t *kept, bool watchdog, uint64_t now_us);

/* The drive is switched off for this reason. One that is none, as a processor that errs may hand on, is told as
 * CAUSE_WATCHDOG: more bits than a cause has would neither be told nor be kept. */
void latch_set(latch_t *latch, cause_t cause);

/* The bridge is on, or off. */
void latch_on(latch_t *latch, bool on);

/* Count trips, and let time pass. */
void latch_step(latch_t *latch, uint64_t now_us);

/* Forget the cause. Returns false, and it stays, if the drive is locked out. */
bool latch_clear(latch_t *latch, uint64_t now_us);

/* Returns whether nothing keeps the drive off; latch_step has it wait. */
bool latch_open(const latch_t *latch);

/* Returns for how many seconds, rounded up, the drive has yet to wait. */
uint32_t latch_wait_s(const latch_t *latch, uint64_t now_us);

#endif
