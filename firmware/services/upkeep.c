#include "services/upkeep.h"

#include <string.h>

#include "core/link/messages.h"
#include "core/link/spread.h"
#include "goldfield.h"
#include "protocol_hash.h"
#include "services/requests.h"
#include "services/version.h"

/* The port lives if it has sent something since the last look, or has nothing to send. */
static void watch_serial(node_t *node) {
    const uint32_t waiting = hal_serial_waiting(node->hal), sent = node->serial_written - waiting;
    if (waiting == 0 || sent != node->serial_sent) {
        liveness_moved(&node->liveness, LIVENESS_LINK);
    }
    node->serial_sent = sent;
}

/* ---- Heartbeat ---- */

static void collect_counters(node_t *node) {
    hal_counters_t board;
    hal_counters(node->hal, &board);
    uint32_t *counters = node->counters;
    counters[COUNTER_FRAMES_DROPPED] = frame_dropped(&node->decoder);
    counters[COUNTER_SERIAL_OVERRUNS] = board.serial_overruns;
    counters[COUNTER_CAN_ERRORS] = board.can_errors;
    counters[COUNTER_CAN_OVERRUNS] = board.can_overruns;
    counters[COUNTER_LATE_BLOCKS] = board.late_blocks;
    counters[COUNTER_CONVERTER_OVERRUNS] = board.converter_overruns;
    counters[COUNTER_WATCHDOG_RESETS] = board.watchdog_resets;
    counters[COUNTER_SUPPLY_DIPS] = board.supply_dips;
    counters[COUNTER_CLOCK_FALLBACKS] = hal_clock(node->hal) != HAL_CLOCK_CRYSTAL;
    counters[COUNTER_MESSAGES_LOST] = node_count(node_count(node->serial.lost, node->can.lost),
                                                 node_count(node->can_lost, node->stream_lost));
}

/* Returns when the heartbeat before the first would have been: boards that are switched on together do not tell theirs
 * together. */
static uint64_t heartbeat_before(const node_t *node, uint64_t now_us) {
    const uint32_t place_us = NODE_HEARTBEAT_US / NODE_HEARTBEAT_PLACES;
    return now_us - (uint64_t)spread_place(node->id, NODE_HEARTBEAT_PLACES) * place_us;
}

static uint8_t pack_heartbeat(const node_t *node, uint8_t data[8]) {
    uint32_t errors = 0;
    for (unsigned i = 0; i < COUNTERS_COUNT; i++) {
        errors = node_count(errors, node->counters[i]);
    }
    const struct goldfield_heartbeat_t heartbeat = {
        .protocol_hash = PROTOCOL_HASH,
        .role = (uint8_t)node->role,
        .state = (uint8_t)node->state,
        .version_major = VERSION_MAJOR,
        .version_minor = VERSION_MINOR,
        .version_patch = VERSION_PATCH,
        .errors = errors > 1023 ? 1023 : (uint16_t)errors,
    };
    return (uint8_t)goldfield_heartbeat_pack(data, &heartbeat, 8);
}

static void send_heartbeat(node_t *node) {
    uint8_t data[8];
    collect_counters(node);
    uint8_t length = pack_heartbeat(node, data);
    node_send(node, NODE_BOTH, GOLDFIELD_HEARTBEAT_FRAME_ID, 0, data, length);
    for (uint32_t i = 0; i < COUNTERS_COUNT; i++) {
        if (node->counters[i] > 0) {
            const struct goldfield_counter_t counter = {.counter = (uint8_t)i, .value = node->counters[i]};
            length = (uint8_t)goldfield_counter_pack(data, &counter, sizeof data);
            node_send(node, NODE_BOTH, GOLDFIELD_COUNTER_FRAME_ID, i, data, length);
        }
    }
}

/* ---- Receiving ---- */

static void receive(node_t *node, node_links_t link, const frame_t *frame) {
    const message_fault_t fault = message_fault(frame->id, frame->length);
    if (fault != MESSAGE_OK) {
        uint32_t *const counter =
            &node->counters[fault == MESSAGE_FOREIGN ? COUNTER_FOREIGN_FRAMES : COUNTER_WRONG_LENGTH];
        *counter = node_count(*counter, 1u);
        return;
    }
    const uint32_t message = frame->id & ~((1u << PROTOCOL_TYPE_SHIFT) - 1u);
    const uint32_t index = message_index(frame->id);
    const uint32_t to = frame->id & PROTOCOL_NODE_MASK;
    if (message == GOLDFIELD_SYNC_FRAME_ID) {
        struct goldfield_sync_t sync = {0};
        (void)goldfield_sync_unpack(&sync, frame->data, frame->length);
        node->sync_received = true;
        node->sync_node = to;
        node->sync_cycle = sync.cycle;
        node->sync_chips = sync.chips;
        node->sync_rank = sync.rank;
    } else if (message == GOLDFIELD_DRIVE_STATUS_FRAME_ID) {
        struct goldfield_drive_status_t status = {0};
        (void)goldfield_drive_status_unpack(&status, frame->data, frame->length);
        node->others_in_step |= status.locked != 0u && to != node->id;
    } else if (message == GOLDFIELD_BLOCK_FRAME_ID || (message == GOLDFIELD_POSE_POSITION_FRAME_ID && index != 0)) {
        if (link == NODE_CAN && to != 0) {
            bus_share_heard(&node->share, to, hal_microseconds(node->hal));
        }
    } else {
        requests_take(node, link, frame);
    }
}

static void receive_serial(node_t *node) {
    uint8_t bytes[64];
    size_t count = sizeof bytes;
    for (uint32_t taken = 0; count == sizeof bytes && taken < UPKEEP_BYTES_A_STEP; taken += (uint32_t)count) {
        count = hal_serial_read(node->hal, bytes, sizeof bytes);
        for (size_t i = 0; i < count; i++) {
            frame_t frame;
            if (frame_decode(&node->decoder, bytes[i], &frame)) {
                receive(node, NODE_SERIAL, &frame);
            }
        }
    }
}

static void receive_can(node_t *node) {
    hal_frame_t in;
    for (uint32_t taken = 0; taken < UPKEEP_FRAMES_A_STEP && hal_can_receive(node->hal, &in); taken++) {
        frame_t frame = {.id = in.id, .length = in.length};
        memcpy(frame.data, in.data, sizeof frame.data);
        node->can_heard_us = hal_microseconds(node->hal);
        receive(node, NODE_CAN, &frame);
    }
}

/* ---- Life ---- */

static uint32_t number_from_unique_id(const hal_t *hal) {
    uint8_t unique[HAL_UNIQUE_ID_BYTES];
    hal_unique_id(hal, unique);
    return 1u + frame_crc(unique, sizeof unique) % 4095u;
}

static void arm(parameters_t *parameters, bool armed) {
    const parameter_value_t value = {.kind = PARAMETER_UNSIGNED, .bits = armed};
    (void)parameters_set(parameters, PARAMETER_ARMED, value);
}

void upkeep_start(node_t *node, hal_t *hal, hal_role_t role) {
    node_init(node, hal, role);
    parameters_init(&node->parameters);
    const parameter_value_t derived = {.kind = PARAMETER_UNSIGNED, .bits = number_from_unique_id(hal)};
    (void)parameters_set(&node->parameters, PARAMETER_NODE, derived); /* What is stored overrules it. */
    arm(&node->parameters, true);
    uint32_t refused = 0;
    const parameters_page_t page = parameters_load(&node->parameters, hal_parameter_page(hal), HAL_PARAMETER_PAGE_BYTES,
                                                   &refused);
    node->counters[COUNTER_BAD_PARAMETER_PAGE] = refused + (page == PARAMETERS_PAGE_BAD);
    const storage_found_t saved = storage_start(&node->storage, hal, &node->parameters);
    node->counters[COUNTER_TORN_SAVES] = saved.torn;
    node->counters[COUNTER_SAVED_REFUSED] = saved.refused;
    if (parameters_float(&node->parameters, PARAMETER_AMPLITUDE) == 0.0f) {
        arm(&node->parameters, false); /* It was never commissioned: whatever is set later, it waits for a start. */
    }
    node->id = (uint16_t)parameters_unsigned(&node->parameters, PARAMETER_NODE);
    node_links_start(node);

    frame_t hello = {.id = node_identifier(node, GOLDFIELD_HEARTBEAT_FRAME_ID, 0)};
    hello.length = pack_heartbeat(node, hello.data);
    uint8_t encoded[1 + FRAME_ENCODED_MAX] = {0}; /* The zero ends the frame that a reset has torn. */
    const size_t count = frame_encode(&hello, encoded + 1);
    hal_serial_write_polled(hal, encoded, 1 + count);
    (void)queue_push(&node->can, &hello);
    requests_tell_last_reset(node, NODE_BOTH);
    update_start(&node->update, hal);
    node->drive_hold = node->under_way = update_holds(&node->update);
    node->heartbeat_us = heartbeat_before(node, hal_microseconds(hal));
    liveness_start(&node->liveness, hal, role);
}

void upkeep_step(node_t *node) {
    if (requests_due(node)) {
        requests_step(node);
    }
    receive_serial(node);
    receive_can(node);
    const uint64_t now_us = hal_microseconds(node->hal);
    if (now_us - node->heartbeat_us >= NODE_HEARTBEAT_US) {
        node->heartbeat_us += NODE_HEARTBEAT_US;
        if (!parameters_intact(&node->parameters)) {
            hal_reset(node->hal); /* Nobody has set what is in force: it starts anew, and tells that. */
        }
        send_heartbeat(node);
    }
    node_drain(node, now_us);
    if (liveness_due(&node->liveness, now_us)) {
        watch_serial(node);
        liveness_step(&node->liveness, now_us);
    }
}
