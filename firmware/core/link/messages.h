/* messages.h: tells which received frames are messages of protocol/goldfield_protocol/goldfield.dbc, on a bus that may
 * be shared with anybody.
 *
 * message_fault is called for each frame that is received; message_index tells which one of its message the frame is.
 * The generated message_table.h is the one home of the messages' lengths and indices; no module compares a length with
 * a number of its own.
 *
 * Security. Whoever can write to the wire can send any message; this check is against accident. The identifiers of
 * other protocols (J1939, CANopen) with 29 bits cover ours: a frame of theirs that has the type of a message by chance
 * mostly has another index or another length. One that has all three is taken for ours.
 *
 * Contexts: any. There is no state.
 */
#ifndef GOLDFIELD_MESSAGES_H
#define GOLDFIELD_MESSAGES_H

#include <stdbool.h>
#include <stdint.h>

/* What the frames of one message have in common. */
typedef struct {
    bool known;             /* There is a message of this type. */
    uint8_t length;         /* Bytes of data. */
    uint16_t largest_index; /* Largest index. */
} message_shape_t;

typedef enum {
    MESSAGE_OK = 0,          /* The frame is a message. */
    MESSAGE_FOREIGN = 1,     /* No message has this type and this index. */
    MESSAGE_WRONG_LENGTH = 2 /* The message has another number of bytes. */
} message_fault_t;

/* Returns the index in a 29-bit identifier, 0 to 4,095: which parameter, beacon or chip its frame is of. */
uint32_t message_index(uint32_t id);

/* Judge a data frame by its 29-bit identifier and its bytes of data. Costs about 15 instructions.
 * Returns MESSAGE_OK or why it is no message. */
message_fault_t message_fault(uint32_t id, uint8_t length);

#endif
