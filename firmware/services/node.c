#include "services/node.h"

#include <string.h>

#include "core/link/messages.h"
#include "goldfield.h"
#include "protocol_hash.h"
#include "services/reset_report.h"
#include "services/version.h"

#define TEXT_CHARACTERS 7u /* Characters in one PARAM_TEXT. */

/* Indices of COMMAND. */
enum {
    COMMAND_IDENTITY = 0,
    COMMAND_BLINK = 1,
    COMMAND_RESET = 2,
    COMMAND_CLEAR = 3,
    COMMAND_LAST_RESET = 4,
    COMMAND_SAVE = 5
};
#define VERSION (VERSION_MAJOR << 16 | VERSION_MINOR << 8 | VERSION_PATCH) /* As parameter_set.h wants it. */

#define HALF_BYTES   (HAL_UNIQUE_ID_BYTES / 2u)
#define BLINK_US     125000u /* Time for which the blinking LED is on, and then off. */
#define RESET_US     50000u /* Time from the answer to the reset: the answer is out by then, behind a full queue too. */
#define MICROSECONDS 1000000u

static uint32_t add_saturated(uint32_t a, uint32_t b) {
    return a > UINT32_MAX - b ? UINT32_MAX : a + b;
}

/* ---- Sending ---- */

uint32_t node_identifier(const node_t *node, uint32_t message, uint32_t index) {
    return message | index << PROTOCOL_INDEX_SHIFT | node->id;
}

void node_send(node_t *node, node_links_t links, uint32_t message, uint32_t index, const uint8_t *data,
               uint8_t length) {
    frame_t frame = {.id = node_identifier(node, message, index), .length = length};
    memcpy(frame.data, data, length);
    if (links & NODE_SERIAL) {
        (void)queue_push(&node->serial, &frame); /* The queue counts what it refuses. */
    }
    if ((links & NODE_CAN) && (!node->can_dead || queue_count(&node->can) == 0)) {
        (void)queue_push(&node->can, &frame);
    }
}

node_links_t node_room(const node_t *node, uint32_t messages) {
    const bool serial = queue_count(&node->serial) + messages <= NODE_QUEUE_MESSAGES;
    const bool can = node->can_dead || queue_count(&node->can) + messages <= NODE_QUEUE_MESSAGES;
    return (serial ? NODE_SERIAL : NODE_NO_LINK) | (can ? NODE_CAN : NODE_NO_LINK);
}

node_links_t node_motion_room(node_t *node, node_links_t links, uint32_t messages, uint32_t others) {
    const node_links_t free = links & node_room(node, messages + others);
    const bool can = (free & NODE_CAN) != 0 && queue_count(&node->can) <= NODE_CAN_BACKLOG &&
                     bus_share_take(&node->share, messages, hal_microseconds(node->hal));
    return (free & NODE_SERIAL) | (can ? NODE_CAN : NODE_NO_LINK);
}

void node_spend(node_t *node, node_links_t links, uint32_t messages) {
    if (links & NODE_CAN) {
        bus_share_spend(&node->share, messages, hal_microseconds(node->hal));
    }
}

bool node_serial_write(node_t *node, const frame_t *frame) {
    uint8_t encoded[FRAME_ENCODED_MAX];
    const size_t count = frame_encode(frame, encoded);
    const bool written = hal_serial_write(node->hal, encoded, count);
    node->serial_written += written ? (uint32_t)count : 0u;
    return written;
}

int32_t node_clamp(int32_t value, int32_t limit) {
    return value > limit ? limit : value < -limit ? -limit : value;
}

/* Both are inline for the idle turn of the main loop. */
static inline void drain_serial(node_t *node) {
    const frame_t *frame;
    while ((frame = queue_front(&node->serial)) != NULL && node_serial_write(node, frame)) {
        queue_drop(&node->serial);
    }
}

static inline void drain_can(node_t *node, uint64_t now_us) {
    const frame_t *frame;
    bool taken = true;
    while (taken && (frame = queue_front(&node->can)) != NULL) {
        hal_frame_t out = {.id = frame->id, .length = frame->length};
        memcpy(out.data, frame->data, sizeof out.data);
        taken = hal_can_send(node->hal, &out);
        if (taken) {
            queue_drop(&node->can);
            node->can_us = now_us;
            node->can_dead = false;
        }
    }
    if (taken) {
        node->can_us = now_us;
    } else if (now_us - node->can_us > NODE_CAN_GIVE_UP_US) {
        node->can_dead = true;
        while (queue_front(&node->can)) {
            queue_drop(&node->can);
            node->can_lost = add_saturated(node->can_lost, node->can_heard_us > node->can_us);
        }
    }
}

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
    counters[COUNTER_MESSAGES_LOST] = add_saturated(add_saturated(node->serial.lost, node->can.lost),
                                                    add_saturated(node->can_lost, node->stream_lost));
}

static uint8_t pack_heartbeat(const node_t *node, uint8_t data[8]) {
    uint32_t errors = 0;
    for (unsigned i = 0; i < COUNTERS_COUNT; i++) {
        errors = add_saturated(errors, node->counters[i]);
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

static void answer_parameter(node_t *node, node_links_t link, uint32_t index, parameter_status_t status) {
    parameter_value_t value;
    (void)parameters_get(&node->parameters, index, &value);
    struct goldfield_param_value_t answer = {
        .kind = value.kind, .status = (uint8_t)status, .value_unsigned = value.bits};
    /* The packer takes the member that belongs to the kind. */
    memcpy(&answer.value_signed, &value.bits, sizeof value.bits);
    memcpy(&answer.value_float, &value.bits, sizeof value.bits);
    uint8_t data[8];
    const uint8_t length = (uint8_t)goldfield_param_value_pack(data, &answer, sizeof data);
    node_send(node, link, GOLDFIELD_PARAM_VALUE_FRAME_ID, index, data, length);
}

static void set_parameter(node_t *node, node_links_t link, uint32_t index, const frame_t *frame) {
    struct goldfield_param_set_t set = {0};
    (void)goldfield_param_set_unpack(&set, frame->data, frame->length); /* receive() has seen to the length. */
    parameter_value_t value = {.kind = set.kind, .bits = set.value_unsigned};
    if (set.kind == PARAMETER_SIGNED) {
        memcpy(&value.bits, &set.value_signed, sizeof value.bits);
    } else if (set.kind == PARAMETER_FLOAT) {
        memcpy(&value.bits, &set.value_float, sizeof value.bits);
    }
    const parameter_status_t status = parameters_set(&node->parameters, index, value);
    answer_parameter(node, link, index, status);
    if (status == PARAMETER_OK) {
        node->parameters_changed = true;
        node->id = (uint16_t)parameters_unsigned(&node->parameters, PARAMETER_NODE);
    }
}

/* Returns seven characters of a text as a message, zeros behind its end; the first character is the lowest byte. */
static struct goldfield_param_text_t text_part(const char *text, uint32_t length, uint32_t part) {
    const uint32_t begin = part * TEXT_CHARACTERS, left = length - begin;
    uint8_t characters[8] = {0};
    memcpy(characters, text + begin, left < TEXT_CHARACTERS ? left : TEXT_CHARACTERS);
    struct goldfield_param_text_t message = {.part = (uint8_t)part, .last = left <= TEXT_CHARACTERS};
    memcpy(&message.characters_0_to_3, characters, sizeof message.characters_0_to_3);
    memcpy(&message.characters_4_to_6, characters + 4, 4);
    return message;
}

static void describe_parameter(node_t *node, node_links_t link, uint32_t index) {
    uint8_t data[8];
    const parameter_entry_t *entry = parameters_next(index, node->role);
    if (entry == NULL) {
        const struct goldfield_param_description_t none = {.kind = GOLDFIELD_PARAM_DESCRIPTION_KIND_NONE_CHOICE};
        (void)goldfield_param_description_pack(data, &none, sizeof data);
        node_send(node, link, GOLDFIELD_PARAM_DESCRIPTION_FRAME_ID, index, data, sizeof data);
        return;
    }
    const struct goldfield_param_description_t description = {
        .kind = entry->kind,
        .at_start = entry->at_start,
        .stride = entry->stride,
        .elements = entry->elements,
        .rows = entry->rows,
        .excluded = entry->excluded,
        .value_default = entry->initial,
    };
    (void)goldfield_param_description_pack(data, &description, sizeof data);
    node_send(node, link, GOLDFIELD_PARAM_DESCRIPTION_FRAME_ID, entry->first_id, data, sizeof data);
    const struct goldfield_param_range_t range = {.minimum = entry->minimum, .maximum = entry->maximum};
    (void)goldfield_param_range_pack(data, &range, sizeof data);
    node_send(node, link, GOLDFIELD_PARAM_RANGE_FRAME_ID, entry->first_id, data, sizeof data);
    const uint32_t length = (uint32_t)strlen(entry->text);
    for (uint32_t part = 0; part * TEXT_CHARACTERS < length; part++) {
        const struct goldfield_param_text_t text = text_part(entry->text, length, part);
        (void)goldfield_param_text_pack(data, &text, sizeof data);
        node_send(node, link, GOLDFIELD_PARAM_TEXT_FRAME_ID, entry->first_id, data, sizeof data);
    }
}

/* Returns a half of the unique id, the first byte lowest. */
static uint64_t identity_half(const node_t *node, uint32_t which) {
    uint8_t unique[HAL_UNIQUE_ID_BYTES];
    hal_unique_id(node->hal, unique);
    uint64_t half = 0;
    for (uint32_t i = HALF_BYTES; i-- > 0;) {
        half = half << 8 | unique[which * HALF_BYTES + i];
    }
    return half;
}

static void tell_identity(node_t *node, node_links_t link) {
    const uint64_t halves[2] = {identity_half(node, 0), identity_half(node, 1)};
    for (uint32_t i = 0; i < 2; i++) {
        const struct goldfield_identity_t identity = {.half = halves[i], .tag = (uint16_t)(halves[0] ^ halves[1])};
        uint8_t data[8];
        (void)goldfield_identity_pack(data, &identity, sizeof data);
        node_send(node, link, GOLDFIELD_IDENTITY_FRAME_ID, i, data, sizeof data);
    }
}

static void tell_last_reset(node_t *node, node_links_t links) {
    const hal_reset_t *reset = hal_last_reset(node->hal);
    for (uint32_t item = 0; item < RESET_REPORT_ITEMS; item++) {
        uint8_t data[8];
        const uint8_t length = reset_report_pack(reset, item, data);
        if (length > 0) {
            node_send(node, links, GOLDFIELD_RESET_REPORT_FRAME_ID, item, data, length);
        }
    }
}

static void answer_command(node_t *node, node_links_t link, uint32_t index, uint32_t status) {
    const struct goldfield_command_answer_t answer = {.status = (uint8_t)status};
    uint8_t data[8];
    const uint8_t length = (uint8_t)goldfield_command_answer_pack(data, &answer, sizeof data);
    node_send(node, link, GOLDFIELD_COMMAND_ANSWER_FRAME_ID, index, data, length);
}

static void reset_soon(node_t *node) {
    node->resetting = true;
    node->reset_us = hal_microseconds(node->hal) + RESET_US;
}

/* Begins a save, which is answered at its end, once though it be asked for again meanwhile. */
static void begin_save(node_t *node, node_links_t link, bool named, bool may_pause) {
    if (node->saving != NODE_NO_LINK && named) {
        return;
    }
    if (!named || node->resetting) {
        answer_command(node, link, COMMAND_SAVE, GOLDFIELD_COMMAND_ANSWER_STATUS_REFUSED_CHOICE);
    } else if (node->drive_on && !may_pause) {
        answer_command(node, link, COMMAND_SAVE, GOLDFIELD_COMMAND_ANSWER_STATUS_COIL_ON_CHOICE);
    } else {
        node->drive_hold = true;
        node->saving = link;
        storage_save(&node->storage, &node->parameters, VERSION);
    }
}

/* Goes on with a save. The application has told in this turn whether its drive is on, and it was held before. */
static void step_save(node_t *node) {
    if (node->drive_on) {
        return;
    }
    const storage_result_t result = storage_step(&node->storage);
    if (result == STORAGE_BUSY) {
        return;
    }
    static const uint8_t statuses[] = {
        [STORAGE_KEPT] = GOLDFIELD_COMMAND_ANSWER_STATUS_OK_CHOICE,
        [STORAGE_RESTART] = GOLDFIELD_COMMAND_ANSWER_STATUS_OK_RESTARTS_CHOICE,
        [STORAGE_FAILED] = GOLDFIELD_COMMAND_ANSWER_STATUS_FLASH_FAILED_CHOICE,
        [STORAGE_STRANDED] = GOLDFIELD_COMMAND_ANSWER_STATUS_FLASH_FAILED_CHOICE,
    };
    answer_command(node, node->saving, COMMAND_SAVE, statuses[result]);
    node->saving = NODE_NO_LINK;
    if (result == STORAGE_RESTART || result == STORAGE_STRANDED) {
        reset_soon(node); /* The drive is held until then. */
    } else {
        node->drive_hold = false;
    }
}

static void take_command(node_t *node, node_links_t link, uint32_t index, const frame_t *frame) {
    struct goldfield_command_t command = {0};
    const uint64_t own = identity_half(node, 0) ^ identity_half(node, 1);
    (void)goldfield_command_unpack(&command, frame->data, frame->length); /* receive() has seen to the length. */
    if (command.board != 0 && command.board != own) {
        return;
    }
    if (index == COMMAND_IDENTITY) {
        tell_identity(node, link);
        return;
    }
    if (index == COMMAND_LAST_RESET) {
        tell_last_reset(node, link);
        return;
    }
    const bool named = command.board == own && (frame->id & PROTOCOL_NODE_MASK) == node->id;
    if (index == COMMAND_SAVE) {
        begin_save(node, link, named, command.argument != 0);
        return;
    }
    uint32_t status = GOLDFIELD_COMMAND_ANSWER_STATUS_OK_CHOICE;
    if (index == COMMAND_BLINK) {
        node->blinking = true;
        node->blink_end_us = hal_microseconds(node->hal) + (uint64_t)command.argument * MICROSECONDS;
    } else if (index == COMMAND_RESET) {
        if (named) {
            reset_soon(node);
        } else {
            status = GOLDFIELD_COMMAND_ANSWER_STATUS_REFUSED_CHOICE;
        }
    } else if (index == COMMAND_CLEAR) {
        if (named && !node->clear_refused) {
            node->clear_wanted = true;
        } else {
            status = GOLDFIELD_COMMAND_ANSWER_STATUS_REFUSED_CHOICE;
        }
    } else {
        status = GOLDFIELD_COMMAND_ANSWER_STATUS_UNKNOWN_CHOICE;
    }
    answer_command(node, link, index, status);
}

static void receive(node_t *node, node_links_t link, const frame_t *frame) {
    const message_fault_t fault = message_fault(frame->id, frame->length);
    if (fault != MESSAGE_OK) {
        uint32_t *const counter =
            &node->counters[fault == MESSAGE_FOREIGN ? COUNTER_FOREIGN_FRAMES : COUNTER_WRONG_LENGTH];
        *counter = add_saturated(*counter, 1u);
        return;
    }
    const uint32_t message = frame->id & ~((1u << PROTOCOL_TYPE_SHIFT) - 1u);
    const uint32_t index = frame->id >> PROTOCOL_INDEX_SHIFT & 0xFFFu;
    const uint32_t to = frame->id & PROTOCOL_NODE_MASK;
    const bool for_me = to == 0 || to == node->id;
    if (message == GOLDFIELD_SYNC_FRAME_ID) {
        struct goldfield_sync_t sync = {0};
        (void)goldfield_sync_unpack(&sync, frame->data, frame->length);
        node->sync_received = true;
        node->sync_node = to;
        node->sync_cycle = sync.cycle;
        node->sync_chips = sync.chips;
    } else if (message == GOLDFIELD_BLOCK_FRAME_ID || (message == GOLDFIELD_POSE_POSITION_FRAME_ID && index != 0)) {
        if (link == NODE_CAN && to != 0) {
            bus_share_heard(&node->share, to, hal_microseconds(node->hal));
        }
    } else if (message == GOLDFIELD_PARAM_SET_FRAME_ID && for_me) {
        set_parameter(node, link, index, frame);
    } else if (message == GOLDFIELD_PARAM_GET_FRAME_ID && for_me) {
        parameter_value_t value;
        answer_parameter(node, link, index, parameters_get(&node->parameters, index, &value));
    } else if (message == GOLDFIELD_PARAM_DESCRIBE_FRAME_ID && for_me) {
        describe_parameter(node, link, index);
    } else if (message == GOLDFIELD_COMMAND_FRAME_ID && for_me) {
        take_command(node, link, index, frame);
    }
}

static void receive_serial(node_t *node) {
    uint8_t bytes[64];
    size_t count = sizeof bytes;
    for (uint32_t taken = 0; count == sizeof bytes && taken < NODE_BYTES_A_STEP; taken += (uint32_t)count) {
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
    for (uint32_t taken = 0; taken < NODE_FRAMES_A_STEP && hal_can_receive(node->hal, &in); taken++) {
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

void node_start(node_t *node, hal_t *hal, hal_role_t role) {
    memset(node, 0, sizeof *node);
    node->hal = hal;
    node->role = role;
    frame_decoder_init(&node->decoder);
    (void)queue_init(&node->serial, node->serial_messages, NODE_QUEUE_MESSAGES);
    (void)queue_init(&node->can, node->can_messages, NODE_QUEUE_MESSAGES);

    parameters_init(&node->parameters);
    const parameter_value_t derived = {.kind = PARAMETER_UNSIGNED, .bits = number_from_unique_id(hal)};
    (void)parameters_set(&node->parameters, PARAMETER_NODE, derived); /* What is stored overrules it. */
    uint32_t refused = 0;
    const parameters_page_t page = parameters_load(&node->parameters, hal_parameter_page(hal), HAL_PARAMETER_PAGE_BYTES,
                                                   &refused);
    node->counters[COUNTER_BAD_PARAMETER_PAGE] = refused + (page == PARAMETERS_PAGE_BAD);
    const storage_found_t saved = storage_start(&node->storage, hal, &node->parameters);
    node->counters[COUNTER_TORN_SAVES] = saved.torn;
    node->counters[COUNTER_SAVED_REFUSED] = saved.refused;
    node->id = (uint16_t)parameters_unsigned(&node->parameters, PARAMETER_NODE);

    frame_t hello = {.id = node_identifier(node, GOLDFIELD_HEARTBEAT_FRAME_ID, 0)};
    hello.length = pack_heartbeat(node, hello.data);
    uint8_t encoded[FRAME_ENCODED_MAX];
    const size_t count = frame_encode(&hello, encoded);
    hal_serial_write_polled(hal, encoded, count);
    (void)queue_push(&node->can, &hello);
    tell_last_reset(node, NODE_BOTH);
    node->heartbeat_us = hal_microseconds(hal);
    node->can_us = node->heartbeat_us;
    bus_share_start(&node->share, node->can_us);
    liveness_start(&node->liveness, hal, role);
}

void node_flush(node_t *node) {
    drain_serial(node);
    drain_can(node, hal_microseconds(node->hal));
}

void node_step(node_t *node) {
    if (node->saving != NODE_NO_LINK) {
        step_save(node);
    }
    receive_serial(node);
    receive_can(node);
    const uint64_t now_us = hal_microseconds(node->hal);
    if (now_us - node->heartbeat_us >= NODE_HEARTBEAT_US) {
        node->heartbeat_us += NODE_HEARTBEAT_US;
        send_heartbeat(node);
    }
    drain_serial(node);
    drain_can(node, now_us);
    if (liveness_due(&node->liveness, now_us)) {
        watch_serial(node);
        liveness_step(&node->liveness, now_us);
    }
    if (node->blinking) {
        node->blinking = now_us < node->blink_end_us;
        hal_led(node->hal, !node->blinking || now_us / BLINK_US % 2u == 0u);
    }
    if (node->resetting && now_us >= node->reset_us) {
        hal_reset(node->hal);
    }
}
