/* node.h: what every board has, whatever its application: a number, parameters, counters, and two links on which it
 * speaks, serial and CAN. Here are these, and what sends; requests.h answers what a host asks, and upkeep.h carries all
 * of it out.
 *
 * Calls, in the order they are made (all of them from main)
 *   1. node_init          once (upkeep_start), and node_links_start when the parameters are there.
 *   2. node_send          whenever a message is to leave; node_room tells first whether several fit together, and
 *                         node_motion_room whether those do that other boards on the bus send as well.
 *      node_flush         when what was queued cannot wait for the turn's end, at which it is node_drain (upkeep_step).
 *      node_serial_write  for a stream that goes past the queue; node_identifier tells its identifiers.
 *
 * Links. Serial and CAN carry the same messages (protocol/framing.md). node_send() puts a message into the queue of
 * each link it is for; node_drain() hands the queues to the board. A full queue refuses the message and counts it
 * (COUNTER_MESSAGES_LOST); one link never holds up the other.
 *   latency on serial: at most 128 queued messages of 16 bytes behind 20 ms of the board's buffer: 31 ms at 2 Mbaud,
 *     42, 65 and 200 ms at the lower rates;
 *   on CAN: at most 128 messages of 160 bits, 21 ms at 1 Mbit/s and 164 ms at 125 kbit/s, plus the frames of other
 *     nodes with lower identifiers. What no mailbox has taken for 100,000 bits is thrown away. It is counted as lost if
 *     others were heard meanwhile: the bus is then full. If it is dead or not there, that itself is counted
 *     (COUNTER_CAN_ERRORS). From then on one message at a time tries it.
 *
 * Rates. The parameters can_rate and serial_rate choose them, at the start; slow tells what waits on that account.
 *
 * Motion. Boards that send blocks or poses of blocks divide CAN among themselves (bus_share.h); they know of each other
 * by these messages. What is beyond the board's own part does not go on CAN, and neither does what would wait behind
 * NODE_CAN_BACKLOG others: reports of cycles go in any case, and soon.
 *
 * Time: node_drain with nothing to send takes about 20 instructions, and is bounded by what the queues hold. Memory:
 * 12 kB.
 */
#ifndef GOLDFIELD_NODE_H
#define GOLDFIELD_NODE_H

#include "core/link/bus_share.h"
#include "core/link/frame.h"
#include "core/link/parameters.h"
#include "core/link/queue.h"
#include "counter_ids.h"
#include "hal/hal.h"
#include "services/access.h"
#include "services/liveness.h"
#include "services/storage.h"
#include "services/update.h"

#define NODE_QUEUE_MESSAGES   128u     /* Messages that the queue of each link holds. */
#define NODE_HEARTBEAT_US     1000000u /* Time from one heartbeat to the next, us. */
#define NODE_HEARTBEAT_PLACES 99u      /* Places of a second in which a board's may be (spread.h). */
/* Time without a message taken after which CAN counts as dead, at 1 Mbit/s, us. */
#define NODE_CAN_GIVE_UP_US 100000u
#define NODE_CAN_BACKLOG    32u /* Most messages that may wait for CAN where one of the motion is added. */

/* What a board is doing; the numbers are those of HEARTBEAT.state. */
typedef enum {
    NODE_STARTING = 0,
    NODE_SYNCING = 1,
    NODE_SOFT_START = 2,
    NODE_RUNNING = 3,
    NODE_FAULT = 4,
    NODE_CLOCK_FALLBACK = 5
} node_state_t;

/* A set of links, a bit each. */
typedef enum { NODE_NO_LINK = 0, NODE_SERIAL = 1, NODE_CAN = 2, NODE_BOTH = 3 } node_links_t;

typedef struct {
    hal_t *hal;
    hal_role_t role;
    uint16_t id; /* The board's number, 1 to 4095. */
    parameters_t parameters;
    /* Between node and application. */
    node_state_t state;                /* The application writes it. */
    uint32_t counters[COUNTERS_COUNT]; /* Indexed by COUNTER_...; the application writes those from
                                        * COUNTER_SYNC_REJECTED on. */
    uint32_t stream_lost;              /* Messages that the application lost on its way to node_serial_write(); it
                                        * writes this. */
    bool parameters_changed;           /* A PARAM_SET was accepted; the application clears it. */
    bool clear_refused;                /* A COMMAND to clear would be in vain now; the application writes it. */
    bool drive_on;                     /* The coil is driven, or about to be; the application writes it each turn. */
    volatile bool drive_hold;          /* The application must keep its drive off. */
    volatile bool signing;             /* The application halves its current in every other cycle. */
    bool clear_wanted;                 /* A COMMAND to clear was accepted; the application clears it. */
    bool sync_received;                /* A SYNC came; the application clears it. */
    liveness_t liveness;               /* The application tells it what moves. */
    uint32_t sync_node;                /* The node that sent this SYNC. */
    uint32_t sync_cycle, sync_chips;   /* The cycle (20 bits) and the chips in a cycle that this SYNC told, */
    uint32_t sync_rank;                /* and the rank. */
    bool others_in_step;               /* A DRIVE_STATUS of another node told that it is; the application clears it. */
    /* Private. */
    frame_decoder_t decoder;
    queue_t serial, can;
    frame_t serial_messages[NODE_QUEUE_MESSAGES], can_messages[NODE_QUEUE_MESSAGES];
    uint32_t serial_written,
        serial_sent;       /* Bytes given to the serial port, and sent by it when it was last looked at. */
    uint64_t heartbeat_us; /* Time of the latest heartbeat (upkeep.h). */
    uint64_t can_us;       /* Latest time at which CAN took a message, or had none to take. */
    uint64_t can_heard_us; /* Latest time at which CAN brought a frame. */
    uint32_t can_slow;     /* How many times slower CAN is than 1 Mbit/s. */
    uint32_t slow;         /* The same of the slower link; a serial port counts from about 1 Mbaud on. */
    bus_share_t share;     /* The board's part of CAN. */
    uint32_t can_lost;     /* Messages thrown away because the bus was full. */
    bool can_dead;         /* CAN took none for too long: one message at a time is queued to try it. */
    /* Private to requests.h. */
    bool under_way; /* One of these is to be gone on with. */
    bool blinking;  /* The LED blinks, until blink_end_us; a signature (signing) ends then, too. */
    bool resetting; /* A reset was accepted, and comes at reset_us. */
    uint64_t blink_end_us, reset_us;
    node_links_t identity_late, reset_late; /* The links on which these are told at late_us. */
    uint64_t late_us;
    node_links_t saving;   /* The link to which a save that is under way is answered. */
    node_links_t updating; /* The link to which the command that began an update is answered. */
    uint32_t update_index; /* That command. */
    access_t access;
    update_t update;
    storage_t storage; /* It is large, and last: what main looks at each turn lies near the beginning. */
} node_t;

/* Make the node one that nobody has spoken to, with empty queues; its parameters and its number are not there yet. *hal
 * must live for ever. */
void node_init(node_t *node, hal_t *hal, hal_role_t role);

/* Start the links at the rates that the parameters choose. */
void node_links_start(node_t *node);

/* Queue a message of this node on the given links. message is its *_FRAME_ID of build/protocol/goldfield.h, index is
 * below 4096, data has at most 8 bytes. A message that finds a queue full is lost there, and counted. */
void node_send(node_t *node, node_links_t links, uint32_t message, uint32_t index, const uint8_t *data, uint8_t length);

/* Hand the queues to the board, as far as it takes them, at a time that hal_microseconds has just told. */
void node_drain(node_t *node, uint64_t now_us);

/* Do so at once, when what was queued cannot wait for the turn's end. */
void node_flush(node_t *node);

/* Returns the links that have room for so many more messages; a dead CAN bus does not count as full. */
node_links_t node_room(const node_t *node, uint32_t messages);

/* Returns those of some links on which messages go that tell of the board's motion, so many, and that still have room
 * for the others behind them. On CAN they are then paid for (bus_share.h), and must be sent. */
node_links_t node_motion_room(node_t *node, node_links_t links, uint32_t messages, uint32_t others);

/* Pay for messages of the board's cycles, so many, that go on CAN. */
void node_spend(node_t *node, node_links_t links, uint32_t messages);

/* Returns the identifier that node_send() gives to a message. */
uint32_t node_identifier(const node_t *node, uint32_t message, uint32_t index);

/* Hand a whole frame to the serial port, past the queue. It takes about 600 instructions.
 * Returns false if it does not fit now: nothing was sent. */
bool node_serial_write(node_t *node, const frame_t *frame);

/* Returns the number by which access.h knows a link. */
static inline uint32_t node_link_index(node_links_t link) {
    return link == NODE_CAN;
}

/* Returns the value, limited to -limit and +limit: for a signal of a message that is clamped. */
int32_t node_clamp(int32_t value, int32_t limit);

/* Returns what a counter counts when it goes on by so much: it stops at the largest number. */
uint32_t node_count(uint32_t counted, uint32_t more);

#endif
