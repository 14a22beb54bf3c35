#include "services/source.h"

#include "hal/hal.h"

typedef enum { BY_WIRE, BY_CAN, BY_FIELD } by_t;

void source_automatic(source_t *source, sync_link_t *link, bool automatic) {
    source->automatic = automatic;
    link->compares = automatic;
    source->stage = SOURCE_IDLE;
}

void source_edge(source_t *source, const chip_clock_t *clock, bool fits) {
    const int32_t phase = clock->phase_ticks + clock->late_ticks;
    const bool good = fits && clock->locked && phase <= SYNC_NEAR_TICKS && phase >= -SYNC_NEAR_TICKS;
    source->edge_chip = clock->chip;
    source->wire_chip = fits ? clock->chip : source->wire_chip;
    source->wire_good = good ? source->wire_good + 1u : 0u;
}

/* ---- In the context of plan ---- */

static by_t followed(const source_t *source, const sync_link_t *link) {
    return source->by_field ? BY_FIELD : link->follows ? BY_CAN : BY_WIRE;
}

static by_t better_than_wire(const source_t *source, const chip_clock_t *clock, const sync_link_t *link,
                             uint32_t silent) {
    const uint32_t period = clock->config.chips;
    const uint32_t wire_age = clock->chip - source->wire_chip, can_age = clock->chip - link->message_chip;
    if (wire_age > silent && can_age < 2u * period && (!clock->locked || link->good >= SOURCE_MESSAGES)) {
        return BY_CAN;
    }
    return source->field_usable && wire_age > silent + SOURCE_FIELD_PERIODS * period ? BY_FIELD : BY_WIRE;
}

static by_t better_than_can(const source_t *source, const chip_clock_t *clock, const sync_link_t *link,
                            uint32_t silent) {
    const uint32_t can_age = clock->chip - link->message_chip;
    const bool can_silent = can_age > silent, wire_lives = source->wire_good >= 2u;
    if (source->wire_good >= SOURCE_RETURN || (can_silent && (wire_lives || !clock->locked))) {
        return BY_WIRE;
    }
    const bool to_field = source->field_usable && can_age > silent + SOURCE_FIELD_PERIODS * clock->config.chips;
    return to_field ? BY_FIELD : BY_CAN;
}

static by_t better_than_field(source_t *source, const chip_clock_t *clock, const sync_link_t *link) {
    const uint32_t period = clock->config.chips;
    if (clock->locked) {
        source->field_chip = clock->chip;
        return source->wire_good >= SOURCE_RETURN ? BY_WIRE : link->good >= SOURCE_RETURN ? BY_CAN : BY_FIELD;
    }
    if (clock->chip - source->field_chip < SOURCE_TRY_PERIODS * period) {
        return BY_FIELD;
    }
    const bool can_lives = clock->chip - link->message_chip < 2u * period,
               wire_lives = clock->chip - source->edge_chip < 2u * period;
    return can_lives ? BY_CAN : wire_lives ? BY_WIRE : BY_FIELD;
}

static by_t best(source_t *source, const chip_clock_t *clock, const sync_link_t *link) {
    const uint32_t silent = (clock->locked ? SOURCE_SILENT_PERIODS : SOURCE_SEARCH_PERIODS) * clock->config.chips;
    switch (followed(source, link)) {
    case BY_WIRE:
        return better_than_wire(source, clock, link, silent);
    case BY_CAN:
        return better_than_can(source, clock, link, silent);
    default:
        return better_than_field(source, clock, link);
    }
}

static void go_over(source_t *source, chip_clock_t *clock, sync_link_t *link, by_t by) {
    const chip_clock_source_t *const edges = by == BY_FIELD ? &chip_clock_field
                                             : by == BY_CAN ? &chip_clock_link
                                                            : &chip_clock_wire;
    const bool locked = clock->locked;
    const int16_t late = by == BY_FIELD ? source->late_ticks : 0;
    if (source->by_field) {
        source->settled_chip = clock->chip + SOURCE_SLEW_CHIPS;
    }
    if (locked) {
        chip_clock_change(clock, edges);
        chip_clock_late(clock, late);
    } else {
        chip_clock_forget(clock, edges);
        clock->late_ticks = late; /* The search puts the chips there. */
    }
    source->by_field = by == BY_FIELD;
    link->follows = by == BY_CAN;
    link->good = 0;
    source->wire_good = 0;
    source->wire_chip = clock->chip;
    source->field_chip = clock->chip;
    link->message_chip = by == BY_CAN ? clock->chip : link->message_chip;
    source->changes++;
}

void source_choose(source_t *source, chip_clock_t *clock, sync_link_t *link) {
    const by_t by = best(source, clock, link), before = followed(source, link);
    const bool to_field = by == BY_FIELD && before != BY_FIELD;
    if (to_field && source->stage == SOURCE_IDLE) {
        source->error_ns = chip_clock_quality(clock, HAL_TICKS_PER_SECOND / 1000000u).error_ns;
        source->stage = SOURCE_ASKED;
    }
    if (by != before && (!to_field || source->stage == SOURCE_READY)) {
        go_over(source, clock, link, by);
        source->stage = SOURCE_IDLE;
    } else if (!to_field) {
        source->stage = SOURCE_IDLE;
    }
}
