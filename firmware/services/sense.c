#include "services/sense.h"

#include <string.h>

#include "goldfield.h"
#include "protocol_hash.h"

/* ---- Interrupts ---- */

/* Returns a bit for each axis with a saturated conversion: 1 x, 2 y, 4 z. */
static uint32_t saturated_axes(const uint16_t burst[HAL_BURST][HAL_AXES]) {
    uint32_t axes = 0;
    for (uint32_t axis = 0; axis < HAL_AXES; axis++) {
        for (uint32_t i = 0; i < HAL_BURST; i++) {
            if (burst[i][axis] == 0 || burst[i][axis] >= HAL_SAMPLE_MAX) {
                axes |= 1u << axis;
            }
        }
    }
    return axes;
}

/* Sends a chip; an axis of it that is saturated says so, the others keep their value. */
static void stream_chip(sense_t *sense, uint32_t cycle, uint16_t code_chip, const int16_t sample[HAL_AXES],
                        uint32_t saturated) {
    int16_t shown[HAL_AXES];
    for (uint32_t axis = 0; axis < HAL_AXES; axis++) {
        shown[axis] = (saturated >> axis & 1u) != 0u ? INT16_MIN : sample[axis];
    }
    const struct goldfield_chip_t message = {.x = shown[0], .y = shown[1], .z = shown[2], .cycle_low = (uint16_t)cycle};
    frame_t frame = {.id = sense->stream_id | (uint32_t)code_chip << PROTOCOL_INDEX_SHIFT};
    frame.length = (uint8_t)goldfield_chip_pack(frame.data, &message, sizeof frame.data);
    (void)queue_push(&sense->stream, &frame); /* The queue counts what it refuses. */
}

void sense_samples(sense_t *sense, uint32_t block, const hal_samples_t *samples, acquire_t *acquire) {
    const timing_t *const timing = sense->timing;
    const bool locked = timing->clock.locked && !chip_clock_contested(&timing->clock);
    const bool late = source_late(&timing->source, block * HAL_BLOCK_CHIPS);
    for (uint32_t i = 0; i < HAL_BLOCK_CHIPS; i++) {
        const uint32_t absolute = block * HAL_BLOCK_CHIPS + i;
        chip_clock_chip_t chip;
        const uint64_t start = sense->ticks;
        if (!chip_clock_at(&timing->clock, absolute, &chip)) {
            sense->ticks += HAL_CHIP_TICKS;
            continue; /* The board is more than a block late: epoch_feed sees the gap. */
        }
        sense->ticks += chip.period_ticks;
        int16_t sample[HAL_AXES];
        const uint32_t saturated = epoch_sample((*samples)[i], sample) ? saturated_axes((*samples)[i]) : 0u;
        const uint32_t cycle = sync_cycle(&timing->format, &chip);
        const uint16_t code_chip = sync_chip(&timing->format, &chip);
        if (acquire != NULL) {
            acquire_feed(acquire, absolute, &chip, (*samples)[i]);
        }
        if (late) {
            acquire_sample((*samples)[i], sample);
        }
        if (epoch_feed(&sense->collector, absolute, cycle, code_chip, sample, saturated != 0u, locked)) {
            /* With code chip 0 the cycle before it ended in a gap. */
            const uint64_t end = code_chip == 0 ? start : sense->ticks;
            sense->middle_ticks = (sense->cycle_start_ticks + end) / 2;
        }
        if (code_chip == 0) {
            sense->cycle_start_ticks = start;
        }
        if (sense->streaming) {
            stream_chip(sense, cycle, code_chip, sample, saturated);
        }
        blocks_chip(&sense->blocks, absolute, cycle, code_chip, sample, saturated, locked);
    }
    sense->sampled = true;
}

/* ---- Main ---- */

/* Returns the links that take all of a report's messages, so many. The report is counted if a link takes none. */
static node_links_t room(sense_t *sense, uint32_t messages) {
    const node_links_t links = node_room(sense->node, messages);
    sense->unsent += links != NODE_BOTH;
    node_spend(sense->node, links, messages - (sense->onboard->active ? 0u : POSE_REPORT_MESSAGES));
    return links;
}

static void send_header(sense_t *sense, node_links_t links, const epoch_sums_t *cycle) {
    node_t *node = sense->node;
    uint8_t data[8];
    const struct goldfield_epoch_t header = {
        .cycle = cycle->cycle & SYNC_CYCLE_MASK,
        .time = sense->middle_ticks / (HAL_TICKS_PER_SECOND / 1000000u),
    };
    uint8_t length = (uint8_t)goldfield_epoch_pack(data, &header, sizeof data);
    node_send(node, links, GOLDFIELD_EPOCH_FRAME_ID, 0, data, length);

    const struct goldfield_epoch_status_t status = {
        .cycle_low = cycle->cycle & 0xFu,
        .chips = (uint16_t)(cycle->chips - cycle->missing),
        .saturated = cycle->saturated,
        .fields = (uint16_t)sense->selection.count,
        .locked = cycle->locked,
        .phase = (int16_t)node_clamp(sync_phase(sense->timing->clock.phase_ticks), 8191),
        .temperature = (int16_t)node_clamp(hal_temperature(sense->node->hal), 2047),
    };
    length = (uint8_t)goldfield_epoch_status_pack(data, &status, sizeof data);
    node_send(node, links, GOLDFIELD_EPOCH_STATUS_FRAME_ID, 0, data, length);
}

static void report(sense_t *sense, node_links_t links, const epoch_sums_t *cycle) {
    node_t *node = sense->node;
    uint8_t data[8];
    send_header(sense, links, cycle);

    float mean[HAL_AXES];
    epoch_offset(cycle, &sense->calibration, mean);
    const struct goldfield_epoch_offset_t offset = {
        .x = epoch_integer(mean[0], 1e-9f),
        .y = epoch_integer(mean[1], 1e-9f),
        .z = epoch_integer(mean[2], 1e-9f),
        .cycle_low = cycle->cycle & 0xFu,
    };
    uint8_t length = (uint8_t)goldfield_epoch_offset_pack(data, &offset, sizeof data);
    node_send(node, links, GOLDFIELD_EPOCH_OFFSET_FRAME_ID, 0, data, length);

    for (uint32_t i = 0; i < sense->selection.count; i++) {
        float vector[HAL_AXES];
        epoch_field(cycle, &sense->calibration, &sense->selection, i, vector);
        const struct goldfield_field_t field = {
            .x = epoch_integer(vector[0], 1e-10f),
            .y = epoch_integer(vector[1], 1e-10f),
            .z = epoch_integer(vector[2], 1e-10f),
            .cycle_low = cycle->cycle & 0xFu,
        };
        length = (uint8_t)goldfield_field_pack(data, &field, sizeof data);
        node_send(node, links, GOLDFIELD_FIELD_FRAME_ID, sense->selection.codes[i].code, data, length);
    }
    onboard_take(sense->onboard, node, cycle, &sense->calibration, &sense->selection);
}

static void drain_stream(sense_t *sense) {
    const frame_t *frame;
    while ((frame = queue_front(&sense->stream)) != NULL && node_serial_write(sense->node, frame)) {
        queue_drop(&sense->stream);
    }
}

uint32_t sense_code_list(const sense_t *sense, uint16_t codes[EPOCH_CODES_MAX]) {
    const parameters_t *const parameters = &sense->node->parameters;
    const uint32_t count = parameters_unsigned(parameters, PARAMETER_CODE_COUNT);
    for (uint32_t i = 0; i < count; i++) {
        codes[i] = (uint16_t)parameters_unsigned(parameters, PARAMETER_CODE_LIST + i);
    }
    return count;
}

bool sense_has_codes(const sense_t *sense) {
    return sense->selection.count > 0u || parameters_unsigned(&sense->node->parameters, PARAMETER_CODE_COUNT) > 0u;
}

/* Returns the square of a reported field, in the unit of its sums. */
static float strength(const sense_t *sense, uint32_t index) {
    float square = 0.0f;
    for (uint32_t axis = 0; axis < HAL_AXES; axis++) {
        const float sum = (float)sense->cycle.correlation[index][axis];
        square += sum * sum;
    }
    return square;
}

uint32_t sense_strongest(const sense_t *sense, uint16_t *codes, uint32_t most) {
    float best[ACQUIRE_CODES_MAX];
    uint32_t count = 0;
    const uint32_t room = most < ACQUIRE_CODES_MAX ? most : ACQUIRE_CODES_MAX;
    for (uint32_t i = 0; i < sense->selection.count; i++) {
        const float next = strength(sense, i);
        uint32_t place = count < room ? count++ : room;
        for (; place > 0u && best[place - 1u] < next; place--) {
            if (place < room) {
                best[place] = best[place - 1u];
                codes[place] = codes[place - 1u];
            }
        }
        if (place < room) {
            best[place] = next;
            codes[place] = sense->selection.codes[i].code;
        }
    }
    return count;
}

static void select_listed(sense_t *sense) {
    uint16_t codes[EPOCH_CODES_MAX];
    const uint32_t count = sense_code_list(sense, codes);
    bool same = count == sense->selection.count;
    for (uint32_t i = 0; same && i < count; i++) {
        same = codes[i] == sense->selection.codes[i].code;
    }
    if (!same) {
        (void)epoch_select(&sense->selection, sense->collector.family, codes, count);
    }
}

void sense_configure(sense_t *sense) {
    const parameters_t *parameters = &sense->node->parameters;
    const sync_format_t *const format = &sense->timing->format;
    for (uint32_t row = 0; row < HAL_AXES; row++) {
        sense->calibration.zero[row] = parameters_float(parameters, PARAMETER_ZERO_X + row);
        for (uint32_t column = 0; column < HAL_AXES; column++) {
            sense->calibration.matrix[row][column] = parameters_float(parameters,
                                                                      PARAMETER_CALIBRATION + HAL_AXES * row + column);
        }
    }
    const uint32_t most = parameters_unsigned(parameters, PARAMETER_STRONGEST);
    if (most == 0u) {
        select_listed(sense);
    } else if (sense->most == 0u) {
        strongest_clear(&sense->strongest, &sense->selection);
    }
    sense->most = most;
    onboard_configure(sense->onboard, parameters, format->chips, &sense->selection);
    tracking_configure(sense->tracking, sense->onboard, parameters);
    blocks_configure(&sense->blocks, parameters);
    sense->stream_id = node_identifier(sense->node, GOLDFIELD_CHIP_FRAME_ID, 0);
    sense->streaming = parameters_unsigned(parameters, PARAMETER_STREAM) == 1;
}

void sense_start(sense_t *sense, node_t *node, const timing_t *timing, onboard_t *onboard, tracking_t *tracking) {
    memset(sense, 0, sizeof *sense);
    memset(onboard, 0, sizeof *onboard);
    memset(tracking, 0, sizeof *tracking);
    sense->node = node;
    sense->timing = timing;
    sense->onboard = onboard;
    sense->tracking = tracking;
    tracking->block = &sense->block;
    (void)queue_init(&sense->stream, sense->stream_messages, SENSE_STREAM_MESSAGES);
    /* Only degrees that have a family get through parameters_set. */
    const gold_family_t *const family = gold_family(timing->format.degree);
    strongest_init(&sense->strongest, family, &sense->collector.epochs[0].despread);
    epoch_init(&sense->collector, family);
    blocks_start(&sense->blocks, family);
    sense_configure(sense);
}

void sense_blocks(sense_t *sense) {
    node_t *const node = sense->node;
    if (!blocks_waiting(&sense->blocks)) {
        return;
    }
    const uint64_t start_us = hal_microseconds(node->hal);
    sense->block_us = start_us;
    sense->begun = false;
    do {
        if (!tracking_takes(sense->tracking)) {
            return;
        }
        const block_sums_t *const sums = blocks_step(&sense->blocks, node, &sense->selection, &sense->calibration);
        if (sums == NULL) {
            return;
        }
        tracking_take(sense->tracking, node, sums, blocks_waiting(&sense->blocks));
    } while (hal_microseconds(node->hal) - start_us < SENSE_TURN_US);
}

void sense_step(sense_t *sense) {
    node_t *node = sense->node;
    epoch_t *epoch = epoch_ready(&sense->collector);
    if (epoch != NULL) {
        despread_transform(&epoch->despread);
        if (sense->most != 0u && epoch->locked) {
            (void)strongest_choose(&sense->strongest, &epoch->despread, sense->most, &sense->selection);
        }
        epoch_read(epoch, &sense->selection, &sense->cycle);
        report(sense, room(sense, BLOCKS_REPORT_BESIDE + sense->selection.count), &sense->cycle);
        epoch_release(&sense->collector);
    }
    node->counters[COUNTER_EPOCHS_DROPPED] = sense->collector.dropped + sense->unsent;
    node->stream_lost = sense->stream.lost;
}

/* Does a step of the start of the track or of the pose of a cycle, in turn. Returns whether there was any. */
static bool spare_step(sense_t *sense) {
    sense->tracks_first = !sense->tracks_first;
    if (sense->tracks_first) {
        return tracking_search(sense->tracking, sense->node) || onboard_step(sense->onboard, sense->node);
    }
    return onboard_step(sense->onboard, sense->node) || tracking_search(sense->tracking, sense->node);
}

/* Returns whether a block that is sent comes so soon that no further step of a pose may begin before it. */
static bool block_is_near(const sense_t *sense) {
    if (sense->blocks.links == NODE_NO_LINK || sense->tracking->every != 0u || !sense->begun) {
        return false;
    }
    const uint64_t since_us = hal_microseconds(sense->node->hal) - sense->block_us;
    return since_us >= SENSE_BEGIN_US && since_us < (uint64_t)2 * SENSE_TURN_US; /* Later none comes. */
}

void sense_spare(sense_t *sense) {
    drain_stream(sense);
    const uint64_t start_us = hal_microseconds(sense->node->hal);
    while (!block_is_near(sense) && spare_step(sense)) {
        sense->begun = true;
        if (hal_microseconds(sense->node->hal) - start_us >= SENSE_TURN_US) {
            break;
        }
        sense_blocks(sense); /* A block and what is queued do not wait for the end of a long computation. */
        node_flush(sense->node);
    }
}
