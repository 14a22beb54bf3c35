#include "core/boot/image.h"

#include <stddef.h>

#include "core/storage/crc32.h"
#include "third_party/monocypher/monocypher-ed25519.h"

#define WORD_BYTES   4u
#define HEADER_BYTES ((size_t)(IMAGE_CODE - IMAGE_HEADER) * WORD_BYTES)
#define LEAST_BYTES  (2u * WORD_BYTES) /* A stack pointer and an entry. */

_Static_assert(sizeof(image_header_t) == HEADER_BYTES, "the header is what lies in front of the code");

/* An image as it was found: its length is read once, and stays as it was then. A word that a loss of power has left
 * half programmed may read otherwise each time. */
typedef struct {
    const image_header_t *header; /* NULL: there is none. */
    size_t message_bytes;         /* Bytes of header and code. */
} found_t;

static found_t find_image(const image_flash_t *flash, uint32_t slot) {
    const found_t none = {NULL, 0};
    if (flash->words <= IMAGE_CODE) {
        return none;
    }
    const image_header_t *const header = (const image_header_t *)(const void *)(flash->slot[slot] + IMAGE_HEADER);
    const uint32_t bytes = header->bytes;
    if (header->magic != IMAGE_MAGIC || bytes < LEAST_BYTES || bytes % WORD_BYTES != 0u ||
        bytes > (flash->words - IMAGE_CODE) * WORD_BYTES) {
        return none;
    }
    return (found_t){header, HEADER_BYTES + bytes};
}

const image_header_t *image_header(const image_flash_t *flash, uint32_t slot) {
    return find_image(flash, slot).header;
}

static bool crc_fits(const image_flash_t *flash, uint32_t slot, const found_t *found) {
    return crc32(0, found->header, found->message_bytes) == flash->slot[slot][IMAGE_CRC];
}

bool image_intact(const image_flash_t *flash, uint32_t slot) {
    const found_t found = find_image(flash, slot);
    return found.header != NULL && found.header->board == flash->board &&
           found.header->address == flash->address[slot] && crc_fits(flash, slot, &found);
}

image_status_t image_check(const image_flash_t *flash, uint32_t slot, const image_demand_t *demand) {
    const found_t found = find_image(flash, slot);
    const image_header_t *const header = found.header;
    if (header == NULL) {
        return IMAGE_NONE;
    }
    if (!crc_fits(flash, slot, &found)) {
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
    return crypto_ed25519_check(signature, flash->key, message, found.message_bytes) == 0 ? IMAGE_OK : IMAGE_UNSIGNED;
}
