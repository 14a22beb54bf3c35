#include "apps/sensor.h"

#include <string.h>

#include "services/upkeep.h"

#define PI        3.14159265f
#define NS_A_TICK (1e9f / (float)HAL_TICKS_PER_SECOND)
/* Least standard deviation, ticks, of the phase with which a clock goes over to the field: 0.24 us. The beacons' edges
 * lie by a delay of their drivers and of the front end behind the wire's. */
#define KNOWN_TICKS 40.0f

/* ---- Interrupts ---- */

static void on_plan(void *context, uint32_t block, hal_plan_t *plan) {
    sensor_t *sensor = context;
    timing_t *const timing = &sensor->timing;
    timing_serve(timing, sensor->hal, block);
    if (timing->source.by_field) {
        acquire_plan(sensor->acquire, &timing->clock);
    }
    for (uint32_t i = 0; i < HAL_BLOCK_CHIPS; i++) {
        plan->period_ticks[i] = chip_clock_plan(&timing->clock).period_ticks;
        plan->drive[i] = HAL_DRIVE_OFF;
    }
    liveness_moved(&sensor->node.liveness, LIVENESS_BLOCKS);
}

static void on_samples(void *context, uint32_t block, const hal_samples_t *samples) {
    sensor_t *sensor = context;
    sense_samples(&sensor->sense, block, samples, sensor->timing.source.by_field ? sensor->acquire : NULL);
    liveness_moved(&sensor->node.liveness, LIVENESS_SAMPLES);
}

static void on_sync(void *context, uint32_t chip, uint16_t ticks) {
    sensor_t *sensor = context;
    timing_edge(&sensor->timing, sensor->hal, chip, ticks);
}

/* ---- Main ---- */

static acquire_config_t acquire_board(void) {
    const hal_burst_t burst = hal_burst_timing();
    return (acquire_config_t){
        .nominal_ticks = HAL_CHIP_TICKS,
        .first_conversion_ticks = burst.first_ticks,
        .conversion_ticks = burst.spacing_ticks,
        .lag_ticks = (uint16_t)((float)HAL_TICKS_PER_SECOND / (2.0f * PI * (float)HAL_FRONT_END_HZ)),
    };
}

static void start_acquire(acquire_t *acquire) {
    const acquire_config_t config = acquire_board();
    acquire_init(acquire, &config);
}

static void tell_codes(acquire_t *acquire, const sense_t *sense) {
    uint16_t codes[EPOCH_CODES_MAX];
    const uint32_t count = sense_code_list(sense, codes);
    acquire_codes(acquire, codes, count);
}

static void follow(sensor_t *sensor, uint32_t parameter) {
    timing_t *const timing = &sensor->timing;
    if (parameter == SYNC_AUTOMATIC && timing->source.automatic) {
        return; /* The clock has chosen. */
    }
    const bool by_field = parameter == SYNC_BY_FIELD && timing->format.degree == 10u;
    source_automatic(&timing->source, &timing->link, parameter == SYNC_AUTOMATIC);
    const bool by_can = timing->source.automatic ? timing->link.follows : parameter == SYNC_BY_CAN;
    if (by_field != timing->source.by_field || by_can != timing->link.follows) {
        timing->source.by_field = false; /* It comes first: the interrupts now keep their hands off. */
        sync_link_follow(&timing->link, &timing->clock, by_can);
        start_acquire(sensor->acquire);
    }
    if (by_field) {
        tell_codes(sensor->acquire, &sensor->sense);
    }
    timing->source.by_field = by_field;
}

/* Prepares to follow the field when the clock that chooses its source asks for it: from the phase that it has, or with
 * a search. */
static void prepare_field(sensor_t *sensor) {
    const timing_t *const timing = &sensor->timing;
    uint16_t codes[EPOCH_CODES_MAX];
    start_acquire(sensor->acquire);
    if (timing->clock.locked) {
        const float deviation = (float)timing->source.error_ns / NS_A_TICK;
        const uint32_t count = sense_strongest(&sensor->sense, codes, ACQUIRE_CODES_MAX);
        acquire_known(sensor->acquire, codes, count, timing->clock.chip,
                      deviation > KNOWN_TICKS ? deviation : KNOWN_TICKS);
    } else {
        const uint32_t listed = sense_code_list(&sensor->sense, codes);
        const uint32_t count = listed > 0u ? listed : sense_strongest(&sensor->sense, codes, ACQUIRE_CODES_MAX);
        acquire_codes(sensor->acquire, codes, count);
    }
    source_ready(&sensor->timing.source);
}

/* Does what the field needs of main while the clock follows it, or would. */
static void serve_field(sensor_t *sensor) {
    source_t *const source = &sensor->timing.source;
    source->field_usable = source->automatic && sensor->timing.format.degree == 10u && sense_has_codes(&sensor->sense);
    if (source_asks(source)) {
        prepare_field(sensor);
    }
    if (!source->by_field) {
        return;
    }
    acquire_step(sensor->acquire);
    sensor->timing.field_error_ns = (uint32_t)(2.0f * sensor->acquire->deviation_ticks * NS_A_TICK);
    if (source->automatic && sensor->sense.cycle.locked && sensor->replaced_cycle != sensor->sense.cycle.cycle) {
        uint16_t codes[EPOCH_CODES_MAX];
        const uint32_t count = sense_strongest(&sensor->sense, codes, ACQUIRE_CODES_MAX);
        if (acquire_replace(sensor->acquire, codes, count)) {
            sensor->replaced_cycle = sensor->sense.cycle.cycle;
        }
    }
}

static node_state_t state(const sensor_t *sensor) {
    if (hal_clock(sensor->hal) != HAL_CLOCK_CRYSTAL) {
        return NODE_CLOCK_FALLBACK;
    }
    return !sensor->sense.sampled ? NODE_STARTING : sensor->timing.clock.locked ? NODE_RUNNING : NODE_SYNCING;
}

void sensor_start(sensor_t *sensor, acquire_t *acquire, onboard_t *onboard, tracking_t *tracking, hal_t *hal) {
    memset(sensor, 0, sizeof *sensor);
    sensor->hal = hal;
    sensor->acquire = acquire;
    upkeep_start(&sensor->node, hal, HAL_ROLE_SENSOR);
    timing_start(&sensor->timing, &sensor->node, false);
    const acquire_config_t config = acquire_board();
    sensor->timing.source.late_ticks = acquire_late_ticks(&config);
    sense_start(&sensor->sense, &sensor->node, &sensor->timing, onboard, tracking);
    follow(sensor, parameters_unsigned(&sensor->node.parameters, PARAMETER_SYNC_SOURCE));
    const hal_events_t events = {.context = sensor, .plan = on_plan, .samples = on_samples, .sync = on_sync};
    hal_chips_start(hal, HAL_ROLE_SENSOR, &events);
}

void sensor_step(sensor_t *sensor) {
    node_t *node = &sensor->node;
    sense_blocks(&sensor->sense);
    sense_step(&sensor->sense);
    node->state = state(sensor);
    upkeep_step(node);
    serve_field(sensor);
    sense_spare(&sensor->sense);
    if (node->parameters_changed) {
        node->parameters_changed = false;
        sense_configure(&sensor->sense);
        follow(sensor, parameters_unsigned(&node->parameters, PARAMETER_SYNC_SOURCE));
    }
    timing_step(&sensor->timing, node);
}
