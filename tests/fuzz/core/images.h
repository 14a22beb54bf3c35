/* images.h: signed images for two slots of cells.h, made by Monocypher's other half than the one that the boot loader
 * has. */
#ifndef GOLDFIELD_FUZZ_IMAGES_H
#define GOLDFIELD_FUZZ_IMAGES_H

#include "cells.h"
#include "core/boot/image.h"
#include "core/storage/crc32.h"
#include "third_party/monocypher/monocypher-ed25519.h"

#define SLOT_WORDS 140u /* What the header and the signature take, and some of code. */
#define IMAGES     6u

/* What is made: two good ones, an older one, one of another role, one of another board, one that a stranger signed. */
enum { GOOD_OLD = 0, GOOD_NEW = 1, OLDER = 2, OTHER_ROLE = 3, OTHER_BOARD = 4, STRANGERS = 5 };

typedef struct {
    uint8_t key[32];
    uint32_t words[IMAGES][CELLS_SLOTS][SLOT_WORDS]; /* Each image, linked for each slot; state words are erased. */
} images_t;

static const uint32_t images_address[CELLS_SLOTS] = {0x08020000u, 0x08080000u};

static inline uint32_t images_code_words(uint32_t image) {
    return 3u + image;
}

static inline void images_make(images_t *images, uint32_t image, uint32_t slot, const uint8_t secret[64]) {
    uint32_t *const words = images->words[image][slot];
    const uint32_t code = images_code_words(image);
    memset(words, 0xFF, SLOT_WORDS * sizeof *words);
    const image_header_t header = {
        .magic = IMAGE_MAGIC,
        .bytes = 4u * code,
        .address = images_address[slot],
        .board = image == OTHER_BOARD ? 2u : 1u,
        .role = image == OTHER_ROLE ? 0u : 1u,
        .version = image == OLDER ? 0x0000FFFFu : 0x00010000u + image,
        .protocol = 0x1234u,
    };
    memcpy(words + IMAGE_HEADER, &header, sizeof header);
    for (uint32_t i = 0; i < code; i++) {
        words[IMAGE_CODE + i] = 0x20002000u + 7u * i + image;
    }
    const size_t size = sizeof header + 4u * code;
    words[IMAGE_CRC] = crc32(0, words + IMAGE_HEADER, size);
    crypto_ed25519_sign((uint8_t *)(words + IMAGE_SIGNATURE), secret, (const uint8_t *)(words + IMAGE_HEADER), size);
}

/* Returns the images, which are made at the first call. */
static inline const images_t *images_get(void) {
    static images_t images;
    static bool made;
    for (uint32_t image = 0; !made && image < IMAGES; image++) {
        uint8_t secret[64], seed[32], key[32];
        memset(seed, image == STRANGERS ? 2 : 1, sizeof seed);
        crypto_ed25519_key_pair(secret, key, seed); /* It wipes the seed. */
        if (image != STRANGERS) {
            memcpy(images.key, key, sizeof key);
        }
        images_make(&images, image, 0, secret);
        images_make(&images, image, 1, secret);
    }
    made = true;
    return &images;
}

/* Returns which image that is signed with the node's key lies in a slot, all of it; IMAGES: none. */
static inline uint32_t images_in(const images_t *images, const cells_t *cells, uint32_t slot) {
    for (uint32_t image = 0; image < STRANGERS; image++) {
        const uint32_t *const made = images->words[image][slot], *const there = cells->read[slot];
        const size_t message = 4u * (16u + images_code_words(image));
        if (memcmp(made + IMAGE_SIGNATURE, there + IMAGE_SIGNATURE, 64) == 0 && made[IMAGE_CRC] == there[IMAGE_CRC] &&
            memcmp(made + IMAGE_HEADER, there + IMAGE_HEADER, message) == 0) {
            return image;
        }
    }
    return IMAGES;
}

static inline image_flash_t images_flash(const images_t *images, const cells_t *cells) {
    return (image_flash_t){
        .slot = {cells->read[0], cells->read[1]},
        .address = {images_address[0], images_address[1]},
        .words = SLOT_WORDS,
        .board = 1,
        .key = images->key,
    };
}

#endif
