#include "rig/lockstep.h"

#include <stdlib.h>
#include <string.h>

#include "rig/array.h"
#include "rig/lockstep_internal.h"

#define TASKS_MAX 64 /* A task of the pool has more boards than one if there are more. */

/* ---- A step ---- */

/* Runs a board up to an end of a quantum of the rig, unless it has nothing to do until then. */
static void run_board(rig_t *rig, unsigned board, int64_t end_ps) {
    board_slot_t *const slot = &rig->slot[board];
    const int64_t until_ps = end_ps + slot->lead_ps;
    if (until_ps <= 0 || until_ps <= rig->ahead[board].due_ps) {
        return;
    }
    if (rig->staged) {
        for (unsigned i = 0; i < slot->coils; ++i) {
            coil_forget(&slot->coil[i], rig->begin_ps);
        }
    }
    slot->status = slot->operations->run(slot->instance, until_ps);
    rig->ahead[board] = board_slot_ahead(slot);
    rig->asked[board] = slot->request_count > 0;
    rig->stuck[board] = slot->status != BOARD_OK;
    for (unsigned i = 0; i < slot->coils; ++i) {
        coil_t *const coil = &slot->coil[i];
        const uint64_t head = coil_head(coil);
        rig->latest[slot->first_coil + i] = (coil_head_t){.number = head, .made = coil->made};
        rig->stuck[board] = rig->stuck[board] || coil->changes > COIL_CHANGES_MAX;
        coil->changes = 0;
    }
    if (!slot->leads) {
        slot->sync_count = 0;
    }
}

/* A task of the pool: some boards' step. */
static void run_boards(void *context, unsigned task) {
    rig_t *const rig = context;
    const unsigned first = task * rig->boards_a_task, end = first + rig->boards_a_task;
    for (unsigned board = first; board < end && board < rig->slots; ++board) {
        if (!rig->staged || (board != RIG_SENSOR && !rig->slot[board].leads)) {
            run_board(rig, board, rig->loose[board] ? rig->loose_ps : rig->end_ps);
        }
    }
}

/* Those that may drive the sync wire run first, a quantum at a time, since they hear each other. */
static void run_leaders(rig_t *rig) {
    rig->leaders_run = true;
    while (rig->now_ps < rig->end_ps) {
        for (unsigned i = 0; i < rig->leaders; ++i) {
            run_board(rig, rig->leading[i], rig->now_ps + RIG_QUANTUM_PS);
        }
        rig->now_ps += RIG_QUANTUM_PS;
        wires_serve_sync(rig);
    }
    rig->leaders_run = false;
    rig->now_ps = rig->begin_ps;
}

/* What other boards than a coil's own see of it in the next step. */
static void show_coils(rig_t *rig) {
    memcpy(rig->coils.head, rig->latest, rig->coils.count * sizeof *rig->latest);
    ++rig->coils.shown;
}

/* Returns whether the pool has something to do in a step after the leaders. */
static bool others_run(rig_t *rig) {
    if (rig->loose_count > 0 && rig->loose_ps < rig->end_ps) {
        rig->loose_ps = look_ahead_loose(rig);
        return true;
    }
    return rig->loose_count + rig->leaders + 1u < rig->slots;
}

static void run_step(rig_t *rig) {
    rig->begin_ps = rig->now_ps;
    rig->end_ps = rig->now_ps + look_ahead_quanta(rig) * (int64_t)RIG_QUANTUM_PS;
    rig->staged = rig->loose_count > 0 || rig->end_ps > rig->now_ps + RIG_QUANTUM_PS || look_ahead_open(rig);
    wires_serve_serial(rig);
    if (!rig->staged) {
        thread_pool_step(&rig->pool);
        rig->now_ps = rig->end_ps;
        wires_serve_sync(rig);
    } else {
        run_leaders(rig);
        if (others_run(rig)) {
            thread_pool_step(&rig->pool);
        }
        show_coils(rig);
        run_board(rig, RIG_SENSOR, rig->end_ps);
        rig->now_ps = rig->end_ps;
    }
    wires_serve_bus(rig);
}

/* Did all boards get through the step? Those that look at coils in the next step see what has happened up to now. */
static rig_status_t check_boards(rig_t *rig) {
    for (unsigned board = 0; board < rig->slots; ++board) {
        if (rig->stuck[board]) {
            rig->stopped = board;
            return rig->slot[board].status != BOARD_OK ? RIG_BOARD_STOPPED : RIG_DRIVER_TOO_FAST;
        }
    }
    show_coils(rig);
    return RIG_OK;
}

/* ---- Running ---- */

/* Between two runs anybody may have told the boards anything. */
static void ask_boards(rig_t *rig) {
    rig->loose_count = 0;
    rig->loose_ps = rig->now_ps;
    for (unsigned board = 0; board < rig->slots; ++board) {
        const board_slot_t *const slot = &rig->slot[board];
        rig->ahead[board] = board_slot_ahead(slot);
        rig->loose[board] = slot->can_cut && !slot->leads && !slot->senses && slot->operations->ahead != NULL;
        rig->loose_count += rig->loose[board];
    }
    if (rig->others_sense) {
        rig->loose_count = 0;
        memset(rig->loose, 0, rig->slots * sizeof *rig->loose);
    }
}

/* Boards that had nothing to do come to the present. */
static void gather_boards(rig_t *rig) {
    for (unsigned board = 0; board < rig->slots; ++board) {
        board_slot_t *const slot = &rig->slot[board];
        const int64_t present_ps = rig->now_ps + slot->lead_ps;
        if (present_ps > 0 && present_ps <= rig->ahead[board].due_ps) {
            slot->status = slot->operations->run(slot->instance, present_ps);
        }
    }
}

rig_status_t rig_run(rig_t *rig, int64_t until_ps) {
    rig_status_t status = RIG_OK;
    rig->until_ps = until_ps;
    ++rig->coils.shown; /* Somebody may have done something to a coil. */
    ask_boards(rig);
    thread_pool_begin(&rig->pool);
    while (status == RIG_OK && rig->now_ps + RIG_QUANTUM_PS <= until_ps) {
        run_step(rig);
        status = check_boards(rig);
    }
    thread_pool_end(&rig->pool);
    gather_boards(rig);
    return status;
}

int64_t rig_now(const rig_t *rig) {
    return rig->now_ps > 0 ? rig->now_ps : 0;
}

unsigned rig_stopped_board(const rig_t *rig) {
    return rig->stopped;
}

/* ---- Building ---- */

static bool rate_is_good(uint32_t bits_per_second) {
    const int64_t shortest_ps = (CAN_SHORTEST_EXTENDED_BITS - 1) * (INT64_C(1000000000000) / bits_per_second);
    return 3 * (int64_t)RIG_QUANTUM_PS <= shortest_ps;
}

bool rig_can_rate(rig_t *rig, uint32_t bits_per_second) {
    if (!rate_is_good(bits_per_second)) {
        return false;
    }
    rig->config.can_bits_per_second = bits_per_second;
    can_bus_rate(rig->bus, bits_per_second);
    for (unsigned board = 0; board < rig->slots; ++board) {
        if (rig->slot[board].operations->can_rate != NULL) {
            rig->slot[board].operations->can_rate(rig->slot[board].instance, bits_per_second);
        }
    }
    return true;
}

static bool configuration_is_good(const rig_config_t *config) {
    bool good = config->beacons > 0 && config->sync_master > 0 && config->sync_master <= config->beacons &&
                config->threads > 0 && rate_is_good(config->can_bits_per_second);
    for (unsigned board = 0; board <= config->beacons; ++board) {
        good = good && config->boards[board].coils <= RIG_COILS;
    }
    return good;
}

static bool take_slots(rig_t *rig, const rig_config_t *config) {
    bool good = true;
    unsigned first = 0;
    for (unsigned board = 0; board < rig->slots; ++board) {
        const rig_board_config_t *const own = &config->boards[board];
        board_slot_t *const slot = &rig->slot[board];
        board_slot_init(slot, board, config->seed, own, &rig->coils.coil[first]);
        slot->lead_ps = board == RIG_SENSOR            ? 0
                        : board == config->sync_master ? 2 * (int64_t)RIG_QUANTUM_PS
                                                       : RIG_QUANTUM_PS;
        slot->leads = board == config->sync_master || own->leads;
        slot->first_coil = first;
        if (slot->leads) {
            rig->leading[rig->leaders++] = board;
        }
        serial_line_init(&slot->serial, config->baud);
        if (own->senses) {
            good = sensing_init(&slot->sensing, &rig->coils, &rig->config.ambient, &own->front_end, config->seed,
                                board) &&
                   good;
            slot->senses = true;
            rig->others_sense |= board != RIG_SENSOR;
            slot->sensing.own_first = first;
            slot->sensing.own_count = own->coils;
        }
        first += own->coils;
    }
    return good;
}

rig_t *rig_create(const rig_config_t *config) {
    if (!configuration_is_good(config)) {
        return NULL;
    }
    rig_t *const rig = calloc(1, sizeof *rig);
    if (rig == NULL) {
        return NULL;
    }
    rig->config = *config;
    rig->config.boards = NULL;                  /* Copied; the caller's array may go. */
    rig->now_ps = -2 * (int64_t)RIG_QUANTUM_PS; /* So that those ahead get their lead before the sensor starts at 0. */
    rig->slots = config->beacons + 1;
    rig->leader = config->sync_master;
    for (unsigned board = 0; board <= config->beacons; ++board) {
        rig->coils.count += config->boards[board].coils;
    }
    rig->coils.coil = calloc(rig->coils.count + 1u, sizeof *rig->coils.coil);
    rig->coils.head = calloc(rig->coils.count + 1u, sizeof *rig->coils.head);
    rig->latest = calloc(rig->coils.count + 1u, sizeof *rig->latest);
    rig->slot = calloc(rig->slots, sizeof *rig->slot);
    rig->ahead = calloc(rig->slots, sizeof *rig->ahead);
    rig->leading = calloc(rig->slots, sizeof *rig->leading);
    rig->asked = calloc(rig->slots, sizeof *rig->asked);
    rig->loose = calloc(rig->slots, sizeof *rig->loose);
    rig->written = calloc(rig->slots, sizeof *rig->written);
    rig->stuck = calloc(rig->slots, sizeof *rig->stuck);
    rig->boards_a_task = (rig->slots + TASKS_MAX - 1u) / TASKS_MAX;
    rig->bus = can_bus_create(rig->slots + 1, config->can_bits_per_second);
    const unsigned tasks = (rig->slots + rig->boards_a_task - 1u) / rig->boards_a_task;
    if (rig->coils.coil == NULL || rig->coils.head == NULL || rig->latest == NULL || rig->slot == NULL ||
        rig->ahead == NULL || rig->leading == NULL || rig->asked == NULL || rig->loose == NULL ||
        rig->written == NULL || rig->stuck == NULL || rig->bus == NULL || !take_slots(rig, config) ||
        !thread_pool_init(&rig->pool, config->threads, tasks, run_boards, rig)) {
        rig_destroy(rig);
        return NULL;
    }
    if (config->host_on_can) {
        can_bus_join(rig->bus, rig->slots, 0);
    }
    return rig;
}

void rig_destroy(rig_t *rig) {
    if (rig == NULL) {
        return;
    }
    thread_pool_free(&rig->pool);
    for (unsigned board = 0; rig->slot != NULL && board < rig->slots; ++board) {
        board_slot_free(&rig->slot[board]);
    }
    can_bus_destroy(rig->bus);
    free(rig->slot);
    free(rig->ahead);
    free(rig->leading);
    free(rig->asked);
    free(rig->loose);
    free(rig->written);
    free(rig->stuck);
    free(rig->latest);
    free(rig->coils.coil);
    free(rig->coils.head);
    free(rig->transfers);
    free(rig->edges_ps);
    free(rig);
}

const board_edge_t *rig_edge(rig_t *rig, unsigned board) {
    return &rig->slot[board].edge;
}

void rig_connect(rig_t *rig, unsigned board, board_t *instance, const board_operations_t *operations,
                 int64_t power_on_ps) {
    board_slot_t *const slot = &rig->slot[board];
    if (slot->instance != NULL) { /* The board before it is gone. */
        board_slot_power_lost(slot, rig_now(rig) + slot->lead_ps);
    }
    slot->instance = instance;
    slot->operations = operations;
    if (operations->can_rate != NULL) {
        operations->can_rate(instance, rig->config.can_bits_per_second);
    }
    can_bus_join(rig->bus, board, power_on_ps);
    operations->pin_in(instance, BOARD_PIN_SYNC_IN, false, 0);
    if (board != RIG_SENSOR) {
        board_slot_driver_fault(slot, false, 0);
    }
}

bool rig_set_path(rig_t *rig, unsigned board, const path_t *path) {
    board_slot_t *const slot = &rig->slot[board];
    return slot->senses && sensing_set_path(&slot->sensing, path);
}
