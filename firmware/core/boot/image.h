/* image.h: what lies in a slot of the flash: one firmware image with its header, its signature, and the words that tell
 * what became of it. The image is checked here; select.h decides which one starts, install.h brings a new one.
 *
 * Calls: image_check() for an image that came over a link, image_intact() for one that was checked when it came, and
 * image_header() for what it says of itself.
 *
 * A slot, in words:
 *   0 to 6      state words: IMAGE_SEQUENCE and so on. No signature covers them; each is programmed once, in this
 * order, and may be made void, which is 0, later 16 to 31    Ed25519 signature (RFC 8032, without context or hash
 * before) of header and code 32          CRC-32 of header and code 112 to 127  header: image_header_t 128 on      code,
 * which begins with the vector table. The rest of both gaps is erased Header and code lie behind each other, so that
 * they are signed as one message.
 *
 * Two checks, since they tell two things: a CRC that is wrong tells that bits have changed on the way or in the flash,
 * a wrong signature behind a right CRC that somebody else made the image.
 *
 * Contexts: any; nothing is kept. Time, for the 147,956 bytes of a sensor's image: a CRC takes 1.6 million
 * instructions, a whole check with its signature 19.5 million (test_boot_loader.py), which are 0.1 s and 1.2 s of the
 * boot loader's 16 MHz. Stack: 1.9 kB.
 */
#ifndef GOLDFIELD_IMAGE_H
#define GOLDFIELD_IMAGE_H

#include <stdbool.h>
#include <stdint.h>

#define IMAGE_SLOTS       2u
#define IMAGE_KEY_BYTES   32u
#define IMAGE_STATE_WORDS 16u         /* Words before the signature: an image never tells what they are. */
#define IMAGE_SIGNATURE   16u         /* Index of its first word. */
#define IMAGE_CRC         32u         /* Index of the CRC-32. */
#define IMAGE_HEADER      112u        /* Index of the header's first word. */
#define IMAGE_CODE        128u        /* Index of the code's first word: vector tables lie at multiples of 512 bytes. */
#define IMAGE_MAGIC       0x4D494647u /* "GFIM" */

/* Indices of the state words. */
enum {
    IMAGE_SEQUENCE = 0,   /* Number of the image among all that this node has got; the larger one is the newer. */
    IMAGE_COMPLEMENT = 1, /* ~IMAGE_SEQUENCE: without it there is no image. */
    IMAGE_FORCED = 2,     /* MARK: it may be older than the one before. */
    IMAGE_PENDING = 3,    /* MARK: it is complete, and wants to be started. */
    IMAGE_TRIED = 4,      /* MARK: it was started. */
    IMAGE_CONFIRMED = 5,  /* MARK: it has found itself good; 0: it is rejected. */
    IMAGE_SETTLED = 6,    /* MARK: IMAGE_CONFIRMED does not change any more; 0: the same of a rejection. */
};
#define IMAGE_MARK   0x5AC3A53Cu
#define IMAGE_VOID   0u
#define IMAGE_ERASED UINT32_MAX

/* The header, 16 words. */
typedef struct {
    uint32_t magic;       /* IMAGE_MAGIC. */
    uint32_t bytes;       /* Length of the code: a multiple of 4. */
    uint32_t address;     /* Address of the slot that it is linked for. */
    uint32_t board;       /* Kind of hardware: another number for each that cannot run the image. */
    uint32_t role;        /* hal_role_t. */
    uint32_t version;     /* major << 16 | minor << 8 | patch. */
    uint32_t protocol;    /* Hash of the protocol that it speaks. */
    uint32_t reserved[9]; /* 0. */
} image_header_t;

/* What is known of the node whose slots they are. */
typedef struct {
    const uint32_t *slot[IMAGE_SLOTS]; /* Where the slots are: they are read like memory. */
    uint32_t address[IMAGE_SLOTS];     /* What the images' headers must say of that. */
    uint32_t words;                    /* Words of a slot. */
    uint32_t board;
    const uint8_t *key; /* Public key, IMAGE_KEY_BYTES; NULL: there is none, and no image can be checked. */
} image_flash_t;

/* What is wrong with an image; the first that applies, in this order. The numbers go over the wire. */
typedef enum {
    IMAGE_OK = 0,
    IMAGE_NONE = 1,     /* There is no header, or a length that no slot holds. */
    IMAGE_DAMAGED = 2,  /* The CRC is wrong: bits have changed. */
    IMAGE_BOARD = 3,    /* It is for another kind of board. */
    IMAGE_ROLE = 4,     /* It is for another role. */
    IMAGE_PLACE = 5,    /* It is linked for another slot. */
    IMAGE_OLDER = 6,    /* Its version is lower than that before it. */
    IMAGE_NO_KEY = 7,   /* The node has no key to check a signature by. */
    IMAGE_UNSIGNED = 8, /* The signature is wrong. */
} image_status_t;

/* What an image must be. */
typedef struct {
    uint32_t role; /* IMAGE_ANY_ROLE: any. */
    uint32_t least_version;
} image_demand_t;
#define IMAGE_ANY_ROLE UINT32_MAX

/* Returns the header of a slot (0 or 1); NULL if there is none or its length is none that the slot holds. */
const image_header_t *image_header(const image_flash_t *flash, uint32_t slot);

/* Returns whether a slot holds an image for this place of which no bit has changed. */
bool image_intact(const image_flash_t *flash, uint32_t slot);

/* Check everything of the image in a slot, whatever its state words say.
 * Returns what is wrong. */
image_status_t image_check(const image_flash_t *flash, uint32_t slot, const image_demand_t *demand);

#endif
