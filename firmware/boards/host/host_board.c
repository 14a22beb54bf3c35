#include "boards/host/host_internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "apps/anchor.h"
#include "apps/beacon.h"
#include "apps/sensor.h"

struct board {
    hal_t hal; /* First: a board is found from its HAL and back. */
    bool powered;
    union {
        beacon_t beacon;
        anchor_t anchor;
        struct {
            sensor_t sensor;
            acquire_t acquire;
        } sensing;
    } app;
};

/* ---- Time ---- */

__extension__ typedef unsigned __int128 wide_t;

int64_t host_time_of(const hal_t *hal, int64_t tick) {
    const wide_t product = (wide_t)(uint64_t)tick * hal->tick_q32;
    return hal->power_on_ps +
           (int64_t)((product + 0xFFFFFFFFu) >> 32); /* Rounded up, so that host_tick() gives the same tick back. */
}

int64_t host_tick(const hal_t *hal) {
    return (int64_t)(((wide_t)(uint64_t)(hal->now_ps - hal->power_on_ps) << 32) / hal->tick_q32);
}

/* ---- Pins and converters ---- */

void host_pin_write(hal_t *hal, unsigned pin, bool level) {
    if (hal->pin_out[pin] != level) {
        hal->pin_out[pin] = level;
        if (hal->edge.pin_out) {
            hal->edge.pin_out(hal->edge.context, pin, level, hal->now_ps);
        }
    }
}

static uint16_t convert(const hal_t *hal, unsigned pin) {
    if (!hal->edge.analog_in) {
        return 0;
    }
    const double count = floor(hal->edge.analog_in(hal->edge.context, pin, hal->now_ps) * (4096.0 / 3.3) + 0.5);
    return count >= HAL_SAMPLE_MAX ? HAL_SAMPLE_MAX : count > 0 ? (uint16_t)count : 0; /* Not a number: 0. */
}

/* ---- Chip engine ---- */

static uint32_t planned_period(const engine_t *engine) {
    const uint32_t period = engine->plan[engine->block & 1].period_ticks[engine->chip_in_block];
    return period < HAL_CHIP_TICKS_MIN ? HAL_CHIP_TICKS_MIN : period > HAL_CHIP_TICKS_MAX ? HAL_CHIP_TICKS_MAX : period;
}

/* Events of a chip by number: 0 is the start of the very first chip; then, where there are coils, the sampling of
 * their currents and the end of that conversion; then a sensor's eight samplings (an anchor has both); the last is
 * the start of the next chip. */
static uint32_t current_events(const engine_t *engine) {
    return hal_role_drives(engine->role) ? 2u : 0u;
}

static uint32_t last_event(const engine_t *engine) {
    return 1u + current_events(engine) + (hal_role_samples(engine->role) ? HAL_BURST : 0u);
}

static int64_t engine_tick(const engine_t *engine) {
    if (engine->event == 0) {
        return engine->chip_start;
    }
    const int64_t end = engine->chip_start + planned_period(engine);
    if (engine->event == last_event(engine)) {
        return end;
    }
    const int64_t converted = end - BURST_MARGIN_TICKS;
    const int64_t to_come = (int64_t)last_event(engine) -
                            engine->event; /* Samplings of the burst, this one included. */
    if (engine->event > current_events(engine)) {
        return converted - to_come * CONVERSION_TICKS + SAMPLE_TICKS;
    }
    const int64_t measured = hal_role_samples(engine->role) ? converted - (int64_t)(HAL_BURST + 1) * CONVERSION_TICKS
                                                            : converted;
    return engine->event == 1 ? measured - CONVERSION_TICKS + SAMPLE_TICKS : measured;
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
    static const unsigned bridges[HAL_CHANNELS] = {PIN_BRIDGE_0, PIN_BRIDGE_1};
    engine_t *engine = &hal->engine;
    const hal_plan_t *plan = &engine->plan[engine->block & 1];
    const uint32_t drive = plan->drive[engine->chip_in_block];
    for (unsigned channel = 0; channel < HAL_CHANNELS; channel++) {
        const uint32_t bridge = drive >> HAL_DRIVE_BITS * channel & 3u;
        host_pin_write(hal, bridges[channel], bridge == HAL_DRIVE_POSITIVE);
        host_pin_write(hal, bridges[channel] + 1, bridge == HAL_DRIVE_NEGATIVE);
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

static void engine_event(hal_t *hal) {
    engine_t *engine = &hal->engine;
    const uint32_t event = engine->event++;
    if (event == 0 || event == last_event(engine)) {
        if (event > 0) {
            next_chip(engine);
        }
        engine->event = 1;
        start_chip(hal);
    } else if (event > current_events(engine)) {
        for (unsigned axis = 0; axis < HAL_AXES; axis++) {
            engine->samples[engine->chip_in_block][event - current_events(engine) - 1][axis] = convert(
                hal, PIN_FIELD_X + axis);
        }
    } else if (event == 1) {
        engine->current[0] = convert(hal, PIN_CURRENT_0);
        engine->current[1] = convert(hal, PIN_CURRENT_1);
    } else {
        engine->events.current(engine->events.context, engine->chip, engine->current);
    }
}

static void sync_edge(hal_t *hal) {
    const engine_t *engine = &hal->engine;
    if (engine->running && engine->event > 0 && engine->events.sync) {
        engine->events.sync(engine->events.context, engine->chip, (uint16_t)(host_tick(hal) - engine->chip_start));
        hal->awake = true;
    }
}

/* ---- Serial ---- */

static void byte_sent(hal_t *hal) {
    transmitter_t *transmitter = &hal->transmitter;
    const uint8_t byte = transmitter->bytes[transmitter->head];
    transmitter->head = (transmitter->head + 1) % HAL_SERIAL_BUFFER;
    transmitter->count--;
    transmitter->byte_end += SERIAL_BYTE_TICKS;
    hal->awake |= transmitter->count == 0;
    if (hal->edge.uart_out) {
        hal->edge.uart_out(hal->edge.context, SERIAL_PORT, byte, hal->now_ps);
    }
}

/* ---- Inputs ---- */

static void input_add(hal_t *hal, input_t input) {
    if (hal->inputs_head + hal->inputs_count == hal->inputs_capacity) {
        if (hal->inputs_head > 0) {
            memmove(hal->inputs, hal->inputs + hal->inputs_head, hal->inputs_count * sizeof *hal->inputs);
            hal->inputs_head = 0;
        } else {
            const size_t capacity = hal->inputs_capacity ? 2 * hal->inputs_capacity : 64;
            input_t *grown = realloc(hal->inputs, capacity * sizeof *grown);
            if (!grown) {
                abort(); /* A board that silently loses an input would make a wrong simulation. */
            }
            hal->inputs = grown;
            hal->inputs_capacity = capacity;
        }
    }
    if (input.time_ps < hal->now_ps) {
        input.time_ps = hal->now_ps;
    }
    size_t at = hal->inputs_head + hal->inputs_count;
    while (at > hal->inputs_head && hal->inputs[at - 1].time_ps > input.time_ps) {
        hal->inputs[at] = hal->inputs[at - 1];
        at--;
    }
    hal->inputs[at] = input;
    hal->inputs_count++;
}

static void pin_changed(hal_t *hal, uint32_t pin, bool level) {
    if (pin == PIN_SYNC_IN) {
        const bool rising = level && !hal->sync_level;
        hal->sync_level = level;
        if (rising) {
            sync_edge(hal);
        }
    } else if (pin == PIN_FAULT) {
        const bool falling = !level && hal->fault_level;
        hal->fault_level = level;
        if (falling) {
            host_pin_write(hal, PIN_ENABLE, false);
            if (hal->engine.running && hal->engine.events.fault) {
                hal->engine.events.fault(hal->engine.events.context);
            }
            hal->awake = true;
        }
    }
}

static void byte_received(hal_t *hal, uint8_t byte, bool framed) {
    if (!framed || hal->received_count == RECEIVE_BYTES) {
        hal->counters.serial_overruns++;
        return;
    }
    hal->received[(hal->received_head + hal->received_count++) % RECEIVE_BYTES] = byte;
    hal->awake = true;
}

/* A received frame is valid one bit before its end (board_edge.h). */
static void stamp(hal_t *hal, const hal_frame_t *frame, bool sent) {
    const engine_t *engine = &hal->engine;
    if (hal_can_stamped(frame->id) && engine->running && engine->event > 0 && hal->stamps_count < STAMPS) {
        hal->stamps[(hal->stamps_head + hal->stamps_count++) % STAMPS] = (hal_stamp_t){
            .frame = *frame,
            .sent = sent,
            .chip = engine->chip,
            .ticks = (uint32_t)(host_tick(hal) - engine->chip_start) + (sent ? 0u : CAN_BIT_TICKS)};
    }
}

static void frame_received(hal_t *hal, const hal_frame_t *frame) {
    stamp(hal, frame, false);
    if (hal->frames_count == RECEIVE_FRAMES) {
        hal->counters.can_overruns++;
        return;
    }
    hal->frames[(hal->frames_head + hal->frames_count++) % RECEIVE_FRAMES] = *frame;
    hal->awake = true;
}

static void mailbox_done(hal_t *hal, uint32_t mailbox, bool ok) {
    if (hal->mailbox_count == 0 || mailbox != hal->mailbox_head) {
        return;
    }
    if (ok) {
        stamp(hal, &hal->mailbox[mailbox], true);
        hal->mailbox_head = (hal->mailbox_head + 1) % MAILBOXES;
        hal->mailbox_count--;
        hal->awake = true;
    } else {
        hal->counters.can_errors++; /* As the controller does, the same frame is sent again. */
    }
    host_can_request(hal);
}

static void input_take(hal_t *hal) {
    const input_t input = hal->inputs[hal->inputs_head++];
    hal->inputs_count--;
    if (hal->inputs_count == 0) {
        hal->inputs_head = 0;
    }
    if (input.time_ps < hal->power_on_ps && input.kind != INPUT_PIN) {
        return; /* Nobody was there to hear it; a pin keeps its level. */
    }
    switch (input.kind) {
    case INPUT_PIN:
        pin_changed(hal, input.number, input.level);
        break;
    case INPUT_BYTE:
        byte_received(hal, input.byte, input.level);
        break;
    case INPUT_FRAME:
        frame_received(hal, &input.frame);
        break;
    case INPUT_SENT:
        mailbox_done(hal, input.number, input.level);
        break;
    }
}

/* ---- Operations ---- */

static void application_start(board_t *board) {
    hal_t *hal = &board->hal;
    switch (hal->config.role) {
    case HAL_ROLE_BEACON:
        beacon_start(&board->app.beacon, hal);
        break;
    case HAL_ROLE_SENSOR:
        sensor_start(&board->app.sensing.sensor, &board->app.sensing.acquire, hal);
        break;
    case HAL_ROLE_ANCHOR:
        anchor_start(&board->app.anchor, hal);
        break;
    }
}

static void application_step(board_t *board) {
    switch (board->hal.config.role) {
    case HAL_ROLE_BEACON:
        beacon_step(&board->app.beacon);
        break;
    case HAL_ROLE_SENSOR:
        sensor_step(&board->app.sensing.sensor);
        break;
    case HAL_ROLE_ANCHOR:
        anchor_step(&board->app.anchor);
        break;
    }
}

static void application(board_t *board) {
    hal_t *hal = &board->hal;
    if (!board->powered) {
        board->powered = true;
        host_pin_write(hal, PIN_LED, true);
        application_start(board);
    }
    hal->awake = false;
    application_step(board);
    hal->idle_tick = host_tick(hal) + IDLE_TICKS;
}

typedef enum { NEXT_ENGINE, NEXT_BYTE, NEXT_INPUT, NEXT_IDLE } next_t;

/* What comes next and when. At equal times the order is that of next_t: chips first, so that an edge at a chip's
 * start belongs to that chip. */
static next_t next_event(const hal_t *hal, int64_t *time_ps) {
    next_t next = NEXT_IDLE;
    *time_ps = host_time_of(hal, hal->idle_tick);
    if (hal->inputs_count > 0 && hal->inputs[hal->inputs_head].time_ps <= *time_ps) {
        *time_ps = hal->inputs[hal->inputs_head].time_ps;
        next = NEXT_INPUT;
    }
    if (hal->transmitter.count > 0 && host_time_of(hal, hal->transmitter.byte_end) <= *time_ps) {
        *time_ps = host_time_of(hal, hal->transmitter.byte_end);
        next = NEXT_BYTE;
    }
    if (hal->engine.running && host_time_of(hal, engine_tick(&hal->engine)) <= *time_ps) {
        *time_ps = host_time_of(hal, engine_tick(&hal->engine));
        next = NEXT_ENGINE;
    }
    return next;
}

static board_status_t board_run(board_t *board, int64_t until_ps) {
    hal_t *hal = &board->hal;
    if (!board->powered && until_ps > hal->power_on_ps) {
        hal->now_ps = hal->power_on_ps;
        application(board);
    }
    int64_t time_ps;
    next_t next;
    while (board->powered && (next = next_event(hal, &time_ps), time_ps < until_ps)) {
        hal->now_ps = time_ps > hal->now_ps ? time_ps : hal->now_ps;
        switch (next) {
        case NEXT_ENGINE:
            engine_event(hal);
            break;
        case NEXT_BYTE:
            byte_sent(hal);
            break;
        case NEXT_INPUT:
            input_take(hal);
            break;
        case NEXT_IDLE:
            hal->awake = true;
            break;
        }
        if (hal->awake) {
            application(board);
        }
    }
    if (hal->now_ps < until_ps) {
        hal->now_ps = until_ps;
    }
    return BOARD_OK;
}

static int64_t board_now(const board_t *board) {
    return board->hal.now_ps;
}

static void board_pin_in(board_t *board, unsigned pin, bool level, int64_t time_ps) {
    input_add(&board->hal, (input_t){.time_ps = time_ps, .kind = INPUT_PIN, .number = pin, .level = level});
}

static void board_uart_in(board_t *board, unsigned uart, uint8_t byte, uint32_t baud, int64_t time_ps) {
    if (uart == SERIAL_PORT) {
        const bool framed = fabs((double)baud - SERIAL_BAUD) <= 0.03 * SERIAL_BAUD;
        input_add(&board->hal, (input_t){.time_ps = time_ps, .kind = INPUT_BYTE, .byte = byte, .level = framed});
    }
}

static void board_can_in(board_t *board, const board_frame_t *frame, int64_t time_ps) {
    if (frame->extended && !frame->remote && frame->length <= 8) {
        input_t input = {.time_ps = time_ps, .kind = INPUT_FRAME, .frame = {.id = frame->id, .length = frame->length}};
        memcpy(input.frame.data, frame->data, frame->length);
        input_add(&board->hal, input);
    }
}

static void board_can_sent(board_t *board, unsigned mailbox, bool ok, int64_t time_ps) {
    input_add(&board->hal, (input_t){.time_ps = time_ps, .kind = INPUT_SENT, .number = mailbox, .level = ok});
}

static const char *board_report(const board_t *board) {
    (void)board;
    return "";
}

static void board_destroy(board_t *board) {
    if (board) {
        free(board->hal.inputs);
        free(board);
    }
}

board_t *host_board_create(const host_board_config_t *config, const board_edge_t *edge, int64_t power_on_ps) {
    if (!(fabs(config->crystal_ppm) <= 100000.0)) {
        return NULL;
    }
    board_t *board = calloc(1, sizeof *board);
    if (!board) {
        return NULL;
    }
    hal_t *hal = &board->hal;
    hal->edge = *edge;
    hal->config = *config;
    hal->power_on_ps = power_on_ps;
    hal->now_ps = power_on_ps < 0 ? power_on_ps : 0;
    hal->fault_level = true; /* Pulled up. */
    hal->tick_q32 = (uint64_t)(4294967296.0 * 1e12 / (HAL_TICKS_PER_SECOND * (1.0 + config->crystal_ppm * 1e-6)) + 0.5);
    return board;
}

const board_operations_t host_board_operations = {
    .run = board_run,
    .now = board_now,
    .pin_in = board_pin_in,
    .uart_in = board_uart_in,
    .can_in = board_can_in,
    .can_sent = board_can_sent,
    .report = board_report,
    .destroy = board_destroy,
};
