#include "core/boot/image.h"

#include <stddef.h>

#include "core/storage/crc32.h"
#include "third_party/monocypher/monocypher-ed25519.h"

#define WORD_BYTES   4u
#define HEADER_BYTES ((size_t)(IMAGE_CODE - IMAGE_HEADER) * WORD_BYTES)
#define LEAST_BYTES  (2u * WORD_BYTES) /* A stack pointer and an entry. */

_Static_assert(sizeof(image_header_t) == HEADER_BYTES, "the header is what lies in front of the code");

const image_header_t *image_header(const image_flash_t *flash, uint32_t slot) {
    if (flash->words <= IMAGE_CODE) {
        return NULL;
    }
    const image_header_t *const header = (const image_header_t *)(const void *)(flash->slot[slot] + IMAGE_HEADER);
    const uint32_t bytes = header->bytes;
    const bool fits = bytes >= LEAST_BYTES && bytes % WORD_BYTES == 0u &&
                      bytes / WORD_BYTES <= flash->words - IMAGE_CODE;
    return header->magic == IMAGE_MAGIC && fits ? header : NULL;
}

static size_t message_bytes(const image_header_t *header) {
    return HEADER_BYTES + header->bytes;
}

static bool crc_fits(const image_flash_t *flash, uint32_t slot, const image_header_t *header) {
    return crc32(0, header, message_bytes(header)) == flash->slot[slot][IMAGE_CRC];
}

bool image_intact(const image_flash_t *flash, uint32_t slot) {
    const image_header_t *const header = image_header(flash, slot);
    return header != NULL && header->board == flash->board && header->address == flash->address[slot] &&
           crc_fits(flash, slot, header);
}

image_status_t image_check(const image_flash_t *flash, uint32_t slot, const image_demand_t *demand) {
    const image_header_t *const header = image_header(flash, slot);
    if (header == NULL) {
        return IMAGE_NONE;
    }
    if (!crc_fits(flash, slot, header)) {
        return IMAGE_DAMAGED;
    }
    if (header->board != flash->board) {
        return IMAGE_BOARD;
    }
    if (demand->role != IMAGE_ANY_ROLE && header->role != demand->role) {
        return IMAGE_ROLE;
    }
    if (header->address != flash->address[slot]) {
        return IMAGE_PLACE;
    }
    if (header->version < demand->least_version) {
        return IMAGE_OLDER;
    }
    if (flash->key == NULL) {
        return IMAGE_NO_KEY;
    }
    const uint8_t *const signature = (const uint8_t *)(flash->slot[slot] + IMAGE_SIGNATURE);
    const uint8_t *const message = (const uint8_t *)header;
    return crypto_ed25519_check(signature, flash->key, message, message_bytes(header)) == 0 ? IMAGE_OK : IMAGE_UNSIGNED;
}
