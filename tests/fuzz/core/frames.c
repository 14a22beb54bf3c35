/* frames.c: the decoder of serial frames, byte by byte, gives what a reference that sees all bytes at once gives: the
 * same frames, and the same counts of what was dropped. A good frame encodes to the very bytes that it came as, and any
 * frame that is encoded comes back. */
#include "core/link/frame.h"
#include "fuzz.h"

typedef struct {
    uint32_t bad_crc, malformed, overlong;
} dropped_t;

static uint16_t crc_by_bits(const uint8_t *bytes, size_t count) {
    uint32_t crc = 0xFFFF;
    for (size_t i = 0; i < 8u * count; i++) {
        const uint32_t bit = (uint32_t)bytes[i / 8u] >> (7u - i % 8u) & 1u;
        crc = ((crc >> 15 & 1u) ^ bit) != 0u ? (crc << 1 ^ 0x1021u) & 0xFFFFu : crc << 1 & 0xFFFFu;
    }
    return (uint16_t)crc;
}

/* Undoes COBS block by block, as Cheshire and Baker have it. Returns the length, 0 if it is none. */
static size_t unstuffed(const uint8_t *part, size_t size, uint8_t *payload) {
    size_t at = 0, length = 0;
    while (at < size) {
        const size_t block = part[at];
        if (at + block > size) {
            return 0;
        }
        memcpy(payload + length, part + at + 1, block - 1u);
        length += block - 1u;
        at += block;
        if (at < size) {
            payload[length++] = 0;
        }
    }
    return length;
}

/* Judges the bytes between two delimiters. */
static bool judge(const uint8_t *part, size_t size, frame_t *frame, dropped_t *dropped) {
    uint8_t payload[FRAME_ENCODED_MAX + 1u];
    if (size >= FRAME_ENCODED_MAX) {
        dropped->overlong++;
        return false;
    }
    const size_t length = unstuffed(part, size, payload);
    if (length < 6u || length > 14u) {
        dropped->malformed++;
        return false;
    }
    if (crc_by_bits(payload, length - 2u) != (payload[length - 2u] | (uint32_t)payload[length - 1u] << 8)) {
        dropped->bad_crc++;
        return false;
    }
    uint32_t id;
    memcpy(&id, payload, sizeof id);
    if (id > FRAME_ID_MAX) {
        dropped->malformed++;
        return false;
    }
    frame->id = id;
    frame->length = (uint8_t)(length - 6u);
    memcpy(frame->data, payload + 4, length - 6u);
    return true;
}

static bool same(const frame_t *a, const frame_t *b) {
    return a->id == b->id && a->length == b->length && memcmp(a->data, b->data, a->length) == 0;
}

static void decode_all(const uint8_t *bytes, size_t size) {
    frame_decoder_t decoder;
    frame_decoder_init(&decoder);
    dropped_t dropped = {0};
    size_t begin = 0;
    for (size_t i = 0; i < size; i++) {
        frame_t frame = {.id = UINT32_MAX}, expected;
        const frame_t before = frame;
        const bool good = frame_decode(&decoder, bytes[i], &frame);
        if (bytes[i] != 0u) {
            REQUIRE(!good);
            continue;
        }
        const size_t part = i - begin;
        const bool wanted = part > 0u && judge(bytes + begin, part, &expected, &dropped);
        REQUIRE(good == wanted);
        if (good) {
            uint8_t encoded[FRAME_ENCODED_MAX];
            REQUIRE(same(&frame, &expected) && frame.length <= FRAME_DATA_MAX);
            REQUIRE(frame_encode(&frame, encoded) == part + 1u);
            REQUIRE(memcmp(encoded, bytes + begin, part + 1u) == 0);
        } else {
            REQUIRE(memcmp(&frame, &before, sizeof frame) == 0);
        }
        begin = i + 1u;
    }
    REQUIRE(decoder.bad_crc == dropped.bad_crc && decoder.malformed == dropped.malformed);
    REQUIRE(decoder.overlong == dropped.overlong);
    REQUIRE(frame_dropped(&decoder) == dropped.bad_crc + dropped.malformed + dropped.overlong);
}

/* Takes the input for a message in front of which lies anything. */
static void encode_one(const uint8_t *bytes, size_t size) {
    input_t input = {bytes, size};
    frame_t sent = {.id = take_u32(&input), .length = (uint8_t)(take_u8(&input) % 12u)}, received;
    for (uint32_t i = 0; i < FRAME_DATA_MAX; i++) {
        sent.data[i] = take_u8(&input);
    }
    uint8_t encoded[FRAME_ENCODED_MAX];
    const size_t length = frame_encode(&sent, encoded);
    REQUIRE((length == 0u) == (sent.id > FRAME_ID_MAX || sent.length > FRAME_DATA_MAX));
    frame_decoder_t decoder;
    frame_decoder_init(&decoder);
    for (; input.left > 0u;) {
        (void)frame_decode(&decoder, take_u8(&input), &received);
    }
    (void)frame_decode(&decoder, 0, &received);
    for (size_t i = 0; i < length; i++) {
        REQUIRE(frame_decode(&decoder, encoded[i], &received) == (i + 1u == length));
    }
    REQUIRE(length == 0u || same(&received, &sent));
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size) {
    decode_all(bytes, size);
    encode_one(bytes, size);
    return 0;
}
