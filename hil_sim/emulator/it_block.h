/* it_block.h: where in an IT block an address lies.
 *
 * Unicorn does not keep ITSTATE while it runs a block of code, but an interrupt or a stop in the middle of an IT block
 * needs it. It is found again by walking over the instructions from a place where it is known. ITSTATE as in the
 * ARMv7-M manual, A7.3.2; 0 outside of a block.
 */
#ifndef GOLDFIELD_IT_BLOCK_H
#define GOLDFIELD_IT_BLOCK_H

#include <stdbool.h>
#include <stdint.h>

/* Whether a first halfword is that of an IT instruction. */
static inline bool it_block_opens(uint16_t opcode) {
    return (opcode & 0xFF00u) == 0xBF00u && (opcode & 0xFu) != 0;
}

/* Bytes of the instruction that begins with a halfword. */
static inline unsigned thumb_size(uint16_t opcode) {
    return opcode >> 11 >= 0x1Du ? 4 : 2;
}

/* ITSTATE of the next instruction. */
static inline uint8_t it_block_advance(uint8_t state) {
    return (state & 7u) == 0 ? 0 : (uint8_t)((state & 0xE0u) | ((unsigned)state << 1 & 0x1Fu));
}

/* ITSTATE's two places in xPSR. */
static inline uint32_t it_block_to_xpsr(uint8_t state) {
    return (uint32_t)(state >> 2) << 10 | (uint32_t)(state & 3u) << 25;
}

static inline uint8_t it_block_from_xpsr(uint32_t xpsr) {
    return (uint8_t)((xpsr >> 10 & 0x3Fu) << 2 | (xpsr >> 25 & 3u));
}

/* Where these are, and the bit beside them that a processor without ARM code always has. */
#define IT_BLOCK_XPSR 0x0600FC00u
#define XPSR_THUMB    (1u << 24)

#endif
