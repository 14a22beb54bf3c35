/* node.h: what all applications have in common: who they are, what they say once a second, their parameters, their two
 * links.
 *
 * Links. Serial and CAN carry the same messages (protocol/framing.md). node_send() puts a message into the queue of
 * each link it is for; node_step() hands the queues to the board. A full queue refuses the message and counts it
 * (COUNTER_MESSAGES_LOST); one link never holds up the other.
 *   latency on serial: at most 128 queued messages of 16 bytes behind 4 kB of buffer at 2 Mbaud: 31 ms;
 *   on CAN: at most 128 messages of 160 us, 21 ms, plus the frames of other nodes with lower identifiers. What no
 *     mailbox has taken for 100 ms, because the bus is dead or not there, is thrown away: not counted as lost, for the
 *     dead bus itself is counted (COUNTER_CAN_ERRORS). From then on one message at a time tries it.
 *
 * Identity. The node parameter of the parameter page; if the page has none, 1 + CRC-16/CCITT-FALSE(unique id, 12 bytes)
 * mod 4095: the same after each reset, and with 8 unconfigured boards two are equal in 0.7 % of cases (the host sees
 * two boards of one number by their interleaved heartbeats).
 *
 * Received messages, from either link: PARAM_SET and PARAM_GET to this node or to node 0 are answered by PARAM_VALUE on
 * the link they came from; a new node number acts after its answer. PARAM_DESCRIBE is answered by the description of a
 * parameter that this role uses, at most 8 messages (framing.md, "Descriptions"). SYNC is kept for the application. All
 * others are ignored, and so are PARAM_SET and SYNC of a wrong length.
 *
 * Contexts: main only. Time: node_step with nothing to do about 150 instructions, bounded by NODE_BYTES_A_STEP received
 * bytes, NODE_FRAMES_A_STEP frames, and the queues' contents. Memory: about 4.7 kB.
 */
#ifndef GOLDFIELD_NODE_H
#define GOLDFIELD_NODE_H

#include "core/link/frame.h"
#include "core/link/parameters.h"
#include "core/link/queue.h"
#include "counter_ids.h"
#include "hal/hal.h"

#define NODE_QUEUE_MESSAGES 128u
#define NODE_HEARTBEAT_US   1000000u
#define NODE_CAN_GIVE_UP_US 100000u
#define NODE_BYTES_A_STEP   1024u
#define NODE_FRAMES_A_STEP  64u

/* As in HEARTBEAT. */
typedef enum {
    NODE_STARTING = 0,
    NODE_SYNCING = 1,
    NODE_SOFT_START = 2,
    NODE_RUNNING = 3,
    NODE_FAULT = 4,
    NODE_CLOCK_FALLBACK = 5
} node_state_t;

typedef enum { NODE_NO_LINK = 0, NODE_SERIAL = 1, NODE_CAN = 2, NODE_BOTH = 3 } node_links_t;

typedef struct {
    hal_t *hal;
    hal_role_t role;
    uint16_t id;
    parameters_t parameters;
    /* Between node and application. */
    node_state_t state;                /* Application writes. */
    uint32_t counters[COUNTERS_COUNT]; /* By COUNTER_...; application writes those from COUNTER_SYNC_REJECTED on. */
    uint32_t stream_lost; /* Messages the application lost on its own way to node_serial_write(); application writes. */
    bool parameters_changed; /* A PARAM_SET was accepted; the application clears it. */
    bool sync_received;      /* A SYNC with sync_cycle (20 bits) and sync_chips came; the application clears it. */
    uint32_t sync_cycle, sync_chips;
    /* Private. */
    frame_decoder_t decoder;
    queue_t serial, can;
    frame_t serial_messages[NODE_QUEUE_MESSAGES], can_messages[NODE_QUEUE_MESSAGES];
    uint64_t heartbeat_us; /* Of the latest heartbeat. */
    uint64_t can_us;       /* CAN last took a message, or had none to take. */
    bool can_dead;         /* It did not for too long: one message at a time is queued to try it. */
} node_t;

/* Load parameters and say hello: a heartbeat on serial by polling before anything else is touched, so that even a
 * crippled machine is heard; the same into the queue of CAN. state is NODE_STARTING. */
void node_start(node_t *node, hal_t *hal, hal_role_t role);

/* One turn of the main loop: watchdog, received messages, heartbeat and counters if due, queues to the board. */
void node_step(node_t *node);

/* Queue a message of this node. message: its *_FRAME_ID of build/protocol/goldfield.h; index < 4096; at most 8 bytes
 * of data. */
void node_send(node_t *node, node_links_t links, uint32_t message, uint32_t index, const uint8_t *data, uint8_t length);

/* The links that have room for so many more messages; a dead CAN bus does not count as full. */
node_links_t node_room(const node_t *node, uint32_t messages);

/* The identifier that node_send() gives. */
uint32_t node_identifier(const node_t *node, uint32_t message, uint32_t index);

/* Past the queue: hand a whole frame to the serial port. False if it does not fit now. About 600 instructions. */
bool node_serial_write(node_t *node, const frame_t *frame);

/* An integer limited to +-limit. */
int32_t node_clamp(int32_t value, int32_t limit);

#endif
