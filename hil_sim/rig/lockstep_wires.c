/* lockstep_wires.c: what passes between the boards of a rig, between two of their steps: sync wire, CAN and serial
 * lines. */
#include <limits.h>
#include <string.h>

#include "rig/array.h"
#include "rig/lockstep_internal.h"

#define SYNC_TYPE       1u /* Type of the message SYNC, in the bits from SYNC_TYPE_SHIFT on (framing.md). */
#define SYNC_TYPE_SHIFT 24

/* Something comes to a board: it is due then. Returns when, not before the board's present at the end of a step. */
static int64_t arrives(rig_t *rig, unsigned board, int64_t time_ps) {
    const bool waits = rig->leaders_run && !rig->slot[board].leads;
    const int64_t reached_ps = rig->loose[board] ? rig->loose_ps : waits ? rig->begin_ps : rig->now_ps;
    const int64_t present_ps = reached_ps + rig->slot[board].lead_ps;
    const int64_t arrival_ps = time_ps > present_ps ? time_ps : present_ps;
    board_ahead_t *const ahead = &rig->ahead[board];
    ahead->due_ps = arrival_ps < ahead->due_ps ? arrival_ps : ahead->due_ps;
    ahead->asks_ps = arrival_ps < ahead->asks_ps ? arrival_ps : ahead->asks_ps;
    return arrival_ps;
}

bool wires_is_silent(const rig_t *rig, int64_t time_ps) {
    const int64_t last_ps = rig->edge_count > 0 ? rig->edges_ps[rig->edge_count - 1] : INT64_MIN / 2;
    return time_ps - last_ps > WIRES_SILENT_PS;
}

/* Lets a beacon that sends SYNC or drives the wire run ahead in place of one that drives it no more. The one before
 * stands still for a quantum, as it is ahead by that. */
static void begin_to_lead(rig_t *rig, unsigned board, int64_t time_ps) {
    if (rig->slot[board].leads && board != rig->leader && wires_is_silent(rig, time_ps)) {
        rig->slot[rig->leader].lead_ps = RIG_QUANTUM_PS;
        rig->slot[board].lead_ps = 2 * (int64_t)RIG_QUANTUM_PS;
        rig->leader = board;
    }
}

/* Any board may drive the wire high: it is the sum of the boards' outputs, as diodes make it. */
void wires_serve_sync(rig_t *rig) {
    for (unsigned leader = 0; leader < rig->leaders; ++leader) {
        const unsigned source = rig->leading[leader];
        board_slot_t *const driver = &rig->slot[source];
        for (size_t i = 0; i < driver->sync_count; ++i) {
            const rig_pin_change_t change = driver->sync_changes[i];
            const bool was_high = rig->wire_drivers > 0;
            rig->wire_drivers += change.level ? 1u : rig->wire_drivers > 0 ? UINT_MAX : 0u;
            if (was_high == (rig->wire_drivers > 0)) {
                continue;
            }
            if (change.level) {
                begin_to_lead(rig, source, change.time_ps);
                rig->edges_ps = array_reserve(rig->edges_ps, &rig->edge_capacity, rig->edge_count + 1,
                                              sizeof *rig->edges_ps);
                rig->edges_ps[rig->edge_count++] = change.time_ps;
            }
            for (unsigned board = 0; board < rig->slots; ++board) {
                board_slot_t *const slot = &rig->slot[board];
                if (board != source && !slot->sync_cut) {
                    slot->operations->pin_in(slot->instance, BOARD_PIN_SYNC_IN, change.level,
                                             arrives(rig, board, change.time_ps));
                }
            }
        }
        driver->sync_count = 0;
    }
}

void rig_glitch(rig_t *rig, int64_t after_ps, int64_t width_ps) {
    const int64_t begin_ps = rig_now(rig) + 2 * (int64_t)RIG_QUANTUM_PS + after_ps; /* The sync master is ahead. */
    for (unsigned board = 0; board < rig->slots; ++board) {
        const board_slot_t *const slot = &rig->slot[board];
        if (!slot->sync_cut) {
            slot->operations->pin_in(slot->instance, BOARD_PIN_SYNC_IN, true, arrives(rig, board, begin_ps));
            slot->operations->pin_in(slot->instance, BOARD_PIN_SYNC_IN, false, begin_ps + width_ps);
        }
    }
}

/* ---- CAN ---- */

static void follow_leader(rig_t *rig, unsigned board, const board_frame_t *frame, int64_t time_ps) {
    if (frame->extended && frame->id >> SYNC_TYPE_SHIFT == SYNC_TYPE) {
        begin_to_lead(rig, board, time_ps);
    }
}

static void keep_for_host(rig_t *rig, const can_transfer_t *transfer) {
    if (rig->transfer_first > 0 && rig->transfer_first + rig->transfer_count == rig->transfer_capacity) {
        memmove(rig->transfers, rig->transfers + rig->transfer_first, rig->transfer_count * sizeof *rig->transfers);
        rig->transfer_first = 0;
    }
    const size_t end = rig->transfer_first + rig->transfer_count;
    rig->transfers = array_reserve(rig->transfers, &rig->transfer_capacity, end + 1, sizeof *rig->transfers);
    rig->transfers[end] = *transfer;
    ++rig->transfer_count;
}

static void deliver(void *context, const can_transfer_t *transfer) {
    rig_t *const rig = context;
    for (unsigned board = 0; board < rig->slots; ++board) {
        board_slot_t *const slot = &rig->slot[board];
        if (slot->can_cut) {
            continue;
        }
        if (transfer->destroyed && slot->operations->can_error != NULL) {
            slot->operations->can_error(slot->instance,
                                        board == transfer->node ? transfer->mailbox : (unsigned)BOARD_CAN_LISTENS,
                                        arrives(rig, board, transfer->end_ps));
        } else if (board == transfer->node) {
            slot->operations->can_sent(slot->instance, transfer->mailbox, transfer->acknowledged,
                                       arrives(rig, board, transfer->end_ps));
        } else if (transfer->acknowledged) {
            slot->operations->can_in(slot->instance, &transfer->frame, arrives(rig, board, transfer->valid_ps));
        }
    }
    if (transfer->destroyed) {
        if (transfer->node == rig->slots) { /* The host's adapter tries again. */
            can_bus_request(rig->bus, transfer->node, transfer->mailbox, &transfer->frame, transfer->end_ps);
        }
    } else if (rig->config.host_on_can) {
        keep_for_host(rig, transfer);
    }
}

void wires_serve_bus(rig_t *rig) {
    for (unsigned board = 0; board < rig->slots; ++board) {
        if (!rig->asked[board] || rig->slot[board].can_cut) {
            continue;
        }
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
        rig->asked[board] = false;
    }
    can_bus_run(rig->bus, rig->now_ps, deliver, rig);
}

/* ---- Serial lines ---- */

void wires_serve_serial(rig_t *rig) {
    for (unsigned board = 0; board < rig->slots; ++board) {
        board_slot_t *const slot = &rig->slot[board];
        const int64_t until_ps = rig->end_ps + slot->lead_ps;
        uint8_t byte;
        int64_t end_ps;
        while (rig->written[board] && serial_line_next(&slot->serial, until_ps, &byte, &end_ps)) {
            slot->operations->uart_in(slot->instance, BOARD_SERIAL_PORT, byte, slot->serial.baud,
                                      arrives(rig, board, end_ps));
        }
        rig->written[board] = rig->written[board] && serial_line_waiting(&slot->serial) > 0;
    }
}
