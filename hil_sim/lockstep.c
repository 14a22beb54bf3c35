#define _POSIX_C_SOURCE 200809L
#include "lockstep.h"

#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "array.h"
#include "serial_line.h"
#include "world/noise.h"

enum { PIN_FIELD_X = 1, PIN_SYNC_IN = 10, PIN_SYNC_OUT = 40, PIN_ENABLE = 41, PIN_FAULT = 42 };
enum { SERIAL_PORT = 1, SPINS_BEFORE_YIELD = 2000 };
enum { BLOCK_STEPS = 5000, BLOCKS_BEFORE_TRYING_AGAIN = 16 }; /* A block is 0.1 s, the length of a code cycle: blocks are alike. */

/* The pins of each channel of a board's drive; its set-point is the DAC channel of the next number. */
typedef struct {
    unsigned bridge_1, bridge_2, current;
} channel_pins_t;
static const channel_pins_t channel_pins[RIG_COILS] = {{.bridge_1 = 38, .bridge_2 = 39, .current = 0}, {.bridge_1 = 36, .bridge_2 = 37, .current = 6}};

typedef struct {
    bool abort;
    unsigned mailbox;
    board_frame_t frame;
    int64_t time_ps;
} can_wish_t;

/* What belongs to one board. During a step only the thread that runs the board touches it (the sensor's thread reads coils up to visible_head). */
typedef struct {
    rig_t *rig;
    unsigned number;
    int64_t lead_ps;
    board_edge_t edge;
    board_t *instance;
    const board_operations_t *operations;
    board_status_t status;
    unsigned coils;
    coil_t coil[RIG_COILS];
    uint64_t visible_head[RIG_COILS]; /* The coils' heads before the step. */
    bool sync_cut;
    serial_line_t serial;
    can_wish_t *wishes;
    size_t wish_count, wish_capacity;
    rig_pin_change_t *sync_changes; /* Of the sync output, not yet handed on. */
    size_t sync_count, sync_capacity;
    rig_pin_change_t *changes; /* Watched pins. */
    size_t change_first, change_count, change_capacity;
} seat_t;

typedef struct {
    pthread_t *threads;
    unsigned count;
    pthread_mutex_t mutex;
    pthread_cond_t wake;
    bool running; /* rig_run() is at work: workers look for seats without sleeping. */
    bool quit;
    /* Workers help only where that is faster: on a busy machine a helper that holds a seat and is not scheduled keeps everybody waiting. */
    bool helped;           /* In the block of steps that runs now. */
    double cost_s[2];      /* Of a block without and with help, smoothed; 0: not known yet. */
    double block_s;        /* Of the block so far. */
    unsigned block_steps, blocks;
    /* Seats are handed out by number: 0, 1, 2, ... for ever; number n is seat n % seats. */
    atomic_uint_fast64_t offered, taken, done;
} crew_t;

struct rig {
    rig_config_t config;
    unsigned seats;
    unsigned coils; /* Of all boards. */
    seat_t *seat;
    int64_t now_ps;
    ambient_t ambient;
    front_end_t front_end;
    path_t path;
    double *path_coefficients;
    double *path_values;
    int64_t field_time_ps; /* field_T is of this time: the three axes are converted at once. */
    double field_T[3];
    can_bus_t *bus;
    can_transfer_t *transfers; /* For the host. */
    size_t transfer_first, transfer_count, transfer_capacity;
    int64_t *edges_ps;
    size_t edge_count, edge_capacity;
    bool watch;
    unsigned stopped;
    crew_t crew;
};

/* ---- The world at the sensor ---- */

static void field_at(const rig_t *rig, int64_t time_ps, double *path_values, double field_T[3])
{
    double ambient_T[3];
    ambient_field(&rig->ambient, time_ps, ambient_T);
    path_evaluate(&rig->path, time_ps, path_values);
    const double *const rotation = path_values + (size_t)3 * rig->coils;
    for (unsigned axis = 0; axis < 3; ++axis) {
        field_T[axis] = rotation[3 * axis] * ambient_T[0] + rotation[3 * axis + 1] * ambient_T[1] + rotation[3 * axis + 2] * ambient_T[2];
    }
    const double *per_ampere = path_values;
    for (unsigned board = 0; board < rig->seats; ++board) {
        const seat_t *const seat = &rig->seat[board];
        for (unsigned i = 0; i < seat->coils; ++i, per_ampere += 3) {
            const double lagged_A = coil_lagged(&seat->coil[i], seat->visible_head[i], time_ps);
            for (unsigned axis = 0; axis < 3; ++axis) {
                field_T[axis] += lagged_A * per_ampere[axis];
            }
        }
    }
}

static double field_volts(rig_t *rig, unsigned axis, int64_t time_ps)
{
    if (time_ps != rig->field_time_ps) {
        field_at(rig, time_ps, rig->path_values, rig->field_T);
        rig->field_time_ps = time_ps;
    }
    return front_end_volts(&rig->front_end, axis, rig->field_T, time_ps);
}

/* ---- What boards call ---- */

static void keep_change(rig_pin_change_t **changes, size_t *count, size_t *capacity, rig_pin_change_t change)
{
    *changes = array_reserve(*changes, capacity, *count + 1, sizeof **changes);
    (*changes)[(*count)++] = change;
}

static void on_pin_out(void *context, unsigned pin, bool level, int64_t time_ps)
{
    seat_t *const seat = context;
    const rig_pin_change_t change = {.time_ps = time_ps, .board = (uint16_t)seat->number, .pin = (uint8_t)pin, .level = level};
    bool wired = pin == PIN_ENABLE || pin == PIN_SYNC_OUT;
    for (unsigned i = 0; i < seat->coils; ++i) {
        if (pin == channel_pins[i].bridge_1 || pin == channel_pins[i].bridge_2) {
            coil_input(&seat->coil[i], pin == channel_pins[i].bridge_1 ? 1 : 2, level, time_ps);
            wired = true;
        } else if (pin == PIN_ENABLE) {
            coil_enable(&seat->coil[i], level, time_ps);
        }
    }
    if (pin == PIN_SYNC_OUT) {
        keep_change(&seat->sync_changes, &seat->sync_count, &seat->sync_capacity, change);
    }
    if (wired && seat->rig->watch) {
        keep_change(&seat->changes, &seat->change_count, &seat->change_capacity, change);
    }
}

static void on_analog_out(void *context, unsigned channel, double volts, int64_t time_ps)
{
    seat_t *const seat = context;
    if (channel >= 1 && channel <= seat->coils) {
        coil_reference(&seat->coil[channel - 1], volts, time_ps);
    }
}

static double on_analog_in(void *context, unsigned pin, int64_t time_ps)
{
    seat_t *const seat = context;
    if (seat->number == RIG_SENSOR) {
        return pin >= PIN_FIELD_X && pin < PIN_FIELD_X + 3 ? field_volts(seat->rig, pin - PIN_FIELD_X, time_ps) : 0.0;
    }
    for (unsigned i = 0; i < seat->coils; ++i) {
        if (pin == channel_pins[i].current) {
            return coil_sense(&seat->coil[i], seat->rig->config.seed, noise_stream(NOISE_CURRENT_SENSE, seat->number, i), time_ps);
        }
    }
    return 0.0;
}

static void on_uart_out(void *context, unsigned uart, uint8_t byte, int64_t time_ps)
{
    seat_t *const seat = context;
    (void)time_ps;
    if (uart == SERIAL_PORT) {
        serial_line_received(&seat->serial, byte);
    }
}

static void keep_wish(seat_t *seat, can_wish_t wish)
{
    seat->wishes = array_reserve(seat->wishes, &seat->wish_capacity, seat->wish_count + 1, sizeof *seat->wishes);
    seat->wishes[seat->wish_count++] = wish;
}

static void on_can_request(void *context, unsigned mailbox, const board_frame_t *frame, int64_t time_ps)
{
    keep_wish(context, (can_wish_t){.mailbox = mailbox, .frame = *frame, .time_ps = time_ps});
}

static void on_can_abort(void *context, unsigned mailbox, int64_t time_ps)
{
    keep_wish(context, (can_wish_t){.abort = true, .mailbox = mailbox, .time_ps = time_ps});
}

/* ---- Between steps: the wires ---- */

static void serve_sync_wire(rig_t *rig)
{
    seat_t *const master = &rig->seat[rig->config.sync_master];
    for (size_t i = 0; i < master->sync_count; ++i) {
        const rig_pin_change_t change = master->sync_changes[i];
        if (change.level) {
            rig->edges_ps = array_reserve(rig->edges_ps, &rig->edge_capacity, rig->edge_count + 1, sizeof *rig->edges_ps);
            rig->edges_ps[rig->edge_count++] = change.time_ps;
        }
        for (unsigned board = 0; board < rig->seats; ++board) {
            seat_t *const seat = &rig->seat[board];
            if (board != rig->config.sync_master && !seat->sync_cut) {
                seat->operations->pin_in(seat->instance, PIN_SYNC_IN, change.level, change.time_ps);
            }
        }
    }
    for (unsigned board = 0; board < rig->seats; ++board) {
        rig->seat[board].sync_count = 0;
    }
}

static void deliver(void *context, const can_transfer_t *transfer)
{
    rig_t *const rig = context;
    for (unsigned board = 0; board < rig->seats; ++board) {
        seat_t *const seat = &rig->seat[board];
        if (board == transfer->node) {
            seat->operations->can_sent(seat->instance, transfer->mailbox, transfer->acknowledged, transfer->end_ps);
        } else if (transfer->acknowledged) {
            seat->operations->can_in(seat->instance, &transfer->frame, transfer->valid_ps);
        }
    }
    if (rig->config.host_on_can) {
        if (rig->transfer_first > 0 && rig->transfer_first + rig->transfer_count == rig->transfer_capacity) {
            memmove(rig->transfers, rig->transfers + rig->transfer_first, rig->transfer_count * sizeof *rig->transfers);
            rig->transfer_first = 0;
        }
        const size_t end = rig->transfer_first + rig->transfer_count;
        rig->transfers = array_reserve(rig->transfers, &rig->transfer_capacity, end + 1, sizeof *rig->transfers);
        rig->transfers[end] = *transfer;
        ++rig->transfer_count;
    }
}

static void serve_bus(rig_t *rig)
{
    for (unsigned board = 0; board < rig->seats; ++board) {
        seat_t *const seat = &rig->seat[board];
        for (size_t i = 0; i < seat->wish_count; ++i) {
            const can_wish_t *const wish = &seat->wishes[i];
            if (wish->abort) {
                can_bus_abort(rig->bus, board, wish->mailbox, wish->time_ps);
            } else {
                can_bus_request(rig->bus, board, wish->mailbox, &wish->frame, wish->time_ps);
            }
        }
        seat->wish_count = 0;
    }
    can_bus_run(rig->bus, rig->now_ps, deliver, rig);
}

/* Only what arrives in the next quantum is handed over, so that a board never holds a long list of bytes to come. */
static void serve_serial(rig_t *rig)
{
    for (unsigned board = 0; board < rig->seats; ++board) {
        seat_t *const seat = &rig->seat[board];
        uint8_t byte;
        int64_t end_ps;
        while (serial_line_next(&seat->serial, rig->now_ps + seat->lead_ps + RIG_QUANTUM_PS, &byte, &end_ps)) {
            seat->operations->uart_in(seat->instance, SERIAL_PORT, byte, seat->serial.baud, end_ps);
        }
    }
}

static rig_status_t check_boards(rig_t *rig)
{
    for (unsigned board = 0; board < rig->seats; ++board) {
        seat_t *const seat = &rig->seat[board];
        rig->stopped = board;
        if (seat->status != BOARD_OK) {
            return RIG_BOARD_STOPPED;
        }
        for (unsigned i = 0; i < seat->coils; ++i) {
            if (seat->coil[i].changes > COIL_CHANGES_MAX) {
                return RIG_DRIVER_TOO_FAST;
            }
            seat->coil[i].changes = 0;
            seat->visible_head[i] = seat->coil[i].head;
        }
    }
    return RIG_OK;
}

/* ---- The crew: threads that run seats ---- */

/* Run one seat if one is offered. A number is only taken while its step is open: the step cannot end before that number is done. */
static bool run_a_seat(rig_t *rig)
{
    crew_t *const crew = &rig->crew;
    uint_fast64_t number = atomic_load(&crew->taken);
    if (number >= atomic_load(&crew->offered) || !atomic_compare_exchange_strong(&crew->taken, &number, number + 1)) {
        return false;
    }
    seat_t *const seat = &rig->seat[number % rig->seats];
    const int64_t until_ps = rig->now_ps + RIG_QUANTUM_PS + seat->lead_ps;
    if (until_ps > 0) {
        seat->status = seat->operations->run(seat->instance, until_ps);
    }
    (void)atomic_fetch_add(&crew->done, 1);
    return true;
}

static void *worker(void *context)
{
    rig_t *const rig = context;
    crew_t *const crew = &rig->crew;
    unsigned spins = 0;
    for (;;) {
        if (run_a_seat(rig)) {
            spins = 0;
        } else if (++spins >= SPINS_BEFORE_YIELD) {
            spins = 0;
            (void)pthread_mutex_lock(&crew->mutex);
            while (!crew->running && !crew->quit) {
                (void)pthread_cond_wait(&crew->wake, &crew->mutex);
            }
            const bool quit = crew->quit;
            (void)pthread_mutex_unlock(&crew->mutex);
            if (quit) {
                return NULL;
            }
            (void)sched_yield();
        }
    }
}

static void crew_set(crew_t *crew, bool running, bool quit)
{
    (void)pthread_mutex_lock(&crew->mutex);
    crew->running = running;
    crew->quit = quit;
    (void)pthread_cond_broadcast(&crew->wake);
    (void)pthread_mutex_unlock(&crew->mutex);
}

static bool crew_start(rig_t *rig)
{
    crew_t *const crew = &rig->crew;
    (void)pthread_mutex_init(&crew->mutex, NULL);
    (void)pthread_cond_init(&crew->wake, NULL);
    const unsigned wanted = rig->config.threads - 1; /* The caller is one of them. */
    crew->threads = calloc(wanted + 1u, sizeof *crew->threads);
    while (crew->threads != NULL && crew->count < wanted && pthread_create(&crew->threads[crew->count], NULL, worker, rig) == 0) {
        ++crew->count;
    }
    return crew->count == wanted;
}

static void step(rig_t *rig)
{
    crew_t *const crew = &rig->crew;
    const uint_fast64_t end = atomic_load(&crew->offered) + rig->seats;
    atomic_store(&crew->offered, end);
    unsigned spins = 0;
    while (atomic_load(&crew->done) < end) {
        if (!run_a_seat(rig) && ++spins >= SPINS_BEFORE_YIELD) {
            spins = 0;
            (void)sched_yield();
        }
    }
}

static double wall_clock(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* At the end of a block: go on with what has been faster, and try the other way now and then. Results do not depend on it. */
static void choose_help(crew_t *crew)
{
    double *const cost_s = &crew->cost_s[crew->helped];
    *cost_s = *cost_s > 0.0 ? 0.5 * (*cost_s + crew->block_s) : crew->block_s;
    crew->block_s = 0.0;
    crew->block_steps = 0;
    crew->helped = crew->cost_s[1] < crew->cost_s[0];
    if (++crew->blocks % BLOCKS_BEFORE_TRYING_AGAIN == 0) {
        crew->helped = !crew->helped;
    }
}

/* Steps of the current block up to a time, or the rest of the block. */
static rig_status_t run_in_block(rig_t *rig, int64_t until_ps)
{
    crew_t *const crew = &rig->crew;
    rig_status_t status = RIG_OK;
    const double start_s = wall_clock();
    crew_set(crew, crew->helped && crew->count > 0, false);
    while (status == RIG_OK && crew->block_steps < BLOCK_STEPS && rig->now_ps + RIG_QUANTUM_PS <= until_ps) {
        serve_serial(rig);
        step(rig);
        rig->now_ps += RIG_QUANTUM_PS;
        serve_sync_wire(rig);
        serve_bus(rig);
        status = check_boards(rig);
        ++crew->block_steps;
    }
    crew_set(crew, false, false);
    crew->block_s += wall_clock() - start_s;
    if (crew->block_steps == BLOCK_STEPS) {
        choose_help(crew);
    }
    return status;
}

rig_status_t rig_run(rig_t *rig, int64_t until_ps)
{
    rig_status_t status = RIG_OK;
    while (status == RIG_OK && rig->now_ps + RIG_QUANTUM_PS <= until_ps) {
        status = run_in_block(rig, until_ps);
    }
    return status;
}

/* ---- Building and asking ---- */

static bool configuration_is_good(const rig_config_t *config)
{
    const int64_t shortest_ps = (CAN_SHORTEST_EXTENDED_BITS - 1) * (INT64_C(1000000000000) / config->can_bits_per_second);
    bool good = config->beacons > 0 && config->sync_master > 0 && config->sync_master <= config->beacons && config->threads > 0 &&
                3 * (int64_t)RIG_QUANTUM_PS <= shortest_ps;
    for (unsigned board = 0; board <= config->beacons; ++board) {
        good = good && config->boards[board].coils <= RIG_COILS;
    }
    return good;
}

static void seat_init(rig_t *rig, unsigned board)
{
    seat_t *const seat = &rig->seat[board];
    seat->rig = rig;
    seat->number = board;
    seat->lead_ps = board == RIG_SENSOR ? 0 : board == rig->config.sync_master ? 2 * (int64_t)RIG_QUANTUM_PS : RIG_QUANTUM_PS;
    seat->edge = (board_edge_t){
        .context = seat,
        .pin_out = on_pin_out,
        .analog_out = on_analog_out,
        .analog_in = on_analog_in,
        .uart_out = on_uart_out,
        .can_request = on_can_request,
        .can_abort = on_can_abort,
    };
    serial_line_init(&seat->serial, rig->config.baud);
    const rig_board_config_t *const config = &rig->config.boards[board];
    seat->coils = config->coils;
    rig->coils += config->coils;
    for (unsigned i = 0; i < config->coils; ++i) {
        coil_init(&seat->coil[i], &config->coil[i]);
    }
}

rig_t *rig_create(const rig_config_t *config)
{
    if (!configuration_is_good(config)) {
        return NULL;
    }
    rig_t *const rig = calloc(1, sizeof *rig);
    if (rig == NULL) {
        return NULL;
    }
    rig->config = *config;
    rig->now_ps = -2 * (int64_t)RIG_QUANTUM_PS; /* So that those ahead get their lead before the sensor starts at 0. */
    rig->seats = config->beacons + 1;
    rig->ambient = config->ambient;
    rig->field_time_ps = -1;
    front_end_init(&rig->front_end, &config->front_end, config->seed, RIG_SENSOR);
    rig->seat = calloc(rig->seats, sizeof *rig->seat);
    rig->path_values = calloc((size_t)3 * RIG_COILS * rig->seats + 9, sizeof *rig->path_values);
    rig->bus = can_bus_create(rig->seats + 1, config->can_bits_per_second);
    if (rig->seat == NULL || rig->path_values == NULL || rig->bus == NULL) {
        rig_destroy(rig);
        return NULL;
    }
    for (unsigned board = 0; board < rig->seats; ++board) {
        seat_init(rig, board);
    }
    rig->config.boards = NULL; /* Copied; the caller's array may go. */
    if (config->host_on_can) {
        can_bus_join(rig->bus, rig->seats, 0);
    }
    if (!crew_start(rig)) {
        rig_destroy(rig);
        return NULL;
    }
    return rig;
}

void rig_destroy(rig_t *rig)
{
    if (rig == NULL) {
        return;
    }
    if (rig->crew.threads != NULL) {
        crew_set(&rig->crew, false, true);
        for (unsigned i = 0; i < rig->crew.count; ++i) {
            (void)pthread_join(rig->crew.threads[i], NULL);
        }
        (void)pthread_mutex_destroy(&rig->crew.mutex);
        (void)pthread_cond_destroy(&rig->crew.wake);
        free(rig->crew.threads);
    }
    for (unsigned board = 0; rig->seat != NULL && board < rig->seats; ++board) {
        seat_t *const seat = &rig->seat[board];
        serial_line_free(&seat->serial);
        free(seat->wishes);
        free(seat->sync_changes);
        free(seat->changes);
    }
    can_bus_destroy(rig->bus);
    free(rig->seat);
    free(rig->path_coefficients);
    free(rig->path_values);
    free(rig->transfers);
    free(rig->edges_ps);
    free(rig);
}

const board_edge_t *rig_edge(rig_t *rig, unsigned board)
{
    return &rig->seat[board].edge;
}

void rig_connect(rig_t *rig, unsigned board, board_t *instance, const board_operations_t *operations, int64_t power_on_ps)
{
    seat_t *const seat = &rig->seat[board];
    seat->instance = instance;
    seat->operations = operations;
    can_bus_join(rig->bus, board, power_on_ps);
    operations->pin_in(instance, PIN_SYNC_IN, false, 0);
    if (board != RIG_SENSOR) {
        operations->pin_in(instance, PIN_FAULT, true, 0);
    }
}

bool rig_set_path(rig_t *rig, const path_t *path)
{
    if (path->columns != (size_t)3 * rig->coils + 9 || path->intervals == 0 || path->interval_ps <= 0) {
        return false;
    }
    const size_t size = path->intervals * path->columns * 4 * sizeof(double);
    double *const copy = malloc(size);
    if (copy == NULL) {
        return false;
    }
    memcpy(copy, path->coefficients, size);
    free(rig->path_coefficients);
    rig->path_coefficients = copy;
    rig->path = *path;
    rig->path.coefficients = copy;
    return true;
}

int64_t rig_now(const rig_t *rig)
{
    return rig->now_ps > 0 ? rig->now_ps : 0;
}

unsigned rig_stopped_board(const rig_t *rig)
{
    return rig->stopped;
}

size_t rig_serial_read(rig_t *rig, unsigned board, uint8_t *bytes, size_t capacity)
{
    return serial_line_read(&rig->seat[board].serial, bytes, capacity);
}

void rig_serial_write(rig_t *rig, unsigned board, const uint8_t *bytes, size_t count)
{
    seat_t *const seat = &rig->seat[board];
    serial_line_write(&seat->serial, bytes, count, rig_now(rig) + seat->lead_ps);
}

bool rig_can_read(rig_t *rig, can_transfer_t *transfer)
{
    if (rig->transfer_count == 0) {
        return false;
    }
    *transfer = rig->transfers[rig->transfer_first++];
    if (--rig->transfer_count == 0) {
        rig->transfer_first = 0;
    }
    return true;
}

bool rig_can_write(rig_t *rig, const board_frame_t *frame)
{
    if (rig->config.host_on_can) {
        can_bus_request(rig->bus, rig->seats, 0, frame, rig_now(rig));
    }
    return rig->config.host_on_can;
}

void rig_can_statistics(const rig_t *rig, can_statistics_t *statistics)
{
    can_bus_statistics(rig->bus, statistics);
}

size_t rig_sync_edges(const rig_t *rig, size_t first, int64_t *times_ps, size_t capacity)
{
    size_t count = rig->edge_count;
    while (count > 0 && rig->edges_ps[count - 1] > rig_now(rig)) {
        --count; /* The master is ahead. */
    }
    for (size_t i = first; i < count && i - first < capacity; ++i) {
        times_ps[i - first] = rig->edges_ps[i];
    }
    return count;
}

void rig_watch_pins(rig_t *rig, bool watch)
{
    rig->watch = watch;
}

size_t rig_pin_changes(rig_t *rig, unsigned board, rig_pin_change_t *changes, size_t capacity)
{
    seat_t *const seat = &rig->seat[board];
    const size_t waiting = seat->change_count - seat->change_first;
    const size_t count = waiting < capacity ? waiting : capacity;
    if (count > 0) {
        memcpy(changes, seat->changes + seat->change_first, count * sizeof *changes);
        seat->change_first += count;
    }
    if (seat->change_first == seat->change_count) {
        seat->change_first = seat->change_count = 0;
    }
    return count;
}

double rig_coil_current(const rig_t *rig, unsigned board, unsigned coil)
{
    return coil_current(&rig->seat[board].coil[coil], rig_now(rig));
}

void rig_sensor_field(const rig_t *rig, double field_T[3])
{
    /* Values of the path at the present are scratch: nobody relies on them between calls. */
    field_at(rig, rig_now(rig), rig->path_values, field_T);
}

void rig_fault(rig_t *rig, unsigned board, unsigned coil, rig_fault_t fault, bool active)
{
    seat_t *const seat = &rig->seat[board];
    const int64_t time_ps = rig_now(rig) + seat->lead_ps;
    switch (fault) {
    case RIG_FAULT_DRIVER: seat->operations->pin_in(seat->instance, PIN_FAULT, !active, time_ps); break;
    case RIG_FAULT_COIL_OPEN: coil_open(&seat->coil[coil], active, time_ps); break;
    case RIG_FAULT_SENSE_SHORTED: seat->coil[coil].sense_shorted = active; break;
    case RIG_FAULT_SYNC_WIRE_CUT:
        seat->sync_cut = active;
        seat->operations->pin_in(seat->instance, PIN_SYNC_IN, false, time_ps);
        break;
    }
}
