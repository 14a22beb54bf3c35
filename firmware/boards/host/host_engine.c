/* host_engine.c: the chip engine of a host board: what a chip does to pins, set-points and converters, and when. */
#include "boards/host/host_internal.h"

#define STALE_CHIPS 2u /* Chips without a measurement after which the drive goes off (hal.h). */

/* ---- Converters ---- */

/* When a chip's currents are measured. */
typedef enum { LOOK_EDGE = 0, LOOK_MIDDLE = 1, LOOK_END = 2, LOOKS = 3 } look_t;

static uint16_t convert(const hal_t *hal, unsigned pin) {
    if (!hal->edge.analog_in) {
        return 0;
    }
    const double count = hal->edge.analog_in(hal->edge.context, pin, hal->now_ps) * (4096.0 / 3.3) + 0.5;
    return count >= HAL_SAMPLE_MAX ? HAL_SAMPLE_MAX : count > 0 ? (uint16_t)count : 0; /* 0 for what is not a number. */
}

/* Converts the currents and, but behind an edge, with them what changes more slowly. */
static void measure(hal_t *hal, look_t look) {
    engine_t *engine = &hal->engine;
    engine->current[0] = convert(hal, PIN_CURRENT_0);
    engine->current[1] = convert(hal, PIN_CURRENT_1);
    if (look == LOOK_EDGE) {
        return;
    }
    engine->monitor.supply = convert(hal, PIN_SUPPLY);
    engine->monitor.coil[0] = convert(hal, PIN_COIL_TEMPERATURE_0);
    engine->monitor.coil[1] = convert(hal, PIN_COIL_TEMPERATURE_1);
    engine->monitor.driver = convert(hal, PIN_DRIVER_TEMPERATURE);
}

/* ---- Chip engine ---- */

static uint32_t period_of(const hal_plan_t *plan, uint32_t chip) {
    const uint32_t period = plan->period_ticks[chip];
    return period < HAL_CHIP_TICKS_MIN ? HAL_CHIP_TICKS_MIN : period > HAL_CHIP_TICKS_MAX ? HAL_CHIP_TICKS_MAX : period;
}

static uint32_t planned_period(const engine_t *engine) {
    return period_of(&engine->plan[engine->block & 1], engine->chip_in_block);
}

/* A chip's events have numbers. 0 is the start of the very first chip; then, where there are coils, come the sampling
 * of their currents and the end of that conversion for each look at them (an anchor has none behind the edge); then a
 * sensor's eight samplings (an anchor has both); the last is the start of the next chip. */
static look_t first_look(const engine_t *engine) {
    return engine->role == HAL_ROLE_BEACON ? LOOK_EDGE : LOOK_MIDDLE;
}

/* Returns which look an event is of. */
static look_t look_of(const engine_t *engine, uint32_t event) {
    return (look_t)(first_look(engine) + (event - 1u) / 2u);
}

/* Returns whether an event samples the currents; the next one ends that conversion. */
static bool samples_currents(uint32_t event) {
    return (event & 1u) != 0u;
}

/* Writes when the events of the chip under way are. */
static void lay_out_chip(engine_t *engine) {
    enum { CONVERTING = CONVERSION_TICKS - SAMPLE_TICKS };
    const bool samples = hal_role_samples(engine->role);
    const uint32_t end = planned_period(engine), converted = end - BURST_MARGIN_TICKS;
    const uint32_t measured = samples ? converted - (HAL_BURST + 1u) * CONVERSION_TICKS : converted;
    uint32_t event = 1;
    for (look_t look = first_look(engine); hal_role_drives(engine->role) && look < LOOKS; look++) {
        const uint32_t told = look == LOOK_EDGE     ? EDGE_TICKS + CONVERTING
                              : look == LOOK_MIDDLE ? measured - MIDDLE_TICKS
                                                    : measured;
        engine->after[event++] = told - CONVERTING;
        engine->after[event++] = told;
    }
    engine->current_events = event - 1u;
    for (uint32_t to_come = HAL_BURST; samples && to_come > 0u; to_come--) {
        engine->after[event++] = converted - to_come * CONVERSION_TICKS + SAMPLE_TICKS;
    }
    engine->last_event = event;
    engine->after[event] = end;
}

int64_t host_engine_change(const engine_t *engine) {
    const hal_plan_t *plan = &engine->plan[engine->block & 1];
    int64_t tick = engine->chip_start;
    uint32_t chip = engine->chip_in_block;
    if (engine->event == 0) {
        return tick; /* The very first chip. */
    }
    do {
        tick += period_of(plan, chip++);
    } while (chip < HAL_BLOCK_CHIPS && ((plan->drive[chip - 1u] ^ plan->drive[chip]) & HAL_PLAN_SYNC_OUT) == 0);
    return tick;
}

static void next_chip(engine_t *engine) {
    engine->chip_start += planned_period(engine);
    engine->chip++;
    engine->chip_in_block++;
    if (engine->chip_in_block == HAL_BLOCK_CHIPS) {
        engine->chip_in_block = 0;
        engine->block++;
    }
}

static void set_point_write(hal_t *hal, unsigned channel, uint16_t count) {
    const uint16_t clamped = count > HAL_SAMPLE_MAX ? HAL_SAMPLE_MAX : count;
    if (hal->engine.set_point[channel] != clamped) {
        hal->engine.set_point[channel] = clamped;
        if (hal->edge.analog_out) {
            hal->edge.analog_out(hal->edge.context, channel + 1, 3.3 * clamped / (HAL_SAMPLE_MAX + 1), hal->now_ps);
        }
    }
}

static void start_chip(hal_t *hal) {
    engine_t *engine = &hal->engine;
    const hal_plan_t *plan = &engine->plan[engine->block & 1];
    const uint32_t drive = plan->drive[engine->chip_in_block];
    host_bridges_write(hal);
    for (unsigned channel = 0; channel < HAL_CHANNELS; channel++) {
        if (hal_role_drives(engine->role)) {
            set_point_write(hal, channel, plan->set_point[channel][engine->chip_in_block]);
        }
    }
    host_pin_write(hal, PIN_SYNC_OUT, (drive & HAL_PLAN_SYNC_OUT) != 0);
    if (engine->chip_in_block == 0 && engine->block > 0) {
        if (engine->events.samples) {
            engine->events.samples(engine->events.context, engine->block - 1, (const hal_samples_t *)&engine->samples);
        }
        engine->events.plan(engine->events.context, engine->block + 1, &engine->plan[(engine->block + 1) & 1]);
        hal->awake = true;
    }
}

/* A chip has ended: without a measurement in it and in the one before, the drive goes off. */
static void check_stale(hal_t *hal) {
    engine_t *engine = &hal->engine;
    if (hal_role_drives(engine->role) && hal->pin_out[PIN_ENABLE] && ++engine->unmeasured == STALE_CHIPS) {
        host_pin_write(hal, PIN_ENABLE, false);
        host_bridges_write(hal);
        if (engine->events.fault) {
            engine->events.fault(engine->events.context, HAL_FAULT_STALE);
        }
    }
}

static void tell_currents(hal_t *hal, look_t look) {
    engine_t *engine = &hal->engine;
    const hal_events_t *events = &engine->events;
    if (look == LOOK_EDGE) {
        events->edge(events->context, engine->chip, engine->current);
    } else if (look == LOOK_MIDDLE) {
        events->middle(events->context, engine->chip, engine->current);
    } else {
        engine->unmeasured = 0;
        events->current(events->context, engine->chip, engine->current);
    }
}

static void take_event(hal_t *hal, uint32_t event) {
    engine_t *engine = &hal->engine;
    if (event == 0 || event == engine->last_event) {
        if (event > 0) {
            next_chip(engine);
            check_stale(hal);
        }
        engine->event = 1;
        start_chip(hal);
        lay_out_chip(engine);
    } else if (event > engine->current_events) {
        for (unsigned axis = 0; axis < HAL_AXES; axis++) {
            engine->samples[engine->chip_in_block][event - engine->current_events - 1][axis] = convert(
                hal, PIN_FIELD_X + axis);
        }
    } else if (hal->failed[HOST_FAILURE_CURRENT_STOPS]) {
        return;
    } else if (samples_currents(event)) {
        measure(hal, look_of(engine, event));
    } else {
        tell_currents(hal, look_of(engine, event));
    }
}

void host_engine_run(hal_t *hal, int64_t last_tick) {
    engine_t *engine = &hal->engine;
    const uint32_t waiting = hal->transmitter.count;
    do {
        host_go_to(hal, engine->next_tick);
        take_event(hal, engine->event++);
        engine->next_tick = engine->chip_start + engine->after[engine->event];
    } while (engine->next_tick <= last_tick && !hal->awake && !hal->dead && hal->transmitter.count == waiting);
}

void host_engine_sync(hal_t *hal) {
    const engine_t *engine = &hal->engine;
    if (engine->running && engine->event > 0 && engine->events.sync) {
        engine->events.sync(engine->events.context, engine->chip, (uint16_t)(host_tick(hal) - engine->chip_start));
        hal->awake = true;
    }
}
