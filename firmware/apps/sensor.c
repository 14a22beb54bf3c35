#include "sensor.h"

#include <string.h>

#include "goldfield.h"
#include "protocol_hash.h"
#include "sync.h"

#define PI 3.14159265f

/* Index of a PART (framing.md). */
#define PART_STRIDE 1026u
#define PART_PLAIN 1025u

/* Messages of a cycle beside its FIELDs: EPOCH, EPOCH_STATUS, EPOCH_OFFSET, and three of the pose. */
#define REPORT_BESIDE 6u

/* ---- Interrupts ---- */

static void on_plan(void *context, uint32_t block, hal_plan_t *plan) {
    sensor_t *sensor = context;
    (void)block; /* The chip clock counts along. */
    sync_link_serve(&sensor->link, &sensor->clock, &sensor->format, sensor->hal);
    if (sensor->by_field) {
        acquire_plan(sensor->acquire, &sensor->clock);
    }
    for (uint32_t i = 0; i < HAL_BLOCK_CHIPS; i++) {
        plan->period_ticks[i] = chip_clock_plan(&sensor->clock).period_ticks;
        plan->drive[i] = HAL_DRIVE_OFF;
    }
}

/* Axis by axis: a saturated one says so, the others keep their value. */
static void mark_saturated(const uint16_t burst[HAL_BURST][HAL_AXES], int16_t shown[HAL_AXES]) {
    for (uint32_t axis = 0; axis < HAL_AXES; axis++) {
        for (uint32_t i = 0; i < HAL_BURST; i++) {
            if (burst[i][axis] == 0 || burst[i][axis] >= HAL_SAMPLE_MAX) {
                shown[axis] = INT16_MIN;
            }
        }
    }
}

static void stream_chip(sensor_t *sensor, uint32_t cycle, uint16_t code_chip, const uint16_t burst[HAL_BURST][HAL_AXES],
                        const int16_t sample[HAL_AXES], bool saturated) {
    int16_t shown[HAL_AXES] = {sample[0], sample[1], sample[2]};
    if (saturated) {
        mark_saturated(burst, shown);
    }
    const struct goldfield_chip_t message = {.x = shown[0], .y = shown[1], .z = shown[2], .cycle_low = (uint16_t)cycle};
    frame_t frame = {.id = sensor->stream_id | (uint32_t)code_chip << PROTOCOL_INDEX_SHIFT};
    frame.length = (uint8_t)goldfield_chip_pack(frame.data, &message, sizeof frame.data);
    (void)queue_push(&sensor->stream, &frame); /* The queue counts what it refuses. */
}

static void on_samples(void *context, uint32_t block, const hal_samples_t *samples) {
    sensor_t *sensor = context;
    const bool locked = sensor->clock.locked;
    for (uint32_t i = 0; i < HAL_BLOCK_CHIPS; i++) {
        const uint32_t absolute = block * HAL_BLOCK_CHIPS + i;
        chip_clock_chip_t chip;
        const uint64_t start = sensor->ticks;
        if (!chip_clock_at(&sensor->clock, absolute, &chip)) {
            sensor->ticks += HAL_CHIP_TICKS;
            continue; /* More than a block late: epoch_feed sees the gap. */
        }
        sensor->ticks += chip.period_ticks;
        int16_t sample[HAL_AXES];
        const bool saturated = epoch_sample((*samples)[i], sample);
        const uint32_t cycle = sync_cycle(&sensor->format, &chip);
        const uint16_t code_chip = sync_chip(&sensor->format, &chip);
        if (sensor->by_field) {
            acquire_feed(sensor->acquire, absolute, &chip, (*samples)[i]);
            acquire_sample((*samples)[i], sample);
        }
        if (epoch_feed(&sensor->collector, absolute, cycle, code_chip, sample, saturated, locked)) {
            const uint64_t end = code_chip == 0 ? start : sensor->ticks; /* 0: the cycle before ended in a gap. */
            sensor->middle_ticks = (sensor->cycle_start_ticks + end) / 2;
        }
        if (code_chip == 0) {
            sensor->cycle_start_ticks = start;
        }
        if (sensor->streaming) {
            stream_chip(sensor, cycle, code_chip, (*samples)[i], sample, saturated);
        }
    }
    sensor->sampled = true;
}

static void on_sync(void *context, uint32_t chip, uint16_t ticks) {
    sensor_t *sensor = context;
    if (sensor->by_field || sensor->link.follows) {
        chip_clock_compare(&sensor->clock, chip, ticks);
    } else {
        chip_clock_edge(&sensor->clock, chip, ticks);
    }
    sensor->edge_us = (uint32_t)hal_microseconds(sensor->hal);
}

/* ---- Main ---- */

static void start_acquire(acquire_t *acquire) {
    const hal_burst_t burst = hal_burst_timing();
    const acquire_config_t config = {
        .nominal_ticks = HAL_CHIP_TICKS,
        .first_conversion_ticks = burst.first_ticks,
        .conversion_ticks = burst.spacing_ticks,
        .lag_ticks = (uint16_t)((float)HAL_TICKS_PER_SECOND / (2.0f * PI * (float)HAL_FRONT_END_HZ)),
    };
    acquire_init(acquire, &config);
}

static void apply_sync_source(sensor_t *sensor, uint32_t source, const uint16_t *codes, uint32_t count) {
    const bool by_field = source == SYNC_BY_FIELD, by_can = source == SYNC_BY_CAN;
    if (by_field != sensor->by_field || by_can != sensor->link.follows) {
        sensor->by_field = false; /* First: the interrupts keep their hands off. */
        sync_link_follow(&sensor->link, &sensor->clock, by_can);
        start_acquire(sensor->acquire);
    }
    if (by_field) {
        acquire_codes(sensor->acquire, codes, count);
    }
    sensor->by_field = by_field;
}

static void apply_parameters(sensor_t *sensor) {
    const parameters_t *parameters = &sensor->node.parameters;
    for (uint32_t row = 0; row < HAL_AXES; row++) {
        sensor->calibration.zero[row] = parameters_float(parameters, PARAMETER_ZERO + row);
        for (uint32_t column = 0; column < HAL_AXES; column++) {
            sensor->calibration.matrix[row][column] = parameters_float(parameters, PARAMETER_CALIBRATION + HAL_AXES * row + column);
        }
    }
    uint16_t codes[PARAMETER_CODE_LIST_LENGTH];
    const uint32_t count = parameters_unsigned(parameters, PARAMETER_CODE_COUNT);
    bool same = count == sensor->selection.count;
    for (uint32_t i = 0; i < count; i++) {
        codes[i] = (uint16_t)parameters_unsigned(parameters, PARAMETER_CODE_LIST + i);
        same = same && codes[i] == sensor->selection.codes[i].code;
    }
    if (!same) {
        (void)epoch_select(&sensor->selection, sensor->collector.family, codes, count);
        sensor->cycle.third = EPOCH_WHOLE; /* Thirds of the old list and of the new are not added. */
    }
    onboard_configure(&sensor->onboard, parameters, sensor->format.chips, &sensor->selection);
    const bool degree_10 = sensor->format.degree == 10u;
    const uint32_t source = parameters_unsigned(parameters, PARAMETER_SYNC_SOURCE);
    apply_sync_source(sensor, source == SYNC_BY_FIELD && !degree_10 ? SYNC_BY_WIRE : source, codes, count);
    sensor->collector.thirds = degree_10 && parameters_unsigned(parameters, PARAMETER_PARTS) == EPOCH_THIRDS;
    sensor->stream_id = node_identifier(&sensor->node, GOLDFIELD_CHIP_FRAME_ID, 0);
    sensor->streaming = parameters_unsigned(parameters, PARAMETER_STREAM) == 1;
}

static void send_header(sensor_t *sensor, node_links_t links, const epoch_sums_t *cycle) {
    node_t *node = &sensor->node;
    uint8_t data[8];
    const struct goldfield_epoch_t header = {
        .cycle = cycle->cycle & SYNC_CYCLE_MASK,
        .time = sensor->middle_ticks / (HAL_TICKS_PER_SECOND / 1000000u),
    };
    uint8_t length = (uint8_t)goldfield_epoch_pack(data, &header, sizeof data);
    node_send(node, links, GOLDFIELD_EPOCH_FRAME_ID, 0, data, length);

    const struct goldfield_epoch_status_t status = {
        .cycle_low = cycle->cycle & 0xFu,
        .chips = (uint16_t)(cycle->chips - cycle->missing),
        .saturated = cycle->saturated,
        .fields = (uint16_t)sensor->selection.count,
        .locked = cycle->locked,
        .phase = (int16_t)node_clamp(sync_phase(sensor->clock.phase_ticks), 8191),
        .temperature = (int16_t)node_clamp(hal_temperature(sensor->hal), 2047),
    };
    length = (uint8_t)goldfield_epoch_status_pack(data, &status, sizeof data);
    node_send(node, links, GOLDFIELD_EPOCH_STATUS_FRAME_ID, 0, data, length);
}

static void report(sensor_t *sensor, node_links_t links, const epoch_sums_t *cycle) {
    node_t *node = &sensor->node;
    uint8_t data[8];
    send_header(sensor, links, cycle);

    float mean[HAL_AXES];
    epoch_offset(cycle, &sensor->calibration, mean);
    const struct goldfield_epoch_offset_t offset = {
        .x = epoch_integer(mean[0], 1e-9f),
        .y = epoch_integer(mean[1], 1e-9f),
        .z = epoch_integer(mean[2], 1e-9f),
        .cycle_low = cycle->cycle & 0xFu,
    };
    uint8_t length = (uint8_t)goldfield_epoch_offset_pack(data, &offset, sizeof data);
    node_send(node, links, GOLDFIELD_EPOCH_OFFSET_FRAME_ID, 0, data, length);

    for (uint32_t i = 0; i < sensor->selection.count; i++) {
        float vector[HAL_AXES];
        epoch_field(cycle, &sensor->calibration, &sensor->selection, i, vector);
        const struct goldfield_field_t field = {
            .x = epoch_integer(vector[0], 1e-10f),
            .y = epoch_integer(vector[1], 1e-10f),
            .z = epoch_integer(vector[2], 1e-10f),
            .cycle_low = cycle->cycle & 0xFu,
        };
        length = (uint8_t)goldfield_field_pack(data, &field, sizeof data);
        node_send(node, links, GOLDFIELD_FIELD_FRAME_ID, sensor->selection.codes[i].code, data, length);
    }
    onboard_take(&sensor->onboard, cycle, &sensor->calibration, &sensor->selection);
}

static void send_part(sensor_t *sensor, node_links_t links, const epoch_sums_t *part, uint32_t code, const float vector[HAL_AXES]) {
    uint8_t data[8];
    const struct goldfield_part_t message = {
        .x = epoch_integer(vector[0], 1e-10f),
        .y = epoch_integer(vector[1], 1e-10f),
        .z = epoch_integer(vector[2], 1e-10f),
        .cycle_low = part->cycle & 0xFu,
    };
    const uint8_t length = (uint8_t)goldfield_part_pack(data, &message, sizeof data);
    node_send(&sensor->node, links, GOLDFIELD_PART_FRAME_ID, part->third * PART_STRIDE + code, data, length);
}

static void report_third(sensor_t *sensor, node_links_t links, const epoch_sums_t *part) {
    float vector[HAL_AXES];
    for (uint32_t i = 0; i < sensor->selection.count; i++) {
        epoch_field(part, &sensor->calibration, &sensor->selection, i, vector);
        send_part(sensor, links, part, sensor->selection.codes[i].code, vector);
    }
    epoch_offset(part, &sensor->calibration, vector);
    send_part(sensor, links, part, PART_PLAIN, vector);
}

static node_state_t state(const sensor_t *sensor) {
    if (hal_clock(sensor->hal) != HAL_CLOCK_CRYSTAL) {
        return NODE_CLOCK_FALLBACK;
    }
    return !sensor->sampled ? NODE_STARTING : sensor->clock.locked ? NODE_RUNNING : NODE_SYNCING;
}

static void drain_stream(sensor_t *sensor) {
    const frame_t *frame;
    while ((frame = queue_front(&sensor->stream)) != NULL && node_serial_write(&sensor->node, frame)) {
        queue_drop(&sensor->stream);
    }
}

void sensor_start(sensor_t *sensor, acquire_t *acquire, hal_t *hal) {
    memset(sensor, 0, sizeof *sensor);
    sensor->hal = hal;
    sensor->acquire = acquire;
    node_start(&sensor->node, hal, HAL_ROLE_SENSOR);
    (void)queue_init(&sensor->stream, sensor->stream_messages, SENSOR_STREAM_MESSAGES);
    sensor->format = sync_format(parameters_unsigned(&sensor->node.parameters, PARAMETER_DEGREE));
    sync_clock_init(&sensor->clock, &sensor->format, true);
    epoch_init(&sensor->collector, gold_family(sensor->format.degree)); /* Only degrees that have one get through parameters_set. */
    apply_parameters(sensor);
    const hal_events_t events = {.context = sensor, .plan = on_plan, .samples = on_samples, .sync = on_sync};
    hal_chips_start(hal, HAL_ROLE_SENSOR, &events);
}

void sensor_step(sensor_t *sensor) {
    node_t *node = &sensor->node;
    epoch_t *epoch = epoch_ready(&sensor->collector);
    if (epoch) {
        epoch_read(epoch, &sensor->selection, &sensor->part);
        const node_links_t links = node_room(node, REPORT_BESIDE + sensor->selection.count); /* Whole reports or none. */
        if (sensor->part.third != EPOCH_WHOLE) {
            report_third(sensor, links, &sensor->part);
        }
        if (epoch_add(&sensor->cycle, &sensor->part, sensor->selection.count)) {
            report(sensor, links, &sensor->cycle);
            sensor->unsent += links != NODE_BOTH;
        }
        epoch_release(&sensor->collector);
    }
    node->state = state(sensor);
    node->counters[NODE_SYNC_REJECTED] = sensor->clock.edges_rejected;
    node->counters[NODE_EPOCHS_DROPPED] = sensor->collector.dropped + sensor->unsent;
    node->stream_lost = sensor->stream.lost;
    node_step(node);
    drain_stream(sensor);
    if (sensor->by_field) {
        acquire_step(sensor->acquire);
    }
    onboard_step(&sensor->onboard, node); /* After the fields are on their way; its messages leave in the next turn. */
    if (node->parameters_changed) {
        node->parameters_changed = false;
        apply_parameters(sensor);
    }
    if (node->sync_received) {
        node->sync_received = false;
        const uint32_t age_us = (uint32_t)hal_microseconds(sensor->hal) - sensor->edge_us;
        node->counters[NODE_OTHER_DEGREE] += !sync_number(&sensor->clock, &sensor->format, &sensor->link, node->sync_chips, node->sync_cycle, age_us);
    }
}
