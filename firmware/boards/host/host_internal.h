/* host_internal.h: the state of a host board, shared by its two halves: host_board.c (time, events, edge) and
 * host_hal.c (the HAL's functions). */
#ifndef GOLDFIELD_HOST_INTERNAL_H
#define GOLDFIELD_HOST_INTERNAL_H

#include "boards/host/host_board.h"

/* Pins, numbered port * 16 + pin (boards/pinout.md). */
enum {
    PIN_CURRENT_0 = 0, /* PA0 */
    PIN_FIELD_X = 1,   /* PA1; y and z follow. */
    PIN_CURRENT_1 = 6, /* PA6 */
    PIN_SYNC_IN = 10,  /* PA10 */
    PIN_BRIDGE_1 = 36, /* PC4: inputs 1 and 2 of channel 1's bridge, */
    PIN_BRIDGE_0 = 38, /* PC6: of channel 0's. */
    PIN_SYNC_OUT = 40, /* PC8 */
    PIN_ENABLE = 41,   /* PC9 */
    PIN_FAULT = 42,    /* PC10 */
    PIN_LED = 44       /* PC12, to the supply: low is on. */
};

enum { SERIAL_PORT = 1, SERIAL_BAUD = 2000000, MAILBOXES = 3, RECEIVE_BYTES = 1024, RECEIVE_FRAMES = 64, STAMPS = 8 };

/* Ticks of the 168 MHz timer. The converters run at 21 MHz: 8 ticks a clock; 15 clocks of sampling and 12 of
 * conversion. */
enum {
    SERIAL_BYTE_TICKS = 840, /* Ten bits of 84 ticks. */
    CAN_BIT_TICKS = 168,
    SAMPLE_TICKS = 15 * 8,
    CONVERSION_TICKS = 27 * 8,
    BURST_MARGIN_TICKS = 84, /* The last conversion ends 0.5 us before the planned end of the chip. */
    IDLE_TICKS = 1680000     /* 10 ms: the longest sleep before the chip engine runs. */
};

typedef enum { INPUT_PIN, INPUT_BYTE, INPUT_FRAME, INPUT_SENT } input_kind_t;

/* Something from outside that waits for its time. */
typedef struct {
    int64_t time_ps;
    input_kind_t kind;
    uint32_t number; /* Pin or mailbox. */
    bool level;      /* Pin's level; mailbox's success; byte's framing is right. */
    uint8_t byte;
    hal_frame_t frame;
} input_t;

/* The conversions of one chip, in order, then its end. */
typedef struct {
    bool running;
    hal_role_t role;
    hal_events_t events;
    hal_plan_t plan[2]; /* Of the block under way and of the next, by parity of the block. */
    uint32_t block;
    uint32_t chip; /* Since hal_chips_start(). */
    uint32_t chip_in_block;
    int64_t chip_start;               /* Tick. */
    uint32_t event;                   /* Next within this chip: see engine_tick(). */
    uint16_t current[HAL_CHANNELS];   /* The conversions that end shortly. */
    uint16_t set_point[HAL_CHANNELS]; /* That the outside has been told. */
    hal_samples_t samples;
} engine_t;

typedef struct {
    uint8_t bytes[HAL_SERIAL_BUFFER];
    uint32_t head, count;
    int64_t byte_end; /* Tick at which the byte at the head has left. */
} transmitter_t;

struct hal {
    board_edge_t edge;
    host_board_config_t config;
    int64_t power_on_ps;
    int64_t now_ps;
    uint64_t tick_q32; /* Picoseconds of a tick, times 2^32. */
    bool awake;        /* An interrupt since the main loop last ran. */
    int64_t idle_tick; /* The latest end of the present sleep. */
    engine_t engine;
    bool pin_out[64]; /* Levels that the outside has been told. */
    bool fault_level, sync_level;
    transmitter_t transmitter;
    uint8_t received[RECEIVE_BYTES];
    uint32_t received_head, received_count;
    hal_frame_t frames[RECEIVE_FRAMES];
    uint32_t frames_head, frames_count;
    hal_frame_t mailbox[MAILBOXES]; /* A ring: the outside sees only the oldest, so frames leave in order whatever their
                                       identifiers. */
    uint32_t mailbox_head, mailbox_count;
    hal_stamp_t stamps[STAMPS];
    uint32_t stamps_head, stamps_count;
    hal_counters_t counters;
    input_t *inputs; /* Sorted by time; equal times in order of arrival. */
    size_t inputs_head, inputs_count, inputs_capacity;
};

/* The present in ticks of the board's clock since power-on, and the first picosecond of a tick. */
int64_t host_tick(const hal_t *hal);
int64_t host_time_of(const hal_t *hal, int64_t tick);

void host_pin_write(hal_t *hal, unsigned pin, bool level);

/* Give the outside the oldest frame of the mailboxes. */
void host_can_request(hal_t *hal);

#endif
