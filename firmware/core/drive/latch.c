#include "core/drive/latch.h"

/* The word that is kept: a mark, and what has to be known after a reset. The other word is its complement. */
#define MARK       0xC0110000u /* In the upper half. */
#define MARK_MASK  0xFFFF0000u
#define ON_BIT     0x1000u /* The bridge is on. */
#define TRIP_SHIFT 4u      /* Trips in a row from here on, 0..LATCH_TRIPS, in four bits. */
#define FIELD      0xFu    /* The cause is in the lowest four bits. */

static void keep(const latch_t *latch) {
    const uint32_t word = MARK | (latch->on ? ON_BIT : 0u) | (uint32_t)latch->trips << TRIP_SHIFT | latch->cause;
    latch->kept[0] = word;
    latch->kept[1] = ~word;
}

/* Counts a trip, and has the drive wait. */
static void count_trip(latch_t *latch, uint64_t now_us) {
    latch->trips = (uint8_t)(latch->trips + (latch->trips < LATCH_TRIPS));
    latch->wait_us = now_us + ((uint64_t)LATCH_WAIT_US << (latch->trips - 1u));
    latch->locked_out = latch->trips == LATCH_TRIPS;
    latch->good = false;
}

void latch_start(latch_t *latch, uint32_t *kept, bool watchdog, uint64_t now_us) {
    *latch = (latch_t){.kept = kept};
    const uint32_t word = kept[0], trips = word >> TRIP_SHIFT & FIELD;
    if ((word & MARK_MASK) != MARK || kept[1] != ~word || trips > LATCH_TRIPS) {
        keep(latch);
        return;
    }
    latch->cause = (uint8_t)(word & FIELD);
    latch->trips = (uint8_t)trips;
    if (latch->cause != CAUSE_NONE && trips > 0u) {
        latch->trips--; /* It is counted anew: the drive waits again. */
    }
    if (latch->cause != CAUSE_NONE || ((word & ON_BIT) != 0u && watchdog)) {
        count_trip(latch, now_us);
        latch->counted = latch->cause != CAUSE_NONE;
    } else if (trips > 0u) {
        latch->wait_us = now_us + ((uint64_t)LATCH_WAIT_US << (trips - 1u));
        latch->locked_out = trips == LATCH_TRIPS;
    }
    if (latch->locked_out && latch->cause == CAUSE_NONE) {
        latch->cause = CAUSE_WATCHDOG;
        latch->counted = true;
    }
    keep(latch);
}

void latch_set(latch_t *latch, cause_t cause) {
    if (latch->cause == CAUSE_NONE) {
        const bool known = cause > CAUSE_NONE && cause <= CAUSE_WATCHDOG;
        latch->cause = (uint8_t)(known ? cause : CAUSE_WATCHDOG);
        latch->on = false;
        keep(latch);
    }
}

void latch_on(latch_t *latch, bool on) {
    if (latch->on != on) {
        latch->on = on;
        keep(latch);
    }
}

void latch_step(latch_t *latch, uint64_t now_us) {
    if (latch->cause != CAUSE_NONE && !latch->counted) {
        latch->counted = true;
        count_trip(latch, now_us);
        keep(latch);
    }
    if (!latch->good || !latch->on) {
        latch->good = latch->on;
        latch->good_us = now_us;
    } else if (latch->trips > 0u && now_us - latch->good_us >= LATCH_FORGET_US) {
        latch->trips = 0;
        keep(latch);
    }
    if (latch->wait_us != 0u && now_us >= latch->wait_us) {
        latch->wait_us = 0;
    }
}

bool latch_clear(latch_t *latch, uint64_t now_us) {
    latch_step(latch, now_us);
    if (latch->locked_out) {
        return false;
    }
    latch->counted = false;
    latch->cause = CAUSE_NONE;
    keep(latch);
    return true;
}

bool latch_open(const latch_t *latch) {
    return latch->cause == CAUSE_NONE && latch->wait_us == 0u;
}

uint32_t latch_wait_s(const latch_t *latch, uint64_t now_us) {
    return latch->wait_us > now_us ? (uint32_t)((latch->wait_us - now_us + 999999u) / 1000000u) : 0u;
}
