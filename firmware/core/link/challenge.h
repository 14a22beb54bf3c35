/* challenge.h: the answer that shows that somebody knows a board's key (framing.md, "Access"): the first eight bytes of
 *   HMAC-SHA-512(key, "goldfield access 1" | unique id, 12 bytes | number, 8 bytes, the lowest first)
 *
 * Contexts: main. Memory: 0.7 kB of stack. Time: four blocks of SHA-512.
 */
#ifndef GOLDFIELD_CHALLENGE_H
#define GOLDFIELD_CHALLENGE_H

#include <stdint.h>

#define CHALLENGE_KEY_BYTES 16u
#define CHALLENGE_ID_BYTES  12u

/* Returns the answer of the board with this unique id to a number, its first byte lowest. What it has made of the key
 * is cleared from the stack. */
uint64_t challenge_answer(const uint8_t key[CHALLENGE_KEY_BYTES], const uint8_t unique_id[CHALLENGE_ID_BYTES],
                          uint64_t number);

#endif
