#include "core/link/frame.h"

#include <string.h>

#define HEAD     4u /* Bytes of the identifier. */
#define CHECK    2u /* Bytes of the checksum. */
#define BODY_MAX (HEAD + FRAME_DATA_MAX + CHECK)

uint16_t frame_crc(const uint8_t *bytes, size_t count) {
    /* The remainders of four bits make a small table, with two look-ups a byte. */
    static const uint16_t table[16] = {0x0000, 0x1021, 0x2042, 0x3063, 0x4084, 0x50A5, 0x60C6, 0x70E7,
                                       0x8108, 0x9129, 0xA14A, 0xB16B, 0xC18C, 0xD1AD, 0xE1CE, 0xF1EF};
    uint32_t crc = 0xFFFF;
    for (size_t i = 0; i < count; i++) {
        crc = (crc << 4 ^ table[(crc >> 12 ^ (uint32_t)bytes[i] >> 4) & 15u]) & 0xFFFFu;
        crc = (crc << 4 ^ table[(crc >> 12 ^ bytes[i]) & 15u]) & 0xFFFFu;
    }
    return (uint16_t)crc;
}

size_t frame_encode(const frame_t *frame, uint8_t encoded[FRAME_ENCODED_MAX]) {
    if (frame->length > FRAME_DATA_MAX || frame->id > FRAME_ID_MAX) {
        return 0;
    }
    uint8_t body[BODY_MAX];
    for (uint32_t i = 0; i < HEAD; i++) {
        body[i] = (uint8_t)(frame->id >> (8u * i));
    }
    memcpy(body + HEAD, frame->data, frame->length);
    const size_t checked = HEAD + frame->length;
    const uint16_t crc = frame_crc(body, checked);
    body[checked] = (uint8_t)crc;
    body[checked + 1u] = (uint8_t)(crc >> 8);

    /* COBS: each zero becomes the distance to the next one; the first distance stands in front. */
    size_t distance_at = 0, end = 1;
    for (size_t i = 0; i < checked + CHECK; i++) {
        if (body[i] == 0u) {
            encoded[distance_at] = (uint8_t)(end - distance_at);
            distance_at = end;
        } else {
            encoded[end] = body[i];
        }
        end++;
    }
    encoded[distance_at] = (uint8_t)(end - distance_at);
    encoded[end] = 0;
    return end + 1u;
}

void frame_decoder_init(frame_decoder_t *decoder) {
    *decoder = (frame_decoder_t){0};
}

static void count_up(uint32_t *counter) {
    if (*counter < UINT32_MAX) {
        (*counter)++;
    }
}

/* Undoes COBS; encoded holds no zero byte. Returns the payload's length, or 0 if a distance points beyond the end. */
static size_t unstuff(const uint8_t *encoded, size_t count, uint8_t payload[FRAME_ENCODED_MAX]) {
    size_t length = 0, next = encoded[0];
    for (size_t i = 1; i < count; i++) {
        if (i == next) {
            payload[length] = 0;
            next += encoded[i];
        } else {
            payload[length] = encoded[i];
        }
        length++;
    }
    return next == count ? length : 0;
}

static bool check(frame_decoder_t *decoder, frame_t *frame) {
    uint8_t payload[FRAME_ENCODED_MAX];
    const size_t length = unstuff(decoder->bytes, decoder->pending, payload);
    if (length < HEAD + CHECK || length > BODY_MAX) {
        count_up(&decoder->malformed);
        return false;
    }
    const size_t checked = length - CHECK;
    const uint32_t crc = payload[checked] | (uint32_t)payload[checked + 1u] << 8;
    if (frame_crc(payload, checked) != crc) {
        count_up(&decoder->bad_crc);
        return false;
    }
    const uint32_t id = payload[0] | (uint32_t)payload[1] << 8 | (uint32_t)payload[2] << 16 |
                        (uint32_t)payload[3] << 24;
    if (id > FRAME_ID_MAX) {
        count_up(&decoder->malformed);
        return false;
    }
    frame->id = id;
    frame->length = (uint8_t)(checked - HEAD);
    memset(frame->data, 0, sizeof frame->data);
    memcpy(frame->data, payload + HEAD, frame->length);
    return true;
}

bool frame_decode(frame_decoder_t *decoder, uint8_t byte, frame_t *frame) {
    if (byte != 0u) {
        if (decoder->pending < sizeof decoder->bytes) {
            decoder->bytes[decoder->pending] = byte;
            decoder->pending++;
        } else {
            decoder->skipping = true;
        }
        return false;
    }
    bool good = false;
    if (decoder->skipping) {
        count_up(&decoder->overlong);
    } else if (decoder->pending > 0u) {
        good = check(decoder, frame);
    }
    decoder->pending = 0;
    decoder->skipping = false;
    return good;
}

uint32_t frame_dropped(const frame_decoder_t *decoder) {
    const uint64_t sum = (uint64_t)decoder->bad_crc + decoder->malformed + decoder->overlong;
    return sum < UINT32_MAX ? (uint32_t)sum : UINT32_MAX;
}
