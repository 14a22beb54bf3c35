/* crc32.h: CRC-32/ISO-HDLC (that of Ethernet, zlib and PNG), for what is kept in flash.
 *
 * Calls: crc32(0, ...) over the first bytes, then crc32(so_far, ...) over those that follow; the pieces may be cut
 * anywhere. The check value over "123456789" is 0xCBF43926.
 *
 * Contexts: any; the function keeps nothing. Time: two look-ups a byte. Memory: a table of 64 bytes in flash.
 */
#ifndef GOLDFIELD_CRC32_H
#define GOLDFIELD_CRC32_H

#include <stddef.h>
#include <stdint.h>

/* Returns the CRC of what so_far is the CRC of, followed by these bytes. */
uint32_t crc32(uint32_t so_far, const void *bytes, size_t count);

#endif
