/* can_bus.h: a CAN 2.0 bus: frame lengths with bit stuffing, arbitration by identifier, interframe space,
 * acknowledgement.
 *
 * can_bus_create(), can_bus_join() for each node, then again and again: can_bus_request() and can_bus_abort() as the
 * nodes ask, and can_bus_run() up to a time before which nobody will ask any more.
 *
 * Time is picoseconds of virtual time. The bus decides up to a time (can_bus_run): everything requested before must be
 * known by then. A frame starts when the bus is idle (three bits after the frame before), among all requests made by
 * that moment the identifier that wins the bits' arbitration. It ends with the last bit of its end-of-frame field. That
 * is when the sender knows that it is through (end_ps); a receiver takes it one bit earlier, after the last but one bit
 * of end of frame (valid_ps). Whoever stamps frames on both sides sees this bit as an offset. With nobody else on the
 * bus it fails: after the acknowledgement slot come an error flag (6 bits) and its delimiter (8 bits); the sender is
 * told and decides itself whether to try again.
 *
 * Source: ISO 11898-1:2015, 10.4 (frames), 10.5 (stuffing), 10.6 (errors); frame validation. Bit errors come at a
 * seeded rate (can_bus_errors) or to chosen frames (can_bus_corrupt): all nodes see one, an error flag of 6 bits and a
 * delimiter of 8 follow it. They strike from a frame's 50th bit on, so that nobody hears of one before a shortest frame
 * would have ended. can_bus_delay() lets receivers hear later than the sender: transceivers and cable, .1 to .25 us
 * on a short bus. Left out: the sample point (the same for all nodes of one bit timing),
 * error-passive nodes' suspended transmission, differences of the nodes' bit clocks. Two nodes that send the same
 * identifier at once (forbidden by 10.4.2.2) are counted; the lower node goes first, of one node the lower mailbox, as
 * bxCAN's scheduler has it (RM0090 32.7.1).
 *
 * Time of a call: in proportion to the pending requests. Memory grows with them.
 */
#ifndef GOLDFIELD_CAN_BUS_H
#define GOLDFIELD_CAN_BUS_H

#include <stdbool.h>
#include <stdint.h>

#include "boards/board_edge.h"

/* A frame of 29-bit identifier without data has 64 bits and not fewer, its interframe space not counted; one of
 * 11-bit identifier 44. */
#define CAN_SHORTEST_EXTENDED_BITS 64

typedef struct can_bus can_bus_t;

typedef struct {
    unsigned node; /* The sender. */
    unsigned mailbox;
    board_frame_t frame;
    int64_t start_ps;
    int64_t valid_ps; /* Receivers have the frame. */
    int64_t end_ps;   /* The sender is through. */
    bool acknowledged;
    bool destroyed; /* By a bit error; end_ps is that of the error flag's delimiter. */
} can_transfer_t;

/* Called for each transfer, in order of time, from inside can_bus_run(). */
typedef void (*can_deliver_t)(void *context, const can_transfer_t *transfer);

typedef struct {
    uint64_t frames;         /* Transfers, failed ones included. */
    uint64_t unacknowledged; /* Transfers that failed for want of a listener. */
    uint64_t errors;         /* Transfers that a bit error destroyed. */
    uint64_t collisions;     /* Two nodes sent the same identifier. */
    int64_t busy_ps;         /* Sum of frames and interframe spaces. */
} can_statistics_t;

/* A bus of nodes 0 .. nodes - 1, of which none is there yet. Returns NULL if there is no memory. */
can_bus_t *can_bus_create(unsigned nodes, uint32_t bits_per_second);
/* The bits of frames that start from now on have this rate. */
void can_bus_rate(can_bus_t *bus, uint32_t bits_per_second);
/* bus may be NULL. */
void can_bus_destroy(can_bus_t *bus);

/* The node listens and acknowledges from a time on; before, it is not there. */
void can_bus_join(can_bus_t *bus, unsigned node, int64_t time_ps);

/* The node asks to send a frame from a mailbox, from a time on. */
void can_bus_request(can_bus_t *bus, unsigned node, unsigned mailbox, const board_frame_t *frame, int64_t time_ps);

/* Withdraw the latest request of a mailbox, unless its frame has started by then. */
void can_bus_abort(can_bus_t *bus, unsigned node, unsigned mailbox, int64_t time_ps);

/* Each bit is wrong with this probability from now on; the seed decides which. 0: none is. */
void can_bus_errors(can_bus_t *bus, double probability, uint64_t seed);

/* Destroy the next frames, so many. */
void can_bus_corrupt(can_bus_t *bus, unsigned frames);

/* Receivers have a frame so many picoseconds later than without transceivers and cable. */
void can_bus_delay(can_bus_t *bus, int64_t delay_ps);

/* Returns a time before which nobody hears of a transfer that has not been delivered yet, if nobody asks before
 * asks_ps; INT64_MIN if a short frame with 11-bit identifier waits. */
int64_t can_bus_heard(const can_bus_t *bus, int64_t asks_ps);

/* Start every frame that starts before until_ps, and deliver it (its end may lie later). */
void can_bus_run(can_bus_t *bus, int64_t until_ps, can_deliver_t deliver, void *context);

void can_bus_statistics(const can_bus_t *bus, can_statistics_t *statistics);

/* Returns the bits from start of frame to the last bit of end of frame, stuff bits included, of an acknowledged frame.
 */
unsigned can_frame_bits(const board_frame_t *frame);

/* Returns the bits of the arbitration field in the order of the wire: the smaller wins. */
uint32_t can_arbitration_key(const board_frame_t *frame);

#endif
