/* bus_share.h: what a board may send of its motion on a bus on which other boards tell of theirs.
 *
 * Blocks and their poses come 330 times a second, and a bus that is full carries the lowest identifiers only: the board
 * with the highest number would send nothing any more, its cycles included. So all boards that send them divide
 * BUS_SHARE_PERCENT of the bus evenly: each hears who else does, and keeps to its own part by leaving some out.
 *
 * Calls, all from main
 *   1. bus_share_start  once, with the bus's bit rate.
 *   2. bus_share_heard  for each message of another board that tells of its motion.
 *   3. bus_share_take   before messages that may be left out: they go if it says so.
 *      bus_share_spend  for messages that go in any case, out of the same part.
 *
 * The part is kept as a credit of bus time, which grows with the time and is spent at BUS_SHARE_MESSAGE_BITS a message,
 * the longest that there is: so each second, third or fourth block is left out, or whatever it takes, evenly. The
 * credit is at most BUS_SHARE_CREDIT_BITS, which is the most that goes at once behind a silence, and the same below
 * zero.
 *
 * Time: a pass over the others and one division a call. Memory: 256 bytes.
 */
#ifndef GOLDFIELD_BUS_SHARE_H
#define GOLDFIELD_BUS_SHARE_H

#include <stdbool.h>
#include <stdint.h>

#define BUS_SHARE_OTHERS       15     /* Most other boards that are told apart; more count as so many. */
#define BUS_SHARE_PERCENT      75     /* Part of the bus for all: beacons, answers, repeated frames need the rest. */
#define BUS_SHARE_MESSAGE_BITS 160    /* Longest frame of 8 bytes, with the pause behind it. */
#define BUS_SHARE_CREDIT_BITS  10000  /* Largest credit: 62 messages, the longest block that fits into a queue. */
#define BUS_SHARE_FORGET_US    500000 /* Silence after which another board no longer counts. */

/* Fields are private. */
typedef struct {
    int64_t bit_ns;     /* Length of a bit. */
    int64_t credit_ns;  /* Bus time that may be spent. */
    uint64_t filled_us; /* Time of the latest growth. */
    struct {
        uint32_t node; /* 0: nobody. */
        uint64_t heard_us;
    } others[BUS_SHARE_OTHERS];
} bus_share_t;

/* Begin without credit, and with nobody else there. bit_s, bits a second, divides 10^9. */
void bus_share_start(bus_share_t *share, uint32_t bit_s, uint64_t now_us);

/* Note that another board tells of its motion. node is its number, above 0. */
void bus_share_heard(bus_share_t *share, uint32_t node, uint64_t now_us);

/* Returns how many boards divide the bus, this one included. */
uint32_t bus_share_boards(const bus_share_t *share, uint64_t now_us);

/* Returns whether so many messages may go now; they are then paid for. */
bool bus_share_take(bus_share_t *share, uint32_t messages, uint64_t now_us);

/* Pay for messages that go in any case. */
void bus_share_spend(bus_share_t *share, uint32_t messages, uint64_t now_us);

#endif
