/* frame.c: any byte to a decoder in any state, any frame to be encoded. */
#include "core/link/frame.h"

#include "any.h"

static void decode(void) {
    frame_decoder_t decoder = {.bad_crc = any_word(), .malformed = any_word(), .overlong = any_word()};
    decoder.pending = (uint8_t)any_up_to(FRAME_ENCODED_MAX - 1u);
    decoder.skipping = any_up_to(1) != 0u;
    fill(decoder.bytes, sizeof decoder.bytes);
    frame_t frame;
    const uint8_t byte = any_byte();
    //@ split decoder.pending;
    if (frame_decode(&decoder, byte, &frame)) {
        //@ assert frame.length <= FRAME_DATA_MAX && frame.id <= FRAME_ID_MAX;
        //@ assert \initialized(&frame.data[0..7]);
    }
    //@ assert decoder.pending <= FRAME_ENCODED_MAX - 1u;
    (void)frame_dropped(&decoder);
}

static void encode(uint8_t length) {
    frame_t frame = {.id = any_word(), .length = length};
    fill(frame.data, sizeof frame.data);
    uint8_t encoded[FRAME_ENCODED_MAX];
    const size_t count = frame_encode(&frame, encoded);
    //@ assert count == 0 || 8 <= count <= 16;
}

int main(void) {
    frame_decoder_t decoder;
    frame_decoder_init(&decoder);
    decode();

    encode((uint8_t)Frama_C_unsigned_int_interval(FRAME_DATA_MAX + 1u, UINT8_MAX));
    for (uint8_t length = 0; length <= FRAME_DATA_MAX; length++) {
        encode(length);
    }
    return 0;
}
