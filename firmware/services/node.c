#include "services/node.h"

#include <string.h>

#include "link_rates.h"
#include "protocol_hash.h"

uint32_t node_count(uint32_t counted, uint32_t more) {
    return counted > UINT32_MAX - more ? UINT32_MAX : counted + more;
}

void node_init(node_t *node, hal_t *hal, hal_role_t role) {
    memset(node, 0, sizeof *node);
    node->hal = hal;
    node->role = role;
    frame_decoder_init(&node->decoder);
    (void)queue_init(&node->serial, node->serial_messages, NODE_QUEUE_MESSAGES);
    (void)queue_init(&node->can, node->can_messages, NODE_QUEUE_MESSAGES);
    access_start(&node->access, hal, &node->parameters);
}

void node_links_start(node_t *node) {
    static const uint32_t can_rates[] = CAN_RATES, serial_rates[] = SERIAL_RATES;
    const uint32_t can_bit_s = can_rates[parameters_unsigned(&node->parameters, PARAMETER_CAN_RATE)];
    const uint32_t serial_baud = serial_rates[parameters_unsigned(&node->parameters, PARAMETER_SERIAL_RATE)];
    hal_links_start(node->hal, can_bit_s, serial_baud);
    node->can_slow = can_rates[0] / can_bit_s;
    node->slow = can_rates[0] / (can_bit_s < serial_baud ? can_bit_s : serial_baud);
    node->can_us = hal_microseconds(node->hal);
    bus_share_start(&node->share, can_bit_s, node->can_us);
}

uint32_t node_identifier(const node_t *node, uint32_t message, uint32_t index) {
    return message | index << PROTOCOL_INDEX_SHIFT | node->id;
}

void node_send(node_t *node, node_links_t links, uint32_t message, uint32_t index, const uint8_t *data,
               uint8_t length) {
    frame_t frame = {.id = node_identifier(node, message, index), .length = length};
    memcpy(frame.data, data, length);
    if ((links & NODE_SERIAL) != 0) {
        (void)queue_push(&node->serial, &frame); /* The queue counts what it refuses. */
    }
    if ((links & NODE_CAN) != 0 && (!node->can_dead || queue_count(&node->can) == 0)) {
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
    if ((links & NODE_CAN) != 0) {
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
    } else if (now_us - node->can_us > (uint64_t)NODE_CAN_GIVE_UP_US * node->can_slow) {
        node->can_dead = true;
        while (queue_front(&node->can) != NULL) {
            queue_drop(&node->can);
            node->can_lost = node_count(node->can_lost, node->can_heard_us > node->can_us);
        }
    }
}

void node_drain(node_t *node, uint64_t now_us) {
    drain_serial(node);
    drain_can(node, now_us);
}

void node_flush(node_t *node) {
    node_drain(node, hal_microseconds(node->hal));
}
