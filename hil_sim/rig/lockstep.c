#include "rig/lockstep.h"

#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "rig/array.h"
#include "rig/lockstep_internal.h"

#define SYNC_TYPE       1u /* Type of the message SYNC, in the bits from SYNC_TYPE_SHIFT on (framing.md). */
#define SYNC_TYPE_SHIFT 24
#define WIRE_SILENT_PS  INT64_C(210000000000) /* Time without an edge that is longer than any sync period. */

/* ---- Between steps: the wires ---- */

/* Any board may drive the wire high: it is the sum of the boards' outputs, as diodes make it. */
static void serve_sync_wire(rig_t *rig) {
    for (unsigned source = 0; source < rig->slots; ++source) {
        board_slot_t *const driver = &rig->slot[source];
        for (size_t i = 0; driver->leads && i < driver->sync_count; ++i) {
            const rig_pin_change_t change = driver->sync_changes[i];
            const bool was_high = rig->wire_drivers > 0;
            rig->wire_drivers += change.level ? 1u : rig->wire_drivers > 0 ? UINT_MAX : 0u;
            if (was_high == (rig->wire_drivers > 0)) {
                continue;
            }
            if (change.level) {
                rig->edges_ps = array_reserve(rig->edges_ps, &rig->edge_capacity, rig->edge_count + 1,
                                              sizeof *rig->edges_ps);
                rig->edges_ps[rig->edge_count++] = change.time_ps;
            }
            for (unsigned board = 0; board < rig->slots; ++board) {
                board_slot_t *const slot = &rig->slot[board];
                if (board != source && !slot->sync_cut) {
                    slot->operations->pin_in(slot->instance, BOARD_PIN_SYNC_IN, change.level, change.time_ps);
                }
            }
        }
        driver->sync_count = 0;
    }
}

/* Lets a beacon that sends SYNC run ahead in place of one that has driven the wire no more: it begins to lead. The one
 * before stands still for a quantum, as it is ahead by that. */
static void follow_leader(rig_t *rig, unsigned board, const board_frame_t *frame, int64_t time_ps) {
    const bool sync = frame->extended && frame->id >> SYNC_TYPE_SHIFT == SYNC_TYPE;
    const int64_t last_ps = rig->edge_count > 0 ? rig->edges_ps[rig->edge_count - 1] : INT64_MIN / 2;
    if (sync && rig->slot[board].leads && board != rig->leader && time_ps - last_ps > WIRE_SILENT_PS) {
        rig->slot[rig->leader].lead_ps = RIG_QUANTUM_PS;
        rig->slot[board].lead_ps = 2 * (int64_t)RIG_QUANTUM_PS;
        rig->leader = board;
    }
}

static void deliver(void *context, const can_transfer_t *transfer) {
    rig_t *const rig = context;
    for (unsigned board = 0; board < rig->slots; ++board) {
        board_slot_t *const slot = &rig->slot[board];
        if (transfer->destroyed && slot->operations->can_error != NULL) {
            slot->operations->can_error(slot->instance,
                                        board == transfer->node ? transfer->mailbox : (unsigned)BOARD_CAN_LISTENS,
                                        transfer->end_ps);
        } else if (board == transfer->node) {
            slot->operations->can_sent(slot->instance, transfer->mailbox, transfer->acknowledged, transfer->end_ps);
        } else if (transfer->acknowledged) {
            slot->operations->can_in(slot->instance, &transfer->frame, transfer->valid_ps);
        }
    }
    if (transfer->destroyed) {
        if (transfer->node == rig->slots) { /* The host's adapter tries again. */
            can_bus_request(rig->bus, transfer->node, transfer->mailbox, &transfer->frame, transfer->end_ps);
        }
        return;
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

static void serve_bus(rig_t *rig) {
    for (unsigned board = 0; board < rig->slots; ++board) {
        board_slot_t *const slot = &rig->slot[board];
        for (size_t i = 0; i < slot->request_count; ++i) {
            const board_slot_request_t *const request = &slot->requests[i];
            if (request->abort) {
                can_bus_abort(rig->bus, board, request->mailbox, request->time_ps);
            } else {
                follow_leader(rig, board, &request->frame, request->time_ps);
                can_bus_request(rig->bus, board, request->mailbox, &request->frame, request->time_ps);
            }
        }
        slot->request_count = 0;
    }
    can_bus_run(rig->bus, rig->now_ps, deliver, rig);
}

/* Only what arrives in the next quantum is handed over, so that a board never holds a long list of bytes to come. */
static void serve_serial(rig_t *rig) {
    for (unsigned board = 0; board < rig->slots; ++board) {
        board_slot_t *const slot = &rig->slot[board];
        uint8_t byte;
        int64_t end_ps;
        while (serial_line_next(&slot->serial, rig->now_ps + slot->lead_ps + RIG_QUANTUM_PS, &byte, &end_ps)) {
            slot->operations->uart_in(slot->instance, BOARD_SERIAL_PORT, byte, slot->serial.baud, end_ps);
        }
    }
}

/* Did all boards get through the step? Those that look at coils in the next step see what has happened up to now. */
static rig_status_t check_boards(rig_t *rig) {
    coils_t *const coils = &rig->coils;
    for (unsigned board = 0; board < rig->slots; ++board) {
        const board_slot_t *const slot = &rig->slot[board];
        rig->stopped = board;
        if (slot->status != BOARD_OK) {
            return RIG_BOARD_STOPPED;
        }
        for (unsigned i = 0; i < slot->coils; ++i) {
            if (slot->coil[i].changes > COIL_CHANGES_MAX) {
                return RIG_DRIVER_TOO_FAST;
            }
        }
    }
    for (unsigned i = 0; i < coils->count; ++i) {
        coils->coil[i].changes = 0;
        coils->head[i] = coils->coil[i].head;
    }
    return RIG_OK;
}

/* ---- Running ---- */

/* A task of the pool: one board's quantum. */
static void run_board(void *context, unsigned board) {
    const rig_t *const rig = context;
    board_slot_t *const slot = &rig->slot[board];
    const int64_t until_ps = rig->now_ps + RIG_QUANTUM_PS + slot->lead_ps;
    if (until_ps > 0) {
        slot->status = slot->operations->run(slot->instance, until_ps);
    }
}

rig_status_t rig_run(rig_t *rig, int64_t until_ps) {
    rig_status_t status = RIG_OK;
    thread_pool_begin(&rig->pool);
    while (status == RIG_OK && rig->now_ps + RIG_QUANTUM_PS <= until_ps) {
        serve_serial(rig);
        thread_pool_step(&rig->pool);
        rig->now_ps += RIG_QUANTUM_PS;
        serve_sync_wire(rig);
        serve_bus(rig);
        status = check_boards(rig);
    }
    thread_pool_end(&rig->pool);
    return status;
}

int64_t rig_now(const rig_t *rig) {
    return rig->now_ps > 0 ? rig->now_ps : 0;
}

unsigned rig_stopped_board(const rig_t *rig) {
    return rig->stopped;
}

/* ---- Building ---- */

static bool configuration_is_good(const rig_config_t *config) {
    const int64_t shortest_ps = (CAN_SHORTEST_EXTENDED_BITS - 1) *
                                (INT64_C(1000000000000) / config->can_bits_per_second);
    bool good = config->beacons > 0 && config->sync_master > 0 && config->sync_master <= config->beacons &&
                config->threads > 0 && 3 * (int64_t)RIG_QUANTUM_PS <= shortest_ps;
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
        serial_line_init(&slot->serial, config->baud);
        if (own->senses) {
            good = sensing_init(&slot->sensing, &rig->coils, &rig->config.ambient, &own->front_end, config->seed,
                                board) &&
                   good;
            slot->senses = true;
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
    rig->slot = calloc(rig->slots, sizeof *rig->slot);
    rig->bus = can_bus_create(rig->slots + 1, config->can_bits_per_second);
    if (rig->coils.coil == NULL || rig->coils.head == NULL || rig->slot == NULL || rig->bus == NULL ||
        !take_slots(rig, config) || !thread_pool_init(&rig->pool, config->threads, rig->slots, run_board, rig)) {
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
