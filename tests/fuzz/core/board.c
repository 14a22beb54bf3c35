/* board.c: a whole board, its application as it is flashed, that hears anything on its serial line and on CAN. What it
 * says is whole frames and messages of the protocol; a sensor never switches a bridge on; time goes on. The parameter
 * page may hold anything. */
#include "boards/host/host_board.h"
#include "core/link/frame.h"
#include "core/link/messages.h"
#include "fuzz.h"

#define TURNS_MOST  24u
#define PIN_ENABLE  31u
#define PIN_SYNC    38u
#define SERIAL_PORT 3u
#define BAUD        2000000u
#define BYTE_PS     5000000
#define MS_PS       1000000000LL
#define MAILBOXES   3u

typedef struct {
    board_t *board;
    hal_role_t role;
    int64_t now_ps;
    frame_decoder_t decoder;
    bool wanted[MAILBOXES]; /* Mailboxes whose frame waits for the bus. */
} outside_t;

static void see_time(outside_t *outside, int64_t time_ps) {
    REQUIRE(time_ps >= 0);
    outside->now_ps = time_ps > outside->now_ps ? time_ps : outside->now_ps;
}

static void see_pin(void *context, unsigned pin, bool level, int64_t time_ps) {
    outside_t *const outside = context;
    see_time(outside, time_ps);
    REQUIRE(outside->role != HAL_ROLE_SENSOR || pin != PIN_ENABLE || !level);
}

static double tell_volts(void *context, unsigned pin, int64_t time_ps) {
    (void)context;
    (void)time_ps;
    return pin < 4u ? 1.65 : 0.5;
}

static void see_byte(void *context, unsigned uart, uint8_t byte, int64_t time_ps) {
    outside_t *const outside = context;
    frame_t frame;
    see_time(outside, time_ps);
    REQUIRE(uart == SERIAL_PORT);
    if (frame_decode(&outside->decoder, byte, &frame)) {
        REQUIRE(message_fault(frame.id, frame.length) == MESSAGE_OK);
    }
    REQUIRE(frame_dropped(&outside->decoder) == 0u);
}

static void see_frame(void *context, unsigned mailbox, const board_frame_t *frame, int64_t time_ps) {
    outside_t *const outside = context;
    see_time(outside, time_ps);
    REQUIRE(mailbox < MAILBOXES && frame->extended && !frame->remote);
    REQUIRE(message_fault(frame->id, frame->length) == MESSAGE_OK);
    outside->wanted[mailbox] = true;
}

static void see_abort(void *context, unsigned mailbox, int64_t time_ps) {
    outside_t *const outside = context;
    see_time(outside, time_ps);
    REQUIRE(mailbox < MAILBOXES);
    outside->wanted[mailbox] = false;
}

static void run(outside_t *outside, int64_t for_ps) {
    const board_operations_t *const operations = &host_board_operations;
    const int64_t until = operations->now(outside->board) + for_ps;
    REQUIRE(operations->run(outside->board, until) == BOARD_OK && operations->now(outside->board) == until);
    for (unsigned mailbox = 0; mailbox < MAILBOXES; mailbox++) {
        if (outside->wanted[mailbox]) {
            outside->wanted[mailbox] = false;
            operations->can_sent(outside->board, mailbox, true, until);
        }
    }
}

/* A message of some type for some node, mostly one that the board takes. */
static frame_t message(input_t *input) {
    const uint32_t type = take_u8(input) % 32u, node = take_u8(input) % 4u;
    frame_t frame = {.id = type << 24 | (uint32_t)(take_u16(input) % 4096u) << 12 | node};
    for (uint32_t i = 0; i < FRAME_DATA_MAX; i++) {
        frame.data[i] = take_u8(input);
    }
    for (uint32_t length = 0; length <= FRAME_DATA_MAX; length++) {
        if (message_fault(frame.id, (uint8_t)length) == MESSAGE_OK) {
            frame.length = (uint8_t)length;
        }
    }
    return frame;
}

static void say_bytes(outside_t *outside, const uint8_t *bytes, size_t count) {
    int64_t time_ps = host_board_operations.now(outside->board);
    for (size_t i = 0; i < count; i++) {
        time_ps += BYTE_PS;
        host_board_operations.uart_in(outside->board, SERIAL_PORT, bytes[i], BAUD, time_ps);
    }
}

static void turn(outside_t *outside, input_t *input) {
    const uint32_t what = take_u8(input);
    const int64_t now = host_board_operations.now(outside->board);
    uint8_t bytes[FRAME_ENCODED_MAX];
    frame_t frame = {0};
    switch (what % 8u) {
    case 0:
    case 1:
        frame = message(input);
        say_bytes(outside, bytes, frame_encode(&frame, bytes));
        break;
    case 2:
    case 3:
    case 4: {
        frame = message(input);
        board_frame_t heard = {.id = frame.id, .extended = true, .length = frame.length};
        memcpy(heard.data, frame.data, sizeof heard.data);
        host_board_operations.can_in(outside->board, &heard, now + MS_PS / 10);
        break;
    }
    case 5:
        for (uint32_t i = 0; i < sizeof bytes; i++) {
            bytes[i] = take_u8(input);
        }
        say_bytes(outside, bytes, sizeof bytes);
        break;
    case 6: {
        board_frame_t heard = {
            .id = take_u32(input) & 0x1FFFFFFFu, .extended = what < 128u, .remote = what % 16u >= 8u};
        heard.length = (uint8_t)(take_u8(input) % 9u);
        host_board_operations.can_in(outside->board, &heard, now + MS_PS / 10);
        break;
    }
    default:
        host_board_operations.pin_in(outside->board, PIN_SYNC, what < 128u, now + take_u16(input));
    }
    run(outside, (what >= 192u ? 12 : 1) * MS_PS);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size) {
    static const hal_role_t roles[] = {HAL_ROLE_SENSOR, HAL_ROLE_BEACON, HAL_ROLE_ANCHOR};
    input_t input = {bytes, size};
    const uint32_t mode = take_u8(&input);
    outside_t outside = {.role = roles[mode % 3u]};
    static host_board_config_t config;
    memset(&config, 0, sizeof config);
    config.role = outside.role;
    config.temperature_degc = 25.0;
    memset(config.parameter_page, 0xFF, sizeof config.parameter_page);
    if (mode >= 128u) { /* A page of a few entries. */
        const uint32_t entries = mode / 3u % 6u;
        memcpy(config.parameter_page, "GFP1", 4);
        config.parameter_page[4] = (uint8_t)entries;
        config.parameter_page[5] = 0;
        for (uint32_t i = 0; i < 8u * entries; i++) {
            config.parameter_page[8u + i] = take_u8(&input);
        }
        const uint16_t crc = frame_crc(config.parameter_page + 8, 8u * entries);
        memcpy(config.parameter_page + 6, &crc, sizeof crc);
    }
    const board_edge_t edge = {
        .context = &outside,
        .pin_out = see_pin,
        .analog_in = tell_volts,
        .uart_out = see_byte,
        .can_request = see_frame,
        .can_abort = see_abort,
    };
    outside.board = host_board_create(&config, &edge, 0);
    REQUIRE(outside.board != NULL);
    run(&outside, 5 * MS_PS);
    for (uint32_t turns = 0; input.left > 0u && turns < TURNS_MOST; turns++) {
        turn(&outside, &input);
    }
    host_board_operations.destroy(outside.board);
    return 0;
}
