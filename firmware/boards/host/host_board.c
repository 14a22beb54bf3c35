/* host_board.c: the time of a host board, what comes from outside, the application, and the operations that the
 * outside sees (board_edge.h). */
#include "boards/host/host_board.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "apps/anchor.h"
#include "apps/beacon.h"
#include "apps/sensor.h"
#include "boards/host/host_internal.h"

struct board {
    hal_t hal; /* The first member, so that a board is found from its HAL and back. */
    bool powered;
    union {
        beacon_t beacon;
        anchor_t anchor;
        sensor_t sensor;
    } app;
    acquire_t acquire;
    onboard_t onboard;
    tracking_t tracking;
};

/* ---- Serial ---- */

static void byte_sent(hal_t *hal) {
    transmitter_t *transmitter = &hal->transmitter;
    const uint8_t byte = transmitter->bytes[transmitter->head];
    transmitter->head = (transmitter->head + 1) % HAL_SERIAL_BUFFER;
    transmitter->count--;
    transmitter->byte_end += transmitter->byte_ticks;
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
    hal->due_ps = input.time_ps < hal->due_ps ? input.time_ps : hal->due_ps;
}

static void pin_changed(hal_t *hal, uint32_t pin, bool level) {
    if (pin == PIN_SYNC_IN) {
        const bool rising = level && !hal->sync_level;
        hal->sync_level = level;
        if (rising) {
            host_engine_sync(hal);
        }
    } else if (pin == PIN_FAULT) {
        const bool falling = !level && hal->fault_level;
        hal->fault_level = level;
        if (falling) {
            host_pin_write(hal, PIN_ENABLE, false);
            host_bridges_write(hal);
            if (hal->engine.running && hal->engine.events.fault) {
                hal->engine.events.fault(hal->engine.events.context, HAL_FAULT_DRIVER);
            }
            hal->awake = true;
        }
    }
}

static void byte_received(hal_t *hal, uint8_t byte, uint32_t baud) {
    const double own = hal->serial_baud;
    if (fabs(baud - own) > 0.03 * own || hal->received_count == RECEIVE_BYTES) {
        hal->counters.serial_overruns++;
        return;
    }
    hal->received[(hal->received_head + hal->received_count++) % RECEIVE_BYTES] = byte;
    hal->awake = true;
}

/* Stamps a frame with its end; a received frame is valid one bit before that (board_edge.h). */
static void stamp(hal_t *hal, const hal_frame_t *frame, bool sent) {
    const engine_t *engine = &hal->engine;
    if (hal_can_stamped(frame->id) && engine->running && engine->event > 0 && hal->stamps_count < STAMPS) {
        hal->stamps[(hal->stamps_head + hal->stamps_count++) % STAMPS] = (hal_stamp_t){
            .frame = *frame,
            .sent = sent,
            .chip = engine->chip,
            .ticks = (uint32_t)(host_tick(hal) - engine->chip_start) +
                     (sent ? 0u : HAL_TICKS_PER_SECOND / hal->can_bit_s)};
    }
}

static void frame_received(hal_t *hal, const hal_frame_t *frame) {
    if (hal->can_bit_s != hal->bus_bit_s) {
        hal->counters.can_errors++; /* Its bits are of another length. */
        return;
    }
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
        byte_received(hal, input.byte, input.number);
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
        sensor_start(&board->app.sensor, &board->acquire, &board->onboard, &board->tracking, hal);
        break;
    case HAL_ROLE_ANCHOR:
        anchor_start(&board->app.anchor, &board->onboard, &board->tracking, hal);
        break;
    }
}

static void application_step(board_t *board) {
    switch (board->hal.config.role) {
    case HAL_ROLE_BEACON:
        beacon_step(&board->app.beacon);
        break;
    case HAL_ROLE_SENSOR:
        sensor_step(&board->app.sensor);
        break;
    case HAL_ROLE_ANCHOR:
        anchor_step(&board->app.anchor);
        break;
    }
}

static void start(board_t *board) {
    board->powered = true;
    board->hal.kick_tick = host_tick(&board->hal);
    host_pin_write(&board->hal, PIN_LED, false);
    application_start(board);
}

/* Does what the reset pin does: outputs go off, and whatever the board has not sent yet is lost. Time, the levels of
 * the inputs, and what is still under way from outside stay. */
static void restart(board_t *board, hal_reset_cause_t cause) {
    static const unsigned outputs[] = {PIN_ENABLE,       PIN_SYNC_OUT, PIN_BRIDGE_0,
                                       PIN_BRIDGE_0 + 1, PIN_BRIDGE_1, PIN_BRIDGE_1 + 1};
    hal_t *hal = &board->hal;
    if (hal->mailbox_count > 0 && hal->edge.can_abort) {
        hal->edge.can_abort(hal->edge.context, hal->mailbox_head, hal->now_ps);
    }
    for (unsigned i = 0; i < sizeof outputs / sizeof outputs[0]; i++) {
        host_pin_write(hal, outputs[i], false);
    }
    hal->reset_wanted = false;
    hal->reset.cause = cause;
    hal->reset.counts[cause]++;
    hal->reset.uptime_s = (uint32_t)(hal_microseconds(hal) / 1000000u);
    hal->power_on_ps = hal->since_ps = hal->now_ps;
    hal->since_tick = 0;
    hal->tick_ps = INT64_MIN;
    memset(&hal->engine, 0, sizeof hal->engine);
    memset(&hal->transmitter, 0, sizeof hal->transmitter);
    memset(&hal->counters, 0, sizeof hal->counters);
    hal->counters.watchdog_resets = hal->reset.counts[HAL_RESET_WATCHDOG];
    hal->received_count = hal->frames_count = hal->mailbox_count = hal->stamps_count = 0;
}

static void application(board_t *board) {
    hal_t *hal = &board->hal;
    if (!board->powered) {
        start(board);
    }
    hal->awake = false;
    if (hal->failed[HOST_FAILURE_MAIN_HANGS]) {
        return;
    }
    application_step(board);
    if (hal->reset_wanted && !hal->dead) {
        restart(board, HAL_RESET_SOFTWARE);
        start(board);
        application_step(board);
    }
    hal->idle_tick = host_tick(hal) + IDLE_TICKS;
}

typedef enum { NEXT_ENGINE, NEXT_BYTE, NEXT_INPUT, NEXT_IDLE, NEXT_WATCHDOG } next_t;

typedef struct {
    next_t what;
    int64_t time_ps;
    int64_t tick;   /* What the board's own clock times has one. */
    int64_t others; /* Nothing but the engine's has an event before this tick. */
} event_t;

/* Tells what comes next and when. At equal times the order is that of next_t: chips first, so that an edge at a chip's
 * start belongs to that chip. */
static event_t next_event(const hal_t *hal) {
    const engine_t *engine = &hal->engine;
    const transmitter_t *transmitter = &hal->transmitter;
    event_t next = {.what = NEXT_IDLE, .tick = hal->idle_tick};
    if (hal->failed[HOST_FAILURE_MAIN_HANGS]) {
        next = (event_t){.what = NEXT_WATCHDOG, .tick = hal->kick_tick + WATCHDOG_TICKS};
    }
    if (transmitter->count > 0 && transmitter->byte_end <= next.tick) {
        next = (event_t){.what = NEXT_BYTE, .tick = transmitter->byte_end};
    }
    next.others = next.tick;
    if (engine->running && engine->next_tick <= next.tick) {
        next.what = NEXT_ENGINE;
        next.tick = engine->next_tick;
    }
    next.time_ps = host_time(hal, next.tick);
    if (hal->inputs_count > 0) {
        const int64_t input_ps = hal->inputs[hal->inputs_head].time_ps;
        if (input_ps < next.time_ps || (input_ps == next.time_ps && next.what > NEXT_INPUT)) {
            next = (event_t){.what = NEXT_INPUT, .time_ps = input_ps};
        }
    }
    return next;
}

/* The present goes on to an event, unless it is there already. */
static void go_to(hal_t *hal, const event_t *next) {
    if (next->what != NEXT_INPUT) {
        host_go_to(hal, next->tick);
    } else {
        hal->now_ps = next->time_ps > hal->now_ps ? next->time_ps : hal->now_ps;
        hal->tick = host_tick(hal);
        hal->tick_ps = hal->now_ps;
    }
}

/* Returns the last tick up to which the engine alone has something to do, before a time. */
static int64_t engines_own(const hal_t *hal, const event_t *next, int64_t until_ps) {
    const int64_t input_ps = hal->inputs_count > 0 ? hal->inputs[hal->inputs_head].time_ps : INT64_MAX;
    const int64_t last = host_tick_at(hal, input_ps < until_ps ? input_ps : until_ps - 1);
    return last < next->others ? last : next->others;
}

static void happen(board_t *board, const event_t *next, int64_t until_ps) {
    hal_t *hal = &board->hal;
    switch (next->what) {
    case NEXT_ENGINE:
        host_engine_run(hal, engines_own(hal, next, until_ps));
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
    case NEXT_WATCHDOG:
        restart(board, HAL_RESET_WATCHDOG);
        start(board);
        break;
    }
    if (hal->awake) {
        application(board);
    }
}

static board_status_t board_run(board_t *board, int64_t until_ps) {
    hal_t *hal = &board->hal;
    if (until_ps <= hal->due_ps) {
        hal->now_ps = until_ps > hal->now_ps ? until_ps : hal->now_ps;
        return BOARD_OK;
    }
    if (!board->powered && until_ps > hal->power_on_ps) {
        hal->now_ps = hal->power_on_ps;
        application(board);
    }
    hal->due_ps = INT64_MIN;
    while (board->powered && !hal->dead) {
        const event_t next = next_event(hal);
        if (next.time_ps >= until_ps) {
            hal->due_ps = next.time_ps;
            break;
        }
        go_to(hal, &next);
        happen(board, &next, until_ps);
    }
    if (hal->now_ps < until_ps) {
        hal->now_ps = until_ps;
    }
    return BOARD_OK;
}

static int64_t board_now(const board_t *board) {
    return board->hal.now_ps;
}

/* The application runs when a block begins, something comes from outside, the last byte has left, or it has slept for
 * long; the sync output changes with a chip. */
static board_ahead_t board_ahead(const board_t *board) {
    const hal_t *hal = &board->hal;
    board_ahead_t ahead = {.due_ps = hal->due_ps, .asks_ps = hal->due_ps};
    for (unsigned i = 0; i < HOST_FAILURES; i++) {
        if (hal->failed[i]) {
            return ahead;
        }
    }
    if (ahead.due_ps == INT64_MIN || !hal->engine.running) {
        return ahead;
    }
    const transmitter_t *transmitter = &hal->transmitter;
    const int64_t block = host_engine_change(&hal->engine);
    const int64_t sent = transmitter->byte_end + (int64_t)(transmitter->count - 1u) * transmitter->byte_ticks;
    int64_t tick = block < hal->idle_tick ? block : hal->idle_tick;
    tick = transmitter->count > 0 && sent < tick ? sent : tick;
    ahead.asks_ps = host_time(hal, tick);
    if (hal->inputs_count > 0 && hal->inputs[hal->inputs_head].time_ps < ahead.asks_ps) {
        ahead.asks_ps = hal->inputs[hal->inputs_head].time_ps;
    }
    return ahead;
}

static void board_pin_in(board_t *board, unsigned pin, bool level, int64_t time_ps) {
    input_add(&board->hal, (input_t){.time_ps = time_ps, .kind = INPUT_PIN, .number = pin, .level = level});
}

static void board_uart_in(board_t *board, unsigned uart, uint8_t byte, uint32_t baud, int64_t time_ps) {
    if (uart == SERIAL_PORT) {
        input_add(&board->hal, (input_t){.time_ps = time_ps, .kind = INPUT_BYTE, .byte = byte, .number = baud});
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

static void board_can_rate(board_t *board, uint32_t bit_s) {
    board->hal.bus_bit_s = bit_s;
    host_can_request(&board->hal);
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

static uint64_t tick_q32(double crystal_ppm) {
    return (uint64_t)(4294967296.0 * 1e12 / (HAL_TICKS_PER_SECOND * (1.0 + crystal_ppm * 1e-6)) + 0.5);
}

static bool crystal_in_range(double crystal_ppm) {
    return fabs(crystal_ppm) <= 100000.0;
}

board_t *host_board_create(const host_board_config_t *config, const board_edge_t *edge, int64_t power_on_ps) {
    if (!crystal_in_range(config->crystal_ppm)) {
        return NULL;
    }
    board_t *board = calloc(1, sizeof *board);
    if (!board) {
        return NULL;
    }
    hal_t *hal = &board->hal;
    hal->due_ps = hal->tick_ps = INT64_MIN;
    hal->edge = *edge;
    hal->config = *config;
    hal->power_on_ps = hal->since_ps = power_on_ps;
    hal->now_ps = power_on_ps < 0 ? power_on_ps : 0;
    hal->reset.cause = HAL_RESET_POWER_ON;
    hal->reset.counts[HAL_RESET_POWER_ON] = 1;
    hal->fault_level = true; /* The input is pulled up. */
    hal->bus_bit_s = BOARD_CAN_BIT_S;
    memset(hal->own_flash, 0xFF, sizeof hal->own_flash);
    hal->flash = (host_flash_t){.slot = {hal->own_flash[0], hal->own_flash[1]}};
    hal->tick_q32 = tick_q32(config->crystal_ppm);
    return board;
}

void host_board_flash(board_t *board, const host_flash_t *flash) {
    board->hal.flash = *flash;
}

void host_board_images(board_t *board, const host_images_t *images) {
    board->hal.images = *images;
}

void host_board_fail(board_t *board, host_failure_t failure, bool active) {
    board->hal.failed[failure] = active;
    board->hal.awake = true;
    board->hal.due_ps = INT64_MIN;
    board->hal.idle_tick = host_tick(&board->hal);
}

bool host_board_crystal(board_t *board, double crystal_ppm) {
    hal_t *const hal = &board->hal;
    if (!crystal_in_range(crystal_ppm)) {
        return false;
    }
    if (hal->now_ps > hal->power_on_ps) {
        const int64_t under_way = host_tick(hal);
        hal->since_ps = host_time(hal, under_way);
        hal->since_tick = under_way;
    }
    hal->tick_q32 = tick_q32(crystal_ppm);
    hal->due_ps = INT64_MIN;
    return true;
}

const board_operations_t host_board_operations = {
    .run = board_run,
    .now = board_now,
    .ahead = board_ahead,
    .pin_in = board_pin_in,
    .uart_in = board_uart_in,
    .can_in = board_can_in,
    .can_sent = board_can_sent,
    .can_rate = board_can_rate,
    .report = board_report,
    .destroy = board_destroy,
};
