/* frame.h: frames on the serial line, COBS( id u32 LE | data, 0 to 8 bytes | CRC-16/CCITT-FALSE u16 LE ) 00
 * (protocol/framing.md).
 *
 * CRC: polynomial 0x1021, start 0xFFFF, not reflected, check value 0x29B1 for "123456789". COBS: Cheshire & Baker 1999;
 * a frame is short enough for one block.
 *
 * Security. Every received byte comes from outside: a stranger may send anything, at line rate.
 *   Trusted: nothing on the line. The CRC protects against accident, not against intent: whoever can write to the wire
 *     can send any message. A message that may do harm must be bounded where it is used (the parameter table's ranges,
 *     the over-current limit).
 *   Invariants: pending <= FRAME_ENCODED_MAX - 1 always; bytes beyond that are dropped before they are stored. Every
 *     length inside a frame is checked against the bytes that came before it is used as an index. A frame handed out
 *     has length <= 8 and id < 2^29. Whatever came before, the decoder is in step after the next 00. No allocation, no
 *     recursion, no state outside the struct; one byte costs at most a bounded number of instructions (below).
 *   Not protected: a flood of garbage costs the time of its bytes, and hides frames that are torn by it; the counters
 *     show it.
 *
 * Contexts: one decoder belongs to one context. frame_encode and frame_crc have no state.
 */
#ifndef GOLDFIELD_FRAME_H
#define GOLDFIELD_FRAME_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define FRAME_DATA_MAX    8u
#define FRAME_ENCODED_MAX 16u /* 14 bytes, one byte of COBS overhead, the delimiter. */
#define FRAME_ID_MAX      0x1FFFFFFFu

/* A message: the same members as a CAN frame. */
typedef struct {
    uint32_t id;    /* 29 bits */
    uint8_t length; /* 0..8 */
    uint8_t data[FRAME_DATA_MAX];
} frame_t;

/* CRC-16/CCITT-FALSE of count bytes. About 14 instructions a byte. */
uint16_t frame_crc(const uint8_t *bytes, size_t count);

/* Encode with its delimiter. Returns the number of bytes written (8..16), or 0 for more than 8 bytes of data or more
 * than 29 bits of id. About 375 instructions. */
size_t frame_encode(const frame_t *frame, uint8_t encoded[FRAME_ENCODED_MAX]);

/* The counters stop at their maximum. */
typedef struct {
    uint32_t bad_crc;   /* Frames dropped: checksum wrong; */
    uint32_t malformed; /* no COBS, too short, or more than 29 bits of id; */
    uint32_t overlong;  /* longer than any frame. */
    uint8_t pending;    /* Private from here. */
    bool skipping;
    uint8_t bytes[FRAME_ENCODED_MAX - 1u];
} frame_decoder_t;

/* Forget everything, counters included. All zero bytes is the same state. */
void frame_decoder_init(frame_decoder_t *decoder);

/* Feed one received byte. True: it ended a good frame, which is in *frame. Otherwise *frame is untouched. About 10
 * instructions; at a delimiter about 650. */
bool frame_decode(frame_decoder_t *decoder, uint8_t byte, frame_t *frame);

/* Frames dropped for any reason (counter 0 of framing.md). Stops at its maximum. */
uint32_t frame_dropped(const frame_decoder_t *decoder);

#endif
