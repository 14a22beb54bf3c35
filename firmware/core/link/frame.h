/* frame.h: frames on the serial line (protocol/framing.md). A frame is a message in COBS with a checksum:
 *   COBS( id u32 LE | data, 0 to 8 bytes | CRC-16/CCITT-FALSE u16 LE ) 00
 *
 * Calls, in the order they are made: frame_encode for each message that is sent; frame_decoder_init once, then
 * frame_decode for each byte that is received.
 *
 * CRC: polynomial 0x1021, start 0xFFFF, not reflected, check value 0x29B1 for "123456789". COBS: Cheshire & Baker
 * 1999; a frame is short enough for one block.
 *
 * Security. Every received byte comes from outside: a stranger may send anything, at line rate.
 *   Trusted        Nothing on the line. The CRC protects against accident, not against intent: whoever can write to
 *                  the wire can send any message. A message that may do harm must be bounded where it is used (the
 *                  parameter table's ranges, the over-current limit).
 *   Invariants     pending <= FRAME_ENCODED_MAX - 1 always; bytes beyond that are dropped before they are stored.
 *                  Every length inside a frame is checked against the bytes that came before it is used as an index. A
 *                  frame handed out has length <= 8 and id < 2^29. Whatever came before, the decoder is in step after
 *                  the next 00. There is no allocation, no recursion, no state outside the struct; one byte costs at
 *                  most a bounded number of instructions (below).
 *   Not protected  A flood of garbage costs the time of its bytes, and hides frames that are torn by it; the counters
 *                  show it.
 *
 * Contexts: one decoder belongs to one context. frame_encode and frame_crc have no state.
 */
#ifndef GOLDFIELD_FRAME_H
#define GOLDFIELD_FRAME_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define FRAME_DATA_MAX    8u          /* Most bytes of data, as in a CAN frame. */
#define FRAME_ENCODED_MAX 16u         /* Most bytes on the line: 14, one byte of COBS overhead, the delimiter. */
#define FRAME_ID_MAX      0x1FFFFFFFu /* Largest identifier: 29 bits, as in an extended CAN frame. */

/* A message, with the same members as a CAN frame. */
typedef struct {
    uint32_t id;                  /* Identifier, 29 bits. */
    uint8_t length;               /* Bytes of data, 0..8. */
    uint8_t data[FRAME_DATA_MAX]; /* The data; bytes beyond length mean nothing. */
} frame_t;

/* Costs about 14 instructions a byte. Returns the CRC-16/CCITT-FALSE of count bytes. */
uint16_t frame_crc(const uint8_t *bytes, size_t count);

/* Encode a frame with its delimiter. Costs about 375 instructions.
 * Returns the number of bytes written (8..16), or 0 for more than 8 bytes of data or more than 29 bits of id. */
size_t frame_encode(const frame_t *frame, uint8_t encoded[FRAME_ENCODED_MAX]);

/* The counters are of dropped frames, and stop at their maximum. */
typedef struct {
    uint32_t bad_crc;   /* Frames whose checksum was wrong. */
    uint32_t malformed; /* Frames that were no COBS, too short, or had more than 29 bits of id. */
    uint32_t overlong;  /* Frames that were longer than any frame is. */
    /* Private. */
    uint8_t pending;                       /* Bytes of the frame under way. */
    bool skipping;                         /* The frame under way is too long; it ends at the next delimiter. */
    uint8_t bytes[FRAME_ENCODED_MAX - 1u]; /* The frame under way, still encoded. */
} frame_decoder_t;

/* Forget everything, counters included. A decoder of zero bytes is in the same state. */
void frame_decoder_init(frame_decoder_t *decoder);

/* Take one received byte. Costs about 10 instructions; at a delimiter about 650.
 * Returns true if it ended a good frame, which is then in *frame; otherwise *frame is untouched. */
bool frame_decode(frame_decoder_t *decoder, uint8_t byte, frame_t *frame);

/* Returns the frames dropped for any reason (COUNTER_FRAMES_DROPPED); the sum stops at its maximum. */
uint32_t frame_dropped(const frame_decoder_t *decoder);

#endif
